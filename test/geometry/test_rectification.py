# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Lens models against their published formulas; reduction keeps the directions of pixels."""

import tracemalloc

import numpy as np
import pytest

from plane_detector.geometry.rectification import Reduction, make_rectification
from plane_detector.types import CameraIntrinsics

MATRIX = np.array([[300.0, 0, 159.5], [0, 310.0, 119.5], [0, 0, 1]])
NEW_MATRIX = np.array([[280.0, 0, 150.0], [0, 285.0, 125.0], [0, 0, 1]])
SIZE = (320, 240)
TURN = np.array([[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]])


def rays():
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    return pixels @ np.linalg.inv(NEW_MATRIX).T


def project_brown(ray, d):
    """OpenCV's documented model: k1 k2 p1 p2 k3 [k4 k5 k6]."""
    x, y = ray[..., 0] / ray[..., 2], ray[..., 1] / ray[..., 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(d, (0, 8 - len(d)))
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    x_d = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    y_d = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return MATRIX[0, 0] * x_d + MATRIX[0, 2], MATRIX[1, 1] * y_d + MATRIX[1, 2]


def project_equidistant(ray, d):
    """Kannala and Brandt: the angle to the axis, bent by a polynomial, is the radius."""
    x, y = ray[..., 0] / ray[..., 2], ray[..., 1] / ray[..., 2]
    radius = np.hypot(x, y)
    theta = np.arctan(radius)
    bent = theta * (1 + sum(k * theta ** (2 * i + 2) for i, k in enumerate(d)))
    factor = np.divide(bent, radius, out=np.ones_like(radius), where=radius > 0)
    return MATRIX[0, 0] * x * factor + MATRIX[0, 2], MATRIX[1, 1] * y * factor + MATRIX[1, 2]


@pytest.mark.parametrize('model, d, project', [
    ('plumb_bob', [-0.3, 0.1, 0.001, -0.002, 0.01], project_brown),
    ('rational_polynomial', [0.4, 0.1, 0.001, -0.002, 0.02, 0.6, 0.2, 0.03], project_brown),
    ('equidistant', [-0.02, 0.01, -0.003, 0.001], project_equidistant)])
def test_maps_follow_the_model(model, d, project):
    maps = make_rectification(model, np.array(d), MATRIX, TURN, NEW_MATRIX, SIZE)
    expected_x, expected_y = project(rays() @ TURN, np.array(d))  # R^T per ray
    np.testing.assert_allclose(maps.map_x, expected_x, atol=2e-3)
    np.testing.assert_allclose(maps.map_y, expected_y, atol=2e-3)


def test_depth_of_a_turned_camera_is_along_the_new_axis():
    """A plane z = 2 of the rectified camera, seen by the turned one, comes back as 2."""
    maps = make_rectification('plumb_bob', np.zeros(5), MATRIX, TURN, NEW_MATRIX, SIZE)
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    raw_rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(MATRIX).T
    raw_depth_m = (2.0 / (raw_rays @ TURN[2])).astype(np.float32)
    depth_m = maps.depth(raw_depth_m)
    seen = maps.inside()
    assert seen.mean() > 0.5
    np.testing.assert_allclose(depth_m[seen], 2.0, rtol=2e-3)
    assert np.isnan(depth_m[~seen]).mean() > 0.9


def test_the_maps_of_a_large_image_take_few_times_their_own_size():
    """Of a turned camera; else a million pixels would take 60 MB."""
    size = 2000, 1500
    tracemalloc.start()
    try:
        make_rectification('plumb_bob', np.zeros(5), MATRIX, TURN, NEW_MATRIX, size)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 24 * size[0] * size[1]


@pytest.mark.parametrize('model, d, reason', [
    ('spherical', np.zeros(5), 'spherical'), ('plumb_bob', np.zeros(8), '4 or 5 coeff'),
    ('rational_polynomial', np.zeros(5), '8 or 12 or 14 coefficients'),
    ('equidistant', np.zeros(5), '4 coefficients')])
def test_unknown_models_are_refused(model, d, reason):
    with pytest.raises(ValueError, match=reason):
        make_rectification(model, d, MATRIX, np.eye(3), NEW_MATRIX, SIZE)


@pytest.mark.parametrize('d, rotation', [
    (np.full(5, np.nan), np.eye(3)), (np.zeros(5), np.diag([np.nan, 1.0, 1.0])),
    (np.zeros(5), np.linalg.matrix_power(TURN, 12))])
def test_a_calibration_that_leaves_nothing_of_the_image_is_refused(d, rotation):
    """Else every frame has no depth and no planes, and nothing says why."""
    with pytest.raises(ValueError, match='would be empty|not a rotation'):
        make_rectification('plumb_bob', d, MATRIX, rotation, NEW_MATRIX, SIZE)


@pytest.mark.parametrize('size, side, expected', [
    ((640, 480), 0, (640, 480)), ((640, 480), 640, (640, 480)), ((640, 480), 320, (320, 240)),
    ((480, 640), 320, (240, 320)), ((3840, 2160), 1000, (1000, 562)), ((5000, 2), 100, (100, 1))])
def test_sizes_of_reduced_images(size, side, expected):
    assert Reduction.to_side(size, side).new_size == expected


def test_the_corners_of_the_image_keep_their_directions():
    reduction = Reduction.to_side((640, 480), 160)
    reduced = reduction.camera(CameraIntrinsics(300.0, 310.0, 159.5, 119.5, 640, 480)).matrix
    old_px = np.array([[-0.5, -0.5, 1], [639.5, 479.5, 1]])
    new_px = np.array([[-0.5, -0.5, 1], [159.5, 119.5, 1]])
    np.testing.assert_allclose(new_px @ np.linalg.inv(reduced).T,
                               old_px @ np.linalg.inv(MATRIX).T, atol=1e-12)


def test_a_pixel_is_the_mean_of_its_area():
    rgb = np.zeros((4, 8, 3), np.uint8)
    rgb[:2, :2] = [[[40], [0]], [[0], [0]]]
    reduced = Reduction.to_side((8, 4), 4).image(rgb)
    assert reduced.shape == (2, 4, 3)
    assert reduced[0, 0].tolist() == [10, 10, 10]
