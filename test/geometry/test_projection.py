# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth to points and back, to disparity and back."""

import warnings

import numpy as np
import pytest

from plane_detector.geometry.disparity import (
    disparity_range,
    to_depth,
    to_disparity,
    valid_depth,
)
from plane_detector.geometry.projection import depth_to_points, pixel_rays
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(fx=2.0, fy=4.0, cx=1.0, cy=0.5, width=4, height=2)


def test_rays_by_hand():
    ray_x, ray_y = pixel_rays(CAMERA)
    np.testing.assert_array_equal(ray_x, [-0.5, 0.0, 0.5, 1.0])
    np.testing.assert_array_equal(ray_y, [-0.125, 0.125])


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf, 0.0, -1.0])
def test_only_invalid_depth_becomes_nan(bad):
    depth_m = np.full((2, 4), 3.0, np.float32)
    depth_m[1, 2] = bad
    points_m = depth_to_points(depth_m, CAMERA)
    assert np.isnan(points_m[1, 2]).all()
    assert np.isfinite(np.delete(points_m.reshape(-1, 3), 6, axis=0)).all()
    assert valid_depth(depth_m).sum() == 7


@pytest.mark.parametrize('depth_m', [
    np.ones((4, 2), np.float32), np.ones((2, 4, 1), np.float32), np.ones((2, 4), np.uint16)])
def test_depth_of_another_type_or_size_is_refused(depth_m):
    with pytest.raises(ValueError, match='depth'):
        depth_to_points(depth_m, CAMERA)


@pytest.mark.parametrize('name', ['fx', 'fy', 'width', 'height'])
def test_intrinsics_of_an_uncalibrated_camera_are_refused(name):
    values = {'fx': 1.0, 'fy': 1.0, 'cx': 0.0, 'cy': 0.0, 'width': 2, 'height': 2, name: 0}
    with pytest.raises(ValueError, match='positive'):
        CameraIntrinsics(**values)


@pytest.mark.parametrize('name, value, range_px', [
    ('fx', 1e308, '56.32 to 640000'), ('fy', 1e160, '42.24 to 640000'),
    ('fx', 641e3, '56.32 to 640000'), ('fx', 20.0, '56.32 to 640000'),
    ('fy', 42.0, '42.24 to 640000'), ('cx', 1e308, '-640000 to 640000'),
    ('cx', -641e3, '-640000 to 640000'), ('cy', -1e200, '-640000 to 640000')])
def test_intrinsics_out_of_reason_are_refused_with_value_range_and_remedy(name, value, range_px):
    values = {'fx': 500.0, 'fy': 500.0, 'cx': 320.0, 'cy': 240.0, 'width': 640, 'height': 480}
    assert CameraIntrinsics(**values)
    with pytest.raises(ValueError) as caught:
        CameraIntrinsics(**{**values, name: value})
    assert str(caught.value) == (
        f'{name} {value:g} px cannot be that of a 640 x 480 image, {range_px} px can: calibrate '
        'the camera again, or correct its CameraInfo')


@pytest.mark.parametrize('focal_px', [56.5, 640e3])  # 160 degrees across 640 px: 56.42 px
def test_the_longest_and_the_shortest_lens_are_possible(focal_px):
    assert CameraIntrinsics(focal_px, focal_px, 320.0, 240.0, 640, 480).fx == focal_px


@pytest.mark.parametrize('width, height, focal_px', [
    (640, 480, 167.0),  # fisheye lens of 220 degrees, r = f theta, its circle as wide as the image
    (64, 48, 16.7), (1280, 720, 188.0),  # the same in small, and as high as the image
    (1024, 16, 163.0),  # rows of a lidar, rectified
    (64, 480, 60.0)])  # cut to a strip of a camera of 640 x 480
def test_wide_lenses_small_images_and_strips_are_possible(width, height, focal_px):
    camera = CameraIntrinsics(focal_px, focal_px, width / 2, height / 2, width, height)
    assert (camera.fx, camera.fy) == (focal_px, focal_px)


INVALID = [0.0, -0.0, -1.0, np.inf, -np.inf, np.nan, 0.9e-3, 1e-40]


@pytest.mark.parametrize('value', INVALID)
def test_invalid_depth_has_no_disparity(value):
    depth_m = np.array([[value, 4.0]], np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        disparity = to_disparity(depth_m)
    np.testing.assert_array_equal(valid_depth(depth_m), [[False, True]])
    np.testing.assert_array_equal(disparity, np.array([[np.nan, 0.25]], np.float32))


@pytest.mark.parametrize('disparity', [0.0, -0.1, np.nan, np.inf, 2e3, 0.124])
def test_disparity_of_no_depth_up_to_the_largest_is_invalid(disparity):
    found = to_depth(np.array([[disparity, 0.125]]), max_depth_m=8.0)
    np.testing.assert_array_equal(found, [[np.nan, 8.0]])


def test_the_range_ignores_outliers():
    disparity = np.tile(np.linspace(1.0, 3.0, 400, dtype=np.float32), (400, 1))
    disparity[:4] = 1000.0
    disparity[4:8] = np.nan
    assert disparity_range(disparity) == pytest.approx(2.0, rel=0.05)
