# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Spheres, cylinders and cones: from oriented points, distances, derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from plane_detector.shapes.models import (
    CONE,
    CYLINDER,
    SPHERE,
    frame_of,
    surface_of,
)
from plane_detector.shapes.surface import depth_on_rays_m, moved, weighted_jacobian

UP = np.array([0.0, 0.0, 1.0])
SHAPES = {
    'sphere': (SPHERE, np.array([0.1, 0.2, 2.0, 0, 0, 0, 0.5, 0])),
    'cylinder': (CYLINDER, np.array([0.1, 0.2, 2.0, 0.6, 0.0, 0.8, 0.3, 0])),
    'cone': (CONE, np.array([0.1, 0.2, 2.0, 0.6, 0.8, 0.0, 0.0, 0.4])),
}


def surface_points(model, shape, count, rng):
    """Return points on a shape and their normals: random points, moved along the gradient."""
    points = shape[:3] + rng.normal(0, 0.5, (count, 3)) + 0.7 * shape[3:6]
    for _ in range(60):
        surface = surface_of(shape, points)
        points = points - surface.distance_m[:, None] * surface.normal
    return points, surface_of(shape, points).normal


@pytest.mark.parametrize('name', SHAPES)
def test_a_shape_is_found_again_from_its_points_and_normals(name):
    model, shape = SHAPES[name]
    points, normals = surface_points(model, shape, 30 * model.sample_size,
                                     np.random.default_rng(0))
    found = model.from_samples(points.reshape(-1, model.sample_size, 3),
                               normals.reshape(-1, model.sample_size, 3))
    distance_m = np.array([surface_of(one, points).distance_m for one in found])
    assert np.median(np.abs(distance_m)) < 1e-9
    np.testing.assert_allclose(np.median(found[:, 6:], axis=0), shape[6:], atol=1e-9)


def test_distances_of_known_points():
    assert surface_of(np.array([0, 0, 3.0, 0, 0, 0, 1, 0]),
                          np.array([[0, 0, 0.0]])).distance_m == pytest.approx([2.0])
    cylinder = surface_of(np.array([0, 0, 0, 0, 1.0, 0, 1, 0]), np.array([[3.0, 9.0, 4.0]]))
    assert cylinder.distance_m == pytest.approx([4.0])
    assert cylinder.along_m == pytest.approx([9.0])
    cone = surface_of(np.array([0, 0, 0, 0, 0, 1.0, 0, np.pi / 4]), np.array([[1.0, 0, 1.0]]))
    assert cone.distance_m == pytest.approx([0.0])
    np.testing.assert_allclose(cone.normal, [np.array([1, 0, -1]) / np.sqrt(2)], atol=1e-12)


@pytest.mark.parametrize('name', SHAPES)
def test_jacobian_is_that_of_small_steps(name):
    model, shape = SHAPES[name]
    points = np.random.default_rng(1).normal(0, 1, (20, 3))
    frame, freedoms = frame_of(shape), list(model.freedoms)
    expected = np.stack([
        (surface_of(moved(shape, step, frame), points).distance_m
         - surface_of(moved(shape, -step, frame), points).distance_m) / 2e-6
        for step in 1e-6 * np.eye(7)[freedoms]])
    found = weighted_jacobian(shape, points, np.ones(len(points)), frame)
    np.testing.assert_allclose(found[freedoms], expected, atol=1e-6)


@pytest.mark.parametrize('name', SHAPES)
def test_rays_meet_the_surface_at_their_depth(name):
    model, shape = SHAPES[name]
    slopes = np.random.default_rng(2).uniform(-0.3, 0.3, (200, 2))
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    depth_m = depth_on_rays_m(shape, rays, 0.0 if name == 'cone' else -np.inf, np.inf)
    hit = np.isfinite(depth_m)
    assert 5 < hit.sum() <= 200
    surface = surface_of(shape, rays[hit] * depth_m[hit, None])
    np.testing.assert_allclose(surface.distance_m, 0, atol=1e-7)
    facing = (surface.normal * rays[hit]).sum(axis=1)
    assert (facing <= 1e-9).mean() > 0.95  # the near side


def test_parallel_normals_give_no_shape():
    points = np.array([[[0, 0, 1.0], [1, 0, 1.0]]])
    normals = np.array([[-UP, -UP]])
    assert np.isnan(SPHERE.from_samples(points, normals)).any()
    assert np.isnan(CYLINDER.from_samples(points, normals)).any()


@pytest.mark.parametrize('name', SHAPES)
def test_the_frame_is_orthonormal(name):
    frame = frame_of(SHAPES[name][1])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
