# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What is written as CDR is what rclpy makes of the same messages."""

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion, Vector3
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from plane_detector.ros.outputs.cdr import MarkerValues, serialised_markers, serialised_poses

LIFETIME_S = 1.5


def stamped(frame_id):
    message = Header(frame_id=frame_id)
    message.stamp.sec, message.stamp.nanosec = -7, 999_999_999
    return message


def of(message_class, names, numbers):
    return message_class(**dict(zip(names, numbers, strict=True)))


def as_message(header, values):
    return Marker(
        header=header, ns=values.namespace, id=values.label, type=values.kind,
        action=values.action, text=values.text, color=of(ColorRGBA, 'rgba', values.rgba),
        pose=Pose(position=of(Point, 'xyz', values.position_m),
                  orientation=of(Quaternion, 'xyzw', values.orientation)),
        scale=of(Vector3, 'xyz', values.scale_m),
        lifetime=Duration(seconds=LIFETIME_S).to_msg(),
        points=[of(Point, 'xyz', point_m) for point_m in values.points_m.tolist()])


def same_bytes(written, message):
    """Return whether both have one length and content; padding is not initialised by rclpy."""
    by_rclpy = serialize_message(message)
    assert len(written) == len(by_rclpy)
    return deserialize_message(written, type(message)) == message


@pytest.mark.parametrize('frame_id', ['', 'a', 'ab', 'abc', 'abcd', 'camera_m\u00fcnze'])
def test_markers_at_every_alignment(frame_id):
    points_m = np.random.default_rng(0).normal(size=(5, 3))
    values = [MarkerValues('n' * k, k, 4, k % 3, (0.25, 0.5, 0.75, 1.0), (0.1, 0.2, 0.3),
                           points_m[:k % 6], (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5), 't' * (k // 2))
              for k in range(12)]
    header = stamped(frame_id)
    expected = MarkerArray(markers=[as_message(header, one) for one in values])
    assert same_bytes(serialised_markers(header, values, LIFETIME_S), expected)


def test_no_marker_and_no_pose():
    assert same_bytes(serialised_markers(stamped('a'), [], 0.0), MarkerArray())
    empty = np.zeros((0, 3)), np.zeros((0, 4))
    assert same_bytes(serialised_poses(stamped('a'), *empty), PoseArray(header=stamped('a')))


@pytest.mark.parametrize('frame_id', ['', 'abcd', 'abcdefgh'])
def test_poses_at_every_alignment(frame_id):
    numbers = np.random.default_rng(0).normal(size=(2, 7))
    poses = [Pose(position=of(Point, 'xyz', row[:3]), orientation=of(Quaternion, 'xyzw', row[3:]))
             for row in numbers.tolist()]
    written = serialised_poses(stamped(frame_id), numbers[:, :3], numbers[:, 3:])
    assert same_bytes(written, PoseArray(header=stamped(frame_id), poses=poses))
