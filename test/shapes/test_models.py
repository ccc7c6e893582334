# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Spheres, cylinders and cones: from oriented points, distances, derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from plane_detector.shapes.fitting import (
    fitted,
    gradient,
    least_squares,
)
from plane_detector.shapes.models import CONE, CYLINDER, SPHERE, surface_of
from plane_detector.shapes.search import shape_through
from plane_detector.shapes.surface import (
    depth_on_ray,
    frame_of,
    moved,
    turn_of,
)

NO_RAYS, TRUST = np.zeros((0, 4)), (1.0, 0.002, 6.0)
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
    points, normals = surface_points(model, shape, 90, np.random.default_rng(0))
    found = np.array([shape_through(int(model.type), *sample) for sample in zip(
        points.reshape(-1, 3, 3), normals.reshape(-1, 3, 3), strict=True)])
    distance_m = np.array([surface_of(one, points).distance_m for one in found])
    assert np.median(np.abs(distance_m)) < 1e-9
    np.testing.assert_allclose(np.median(found[:, 6:], axis=0), shape[6:], atol=1e-9)


@pytest.mark.parametrize('name', SHAPES)
def test_jacobian_is_that_of_small_steps(name):
    model, shape = SHAPES[name]
    points = np.random.default_rng(1).normal(0, 1, (20, 3))
    frame, freedoms = frame_of(shape), list(model.freedoms)
    expected = np.stack([
        (surface_of(moved(shape, step, frame), points).distance_m
         - surface_of(moved(shape, -step, frame), points).distance_m) / 2e-6
        for step in 1e-6 * np.eye(7)[freedoms]])
    found = np.empty((20, 7))
    distance_m = [gradient(shape, turn_of(shape), frame, point, row)
                  for point, row in zip(points, found, strict=True)]
    np.testing.assert_allclose(distance_m, surface_of(shape, points).distance_m, atol=1e-12)
    np.testing.assert_allclose(found.T[freedoms], expected, atol=1e-6)


@pytest.mark.parametrize('name', SHAPES)
def test_rays_meet_the_surface_at_their_depth(name):
    model, shape = SHAPES[name]
    slopes = np.random.default_rng(2).uniform(-0.3, 0.3, (200, 2))
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    low_m = 0.0 if name == 'cone' else -np.inf
    depth_m = np.array([depth_on_ray(shape, *slope, low_m, np.inf) for slope in slopes])
    hit = np.isfinite(depth_m)
    assert 5 < hit.sum() <= 200
    surface = surface_of(shape, rays[hit] * depth_m[hit, None])
    np.testing.assert_allclose(surface.distance_m, 0, atol=1e-7)
    facing = (surface.normal * rays[hit]).sum(axis=1)
    assert (facing <= 1e-9).mean() > 0.95  # the near side


def noisy_points(model, shape, rng):
    """Return points with noise along their rays, and the noise (N, 2)."""
    points, _ = surface_points(model, shape, 300, rng)
    points = points[points[:, 2] > 1.0]
    sigma = 0.002 * points[:, 2]
    points *= 1 + 0.002 * rng.normal(0, 1, (len(points), 1))
    return points, np.column_stack([sigma, 2 * sigma])


@pytest.mark.parametrize('name', SHAPES)
def test_least_squares_equal_those_of_scipy(name):
    model, shape = SHAPES[name]
    rng = np.random.default_rng(3)
    points, noise = noisy_points(model, shape, rng)
    weight, freedoms = 1 / noise[:, 1], np.array(model.freedoms)

    def residual(step):
        steps = np.zeros(7)
        steps[freedoms] = step
        return surface_of(moved(shape, steps, frame_of(shape)), points).distance_m * weight

    best = optimize.least_squares(residual, np.zeros(len(freedoms)), method='lm')
    start = moved(shape, 0.01 * np.eye(7)[freedoms].sum(axis=0), frame_of(shape))
    found = least_squares(start, freedoms, points, NO_RAYS, weight)
    cost = ((surface_of(found, points).distance_m * weight) ** 2).sum() / 2
    assert best.cost <= cost * (1 + 1e-9)
    assert cost < best.cost * (1 + 1e-3)


@pytest.mark.parametrize('name', SHAPES)
def test_outliers_do_not_change_a_fit(name):
    model, shape = SHAPES[name]
    points, noise = noisy_points(model, shape, np.random.default_rng(3))
    freedoms = np.array(model.freedoms)
    wild = points.copy()
    wild[:20] *= 4
    alone, _ = fitted(shape, freedoms, points[20:].copy(), noise[20:].copy(), NO_RAYS, TRUST)
    found, information = fitted(shape, freedoms, wild, noise, NO_RAYS, TRUST)
    np.testing.assert_allclose(found, alone, atol=1e-9)
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))[-1]
    assert abs(found - shape)[6:].max() < 5 * sigma


def test_the_silhouette_gives_the_size_that_noise_hides():
    """A pipe of 5 cm at 2 m with noise of 4 cm: its depth does not determine its radius."""
    rng, pixel = np.random.default_rng(7), 1 / 525
    pipe = np.array([0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.05, 0.0])
    slopes = np.column_stack([rng.uniform(-0.024, 0.024, 400), rng.uniform(-0.3, 0.3, 400)])
    depth_m = np.array([depth_on_ray(pipe, *slope, -np.inf, np.inf) for slope in slopes])
    noisy_m = depth_m + rng.normal(0, 0.04, 400)
    points = np.column_stack([slopes, np.ones(400)]) * noisy_m[:, None]
    noise = np.full((400, 2), [0.04, 2 * pixel])
    side = 0.05 / np.sqrt(4 - 0.05**2)
    rays = np.array([[sign * side + rng.uniform(-0.5, 0.5) * pixel, y, 2.0, 0.04]
                     for y in np.linspace(-0.3, 0.3, 60) for sign in (-1, 1)])
    start, freedoms = pipe + [0.01, 0, 0.02, 0, 0, 0, 0.02, 0], np.array(CYLINDER.freedoms)
    trust = (0.05, pixel, 10.0)
    _, blind = fitted(start, freedoms, points, noise, NO_RAYS, trust)
    found, information = fitted(start, freedoms, points, noise, rays, trust)
    sigma = [np.sqrt(np.linalg.inv(one)[-1, -1]) for one in (blind, information)]
    assert found[6] == pytest.approx(0.05, abs=0.001)
    assert sigma[0] > 0.005 > 0.001 > sigma[1]
