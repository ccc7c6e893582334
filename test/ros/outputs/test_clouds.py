# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of the pixels: organised, coloured and labelled; of the obstacles."""

from dataclasses import replace

import numpy as np
import pytest
from ros_helpers import cloud_array, header

from plane_detector.geometry.projection import depth_to_points
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.outputs.clouds import PixelPoints, obstacles_to_msg, points_to_msg
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(50.0, 51.0, 3.0, 1.5, 7, 5)
NAMES = np.array([4, 70000, 32769, 0], np.uint32)


@pytest.fixture
def points():
    """Depth with every kind of invalid value; read-only, as views of messages are."""
    rng = np.random.default_rng(1)
    depth_m = rng.uniform(1, 5, (5, 7)).astype(np.float32)
    depth_m[0, :4] = np.nan, np.inf, 0.0, -1.0
    labels = rng.integers(-1, 3, (5, 7)).astype(np.int32)
    depth_m.flags.writeable = labels.flags.writeable = False
    return PixelPoints(depth_m, labels, CAMERA)


@pytest.fixture
def rgb():
    image = np.random.default_rng(2).integers(0, 256, (5, 7, 3), np.uint8)
    image.flags.writeable = False
    return image


def xyz(cloud: np.ndarray) -> np.ndarray:
    return np.stack([cloud[axis] for axis in 'xyz'], -1)


def test_points_are_organised_coloured_and_labelled(points, rgb):
    msg = points_to_msg(header(1.5), points, rgb, NAMES)
    assert [f.name for f in msg.fields] == ['x', 'y', 'z', 'rgb', 'label']
    assert msg.header == header(1.5)
    assert not msg.is_dense
    cloud = cloud_array(msg)
    assert cloud.shape == (5, 7)
    np.testing.assert_array_equal(xyz(cloud), depth_to_points(points.depth_m, CAMERA))
    np.testing.assert_array_equal(cloud['label'], NAMES[points.labels])
    packed = np.ascontiguousarray(cloud['rgb']).view(np.uint32)
    np.testing.assert_array_equal(
        packed, rgb.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32))


def test_points_in_another_frame_and_fewer_of_them(points, rgb):
    turn = RigidTransform.from_quaternion((0.1, 0.2, 0.3, 0.9), (1.0, -2.0, 3.0))
    thinned = replace(points, to_target=turn, decimation=2)
    cloud = cloud_array(points_to_msg(header(), thinned, rgb, NAMES))
    expected_m = turn.points(depth_to_points(points.depth_m, CAMERA))[::2, ::2]
    np.testing.assert_allclose(xyz(cloud), expected_m, atol=1e-5)
    np.testing.assert_array_equal(cloud['label'], NAMES[points.labels][::2, ::2])
    packed = np.ascontiguousarray(cloud['rgb']).view(np.uint32)
    np.testing.assert_array_equal(packed & 255, rgb[::2, ::2, 2])


@pytest.mark.parametrize('decimation', [1, 2])
def test_obstacles_are_the_valid_points_off_what_is_left_out(points, decimation):
    some = replace(points, decimation=decimation)
    msg = obstacles_to_msg(header(2.0), some, np.array([False, True, False, False]))
    assert [f.name for f in msg.fields] == ['x', 'y', 'z']
    assert (msg.height, msg.is_dense, msg.header) == (1, True, header(2.0))
    all_m = depth_to_points(points.depth_m, CAMERA)
    kept = (slice(None, None, decimation),) * 2
    wanted = (np.isfinite(all_m[..., 2]) & (points.labels != 1))[kept]
    assert 0 < msg.width == wanted.sum() < wanted.size
    assert len(msg.data) == 12 * msg.width
    found_m = xyz(cloud_array(msg)).reshape(-1, 3)
    np.testing.assert_array_equal(found_m, all_m[kept][wanted])


def test_obstacles_may_be_none(points):
    assert obstacles_to_msg(header(), points, np.ones(4, bool)).width == 0
