# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Spheres, cylinders and cones: from oriented points, distances, derivatives, least squares."""

import numpy as np
import pytest
from scipy import optimize

from plane_detector.shapes.fitting import Pixels, Silhouette, fit_shape, least_squares, linearized
from plane_detector.shapes.search import shapes_through
from plane_detector.shapes.surface import FREEDOMS, depths_on_rays, frame_of, moved, surface_of
from plane_detector.shapes.views import silhouette_rays
from plane_detector.types import ShapeType

NO_RAYS = np.zeros((0, 4))
SHAPES = {
    ShapeType.SPHERE: np.array([0.1, 0.2, 2.0, 0, 0, 0, 0.5, 0]),
    ShapeType.CYLINDER: np.array([0.1, 0.2, 2.0, 0.6, 0.0, 0.8, 0.3, 0]),
    ShapeType.CONE: np.array([0.1, 0.2, 2.0, 0.6, 0.8, 0.0, 0.0, 0.4])}
every_kind = pytest.mark.parametrize('kind', SHAPES, ids=lambda kind: kind.name)


def surface_points(shape, count, rng):
    """Return points on a shape and their normals: random points, moved along the gradient."""
    points = shape[:3] + rng.normal(0, 0.5, (count, 3)) + 0.7 * shape[3:6]
    for _ in range(60):
        surface = surface_of(shape, points)
        points = points - surface.distance_m[:, None] * surface.normal
    return points, surface_of(shape, points).normal


@every_kind
def test_a_shape_is_found_again_from_its_points_and_normals(kind):
    shape = SHAPES[kind]
    points, normals = surface_points(shape, 90, np.random.default_rng(0))
    found = shapes_through(kind, points.reshape(-1, 3, 3), normals.reshape(-1, 3, 3))
    distance_m = np.array([surface_of(one, points).distance_m for one in found])
    assert np.median(np.abs(distance_m)) < 1e-9
    np.testing.assert_allclose(np.median(found[:, 6:], axis=0), shape[6:], atol=1e-9)


@every_kind
def test_derivatives_are_those_of_small_steps(kind):
    shape, rng = SHAPES[kind], np.random.default_rng(1)
    points, weight = rng.normal(0, 1, (20, 3)), rng.uniform(1, 2, 20)
    expected = np.stack([
        (surface_of(moved(shape, step, frame_of(shape)), points).distance_m
         - surface_of(moved(shape, -step, frame_of(shape)), points).distance_m) / 2e-6
        for step in 1e-6 * np.eye(7)[FREEDOMS[kind]]])
    distance, slope = linearized(shape, FREEDOMS[kind], points, NO_RAYS, weight)
    np.testing.assert_allclose(distance, weight * surface_of(shape, points).distance_m, atol=1e-12)
    np.testing.assert_allclose(slope, weight * expected, atol=1e-6)


@every_kind
def test_rays_meet_the_surface_at_their_depth(kind):
    shape, slopes = SHAPES[kind], np.random.default_rng(2).uniform(-0.3, 0.3, (200, 2))
    ends_m = (0.0 if kind == ShapeType.CONE else -np.inf, np.inf)
    depth_m = depths_on_rays(shape, slopes, ends_m)
    hit = np.isfinite(depth_m)
    assert 5 < hit.sum() <= 200
    rays = np.column_stack([slopes, np.ones(len(slopes))])[hit]
    surface = surface_of(shape, rays * depth_m[hit, None])
    np.testing.assert_allclose(surface.distance_m, 0, atol=1e-7)
    facing = (surface.normal * rays).sum(axis=1)
    assert (facing <= 1e-9).mean() > 0.95  # the near side


def noisy_pixels(shape, rng, sigma=0.002, points=None):
    """Return points with noise along their rays, a share of the depth."""
    points = surface_points(shape, 300, rng)[0] if points is None else points
    points = points[points[:, 2] > 1.0]
    points = points * (1 + sigma * rng.normal(0, 1, (len(points), 1)))
    return Pixels(points, points[:, 2:] * [[sigma, 2 * sigma]], len(points))


@every_kind
def test_least_squares_equal_those_of_scipy(kind):
    shape, freedoms = SHAPES[kind], FREEDOMS[kind]
    pixels = noisy_pixels(shape, np.random.default_rng(3))
    weight = 1 / pixels.noise_m[:, 1]

    def residual(step):
        steps = np.zeros(7)
        steps[freedoms] = step
        after = moved(shape, steps, frame_of(shape))
        return surface_of(after, pixels.points_m).distance_m * weight

    best = optimize.least_squares(residual, np.zeros(len(freedoms)), method='lm')
    start = moved(shape, 0.01 * np.eye(7)[freedoms].sum(axis=0), frame_of(shape))
    found, information = least_squares(start, freedoms, pixels.points_m, NO_RAYS, weight)
    cost = ((surface_of(found, pixels.points_m).distance_m * weight) ** 2).sum() / 2
    assert best.cost <= cost * (1 + 1e-9)
    assert cost < best.cost * (1 + 1e-3)
    expected = np.linalg.inv(best.jac.T @ best.jac)[-1, -1]  # of the size, whatever the frame
    assert np.linalg.inv(information)[-1, -1] == pytest.approx(expected, rel=0.02)


@every_kind
def test_outliers_do_not_change_a_fit(kind):
    shape = SHAPES[kind]
    pixels = noisy_pixels(shape, np.random.default_rng(3))
    wild_m = pixels.points_m.copy()
    wild_m[:20] *= 4
    alone = fit_shape(kind, shape, Pixels(pixels.points_m[20:], pixels.noise_m[20:], 100.0))
    found = fit_shape(kind, shape, Pixels(wild_m, pixels.noise_m, 100.0))
    np.testing.assert_allclose(found.shape, alone.shape, atol=1e-9)
    assert abs(found.shape - shape)[6:].max() < 5 * found.size_sigma
    assert fit_shape(kind, shape, Pixels(wild_m[:20], pixels.noise_m[:20], 20.0)) is None


def test_the_silhouette_gives_the_size_that_noise_hides():
    """A pipe of 5 cm at 2 m with noise of 4 cm: its depth does not determine its radius."""
    rng, pixel = np.random.default_rng(7), 1 / 525
    pipe = np.array([0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.05, 0.0])
    slopes = np.column_stack([rng.uniform(-0.024, 0.024, 400), rng.uniform(-0.3, 0.3, 400)])
    noisy_m = depths_on_rays(pipe, slopes) + rng.normal(0, 0.04, 400)
    points = np.column_stack([slopes, np.ones(400)]) * noisy_m[:, None]
    pixels = Pixels(points, np.full((400, 2), [0.04, 2 * pixel]), 20.0)
    side = 0.05 / np.sqrt(4 - 0.05**2)
    rays = np.array([[sign * side + rng.uniform(-0.5, 0.5) * pixel, y, 2.0, 0.04]
                     for y in np.linspace(-0.3, 0.3, 60) for sign in (-1, 1)])
    start = pipe + [0.01, 0, 0.02, 0, 0, 0, 0.02, 0]
    blind = fit_shape(ShapeType.CYLINDER, start, pixels)
    found = fit_shape(ShapeType.CYLINDER, start, pixels, Silhouette(rays, pixel), 10.0)
    assert found.shape[6] == pytest.approx(0.05, abs=0.001)
    assert blind.size_sigma > 0.005 > 0.001 > found.size_sigma


def test_rays_of_the_silhouette_touch_the_shape():
    fx, fy, cx, cy, centre_m, radius_m = 100.0, 130.0, 70.0, 55.0, np.array([0.1, 0.05, 2.0]), 0.4
    v, u = np.mgrid[:120, :160].reshape(2, -1)
    depth_m = depths_on_rays(np.array([*centre_m, 0, 0, 0, radius_m, 0]),
                             np.column_stack([(u - cx) / fx, (v - cy) / fy])).reshape(120, 160)
    is_ball = np.isfinite(depth_m)
    rays = silhouette_rays(np.where(is_ball, depth_m, 5).astype(np.float32), is_ball,
                           np.arange(15 * 20), 20, np.array([fx, fy, cx, cy, 0.0, 0.0, 8]))
    assert len(rays) > 100
    direction = np.column_stack([rays[:, :2], np.ones(len(rays))])
    away_m = np.linalg.norm(np.cross(direction, centre_m), axis=1) / np.linalg.norm(direction,
                                                                                    axis=1)
    assert np.abs(away_m - radius_m).max() < centre_m[2] / fx
    assert abs(np.median(away_m) - radius_m) < 0.2 * centre_m[2] / fx
    np.testing.assert_allclose(rays[:, 2], 2.0, atol=radius_m)
