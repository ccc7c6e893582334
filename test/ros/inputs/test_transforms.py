# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms over time, and their use by the node."""


import numpy as np
import pytest
from field_faults import changed
from rclpy.time import Time
from ros_helpers import header, transform_msg

from plane_detector.config import NodeConfig, ScaleConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.inputs.transforms import (
    FrameTransforms,
    TransformBuffer,
    TransformError,
    transform_from_msg,
)

OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # x right, y down, z forward in a body frame of x forward, z up


def robot_buffer(height_m=1.2, stamps_s=(1.0, 2.0)):
    """Return a robot that drives a metre along x of odom, with a camera on it."""
    buffer = TransformBuffer()
    buffer.add(transform_msg('base_footprint', 'base_link', (0.0, 0.0, 0.2)), is_static=True)
    buffer.add(transform_msg('base_link', 'camera_optical_frame', (0.1, 0.0, height_m - 0.2),
                             OPTICAL), is_static=True)
    for stamp_s in stamps_s:
        buffer.add(transform_msg('odom', 'base_footprint', (stamp_s, 0.0, 0.0), stamp_s=stamp_s))
    return buffer


def looked_up(buffer, target, source, stamp_s=1.5):
    return transform_from_msg(buffer.lookup_transform(target, source, Time(seconds=stamp_s)))


def test_along_the_tree_and_back():
    buffer = robot_buffer()
    forth = looked_up(buffer, 'odom', 'camera_optical_frame')
    np.testing.assert_allclose(forth.points(np.array([0.0, 1.2, 3.0])), [1.5 + 0.1 + 3.0, 0, 0],
                               atol=1e-9)
    back = looked_up(buffer, 'camera_optical_frame', 'odom').after(forth)
    np.testing.assert_allclose(back.translation_m, 0, atol=1e-9)


@pytest.mark.parametrize('target, stamp_s', [('odom', 0.9), ('odom', 2.1), ('map', 1.5)])
def test_an_unknown_frame_is_an_error(target, stamp_s):
    with pytest.raises(TransformError):
        looked_up(robot_buffer(), target, 'camera_optical_frame', stamp_s)


@pytest.mark.parametrize('stamp_s', [0.5, 1.5, 9.0])
def test_frames_joined_by_static_transforms_need_no_other(stamp_s):
    """The robot's place in odom is known from 1 to 2 s only; its camera stays where it is."""
    found = looked_up(robot_buffer(), 'base_footprint', 'camera_optical_frame', stamp_s)
    np.testing.assert_allclose(found.translation_m, [0.1, 0, 1.2], atol=1e-9)


def test_a_circle_of_frames_is_an_error_too():
    buffer = TransformBuffer()
    buffer.add(transform_msg('a', 'b'), is_static=True)
    buffer.add(transform_msg('b', 'a'), is_static=True)
    with pytest.raises(TransformError):
        looked_up(buffer, 'map', 'a')


def test_a_frame_with_another_parent_leaves_the_one_before():
    buffer = robot_buffer()
    buffer.add(transform_msg('map', 'base_footprint', (7.0, 0.0, 0.0)), is_static=True)
    assert looked_up(buffer, 'map', 'base_footprint').translation_m[0] == 7
    with pytest.raises(TransformError):
        looked_up(buffer, 'odom', 'base_footprint')


def test_a_frame_that_gets_another_parent_keeps_the_times_before():
    """A mug on a table, lifted by a gripper at 2 s."""
    buffer = TransformBuffer()
    for stamp_s in (1.0, 3.0):
        buffer.add(transform_msg('world', 'table', (5.0, 0.0, 0.0), stamp_s=stamp_s))
        buffer.add(transform_msg('world', 'gripper', (0.0, stamp_s, 0.0), stamp_s=stamp_s))
    for stamp_s in (1.0, 1.5):
        buffer.add(transform_msg('table', 'mug', (0.0, 0.0, 0.7), stamp_s=stamp_s))
    for stamp_s in (2.0, 3.0):
        buffer.add(transform_msg('gripper', 'mug', (0.0, 0.0, -0.1), stamp_s=stamp_s))
    for stamp_s, expected_m in ((1.25, (5, 0, 0.7)), (1.75, (5, 0, 0.7)), (2.5, (0, 2.5, -0.1))):
        found = looked_up(buffer, 'world', 'mug', stamp_s)
        np.testing.assert_allclose(found.translation_m, expected_m, atol=1e-9)


def test_gravity_and_height_of_the_camera():
    transforms = FrameTransforms(robot_buffer(height_m=0.9))
    pose = transforms.camera_pose(header(1.5), NodeConfig(base_frame='base_footprint'))
    np.testing.assert_allclose(pose.gravity_camera, [0, 1, 0], atol=1e-9)
    assert pose.height_m == pytest.approx(0.9)
    below = FrameTransforms(robot_buffer(height_m=-0.9))
    assert below.camera_pose(header(1.5), NodeConfig(base_frame='base_footprint')).height_m is None


def test_into_the_target_frame():
    to_odom = FrameTransforms(robot_buffer()).to_target(header(1.25), NodeConfig(
        target_frame='odom'))
    assert isinstance(to_odom, RigidTransform)
    np.testing.assert_allclose(to_odom.translation_m, [1.35, 0, 1.2], atol=1e-9)


@pytest.mark.parametrize('value', [np.nan, np.inf, -1e308, 1e308, 2e9])
@pytest.mark.parametrize('field', ['translation.x', 'translation.z'])
def test_a_transform_to_nowhere_is_refused(field, value):
    """One field at a time: float32 cannot hold what it moves."""
    with pytest.raises(ValueError, match='not finite, or above 1e'):
        TransformBuffer().add(changed(transform_msg('a', 'b'), f'transform.{field}', value))


def test_the_mounting_of_an_imu_must_be_a_rotation():
    """One field at a time: the length of this one is zero in floating point."""
    for tiny in (0.0, 1e-308):
        with pytest.raises(ValueError, match='imu_to_camera must be a quaternion'):
            ScaleConfig(imu_to_camera=(tiny,) * 4)
