# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds and images out."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray
from rclpy.serialization import deserialize_message
from ros_helpers import header, image_array
from scipy.spatial.transform import Rotation

from plane_detector.ros.outputs import messages
from plane_detector.types import CameraIntrinsics, Detection, Plane

CAMERA = CameraIntrinsics(500.0, 510.0, 319.5, 239.5, 640, 480)


def make_plane(normal, offset_m):
    normal = np.asarray(normal, float)
    return Plane(normal, offset_m, -offset_m * normal, 1234, 0.003, 2.5, np.eye(4), 0.75)


def test_labels_in_messages_are_above_zero():
    planes = (make_plane([0, 0, -1], 2.0), make_plane([0, -1, 0], 1.0))
    labels = np.array([[-1, 0], [1, 0]], np.int32)
    untracked = Detection(planes, labels, 0.0, np.ones((2, 2), np.float32), 'metric')
    np.testing.assert_array_equal(messages.plane_labels(untracked), [1, 2])
    np.testing.assert_array_equal(messages.pixel_labels(untracked), [[0, 1], [2, 1]])
    tracked = replace(untracked, track_labels=(7, 3))
    np.testing.assert_array_equal(messages.plane_labels(tracked), [7, 3])
    np.testing.assert_array_equal(messages.pixel_labels(tracked), [[0, 7], [3, 7]])


@pytest.mark.parametrize('normal', [[0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, -1, 0], [0.6, 0, -0.8]])
def test_z_of_a_pose_is_the_normal(normal):
    plane = make_plane(normal, 2.0)
    (pose,) = deserialize_message(messages.plane_poses(header(), (plane,)), PoseArray).poses
    q = pose.orientation
    axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    np.testing.assert_allclose(axes[:, 2], normal, atol=1e-12)
    np.testing.assert_allclose([pose.position.x, pose.position.y, pose.position.z],
                               plane.centroid_m)


def test_images():
    labels = np.array([[0, 1, 300]], np.uint32)
    msg = messages.labels_to_msg(header(3.0), labels)
    assert (msg.encoding, msg.step, msg.header) == ('16UC1', 6, header(3.0))
    np.testing.assert_array_equal(image_array(msg, '<u2')[..., 0], labels)
    depth_m = np.array([[1.5, np.nan]], np.float32)
    msg = messages.depth_to_msg(header(), depth_m)
    assert (msg.encoding, msg.step) == ('32FC1', 8)
    np.testing.assert_array_equal(image_array(msg, '<f4')[..., 0], depth_m)
    rgb = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    msg = messages.rgb_to_msg(header(), rgb)
    assert (msg.encoding, msg.step, msg.height, msg.width) == ('rgb8', 6, 2, 2)
    np.testing.assert_array_equal(image_array(msg, 'u1', 3), rgb)
