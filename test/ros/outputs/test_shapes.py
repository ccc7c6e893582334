# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes as messages."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('rclpy')
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from plane_detector.ros.outputs.cdr import serialised_markers
from plane_detector.ros.outputs.markers import scene_markers
from plane_detector.ros.outputs.messages import FIRST_SHAPE_LABEL, pixel_labels
from plane_detector.ros.outputs.shapes import NAMESPACE, SHAPE_DTYPE, shapes_to_msg
from plane_detector.types import CameraIntrinsics, Detection, Shape, ShapeType

AXIS = np.array([0.6, 0.0, 0.8])
SHAPES = tuple(Shape(kind, np.array([1.0, 2.0, 3.0]), axis, radius, angle, length, 50, 0.01,
                     np.eye(dof), 0.8) for kind, axis, radius, angle, length, dof in (
    (ShapeType.SPHERE, np.zeros(3), 0.5, 0.0, 0.0, 4),
    (ShapeType.CYLINDER, AXIS, 0.2, 0.0, 1.5, 5),
    (ShapeType.CONE, AXIS, 0.0, 0.4, 0.9, 6)))
CAMERA = CameraIntrinsics(50, 50, 9.5, 9.5, 20, 20)


@pytest.fixture
def detection():
    labels = np.full((20, 20), -1, np.int32)
    labels[:5], labels[5:10], labels[10:15] = 0, 1, 2
    return Detection((), labels, 0.0, np.ones((20, 20), np.float32), 'metric', shapes=SHAPES,
                     shape_labels=(7, 2, 5))


def test_cloud_holds_every_field(detection):
    msg = shapes_to_msg(Header(frame_id='camera'), detection)
    table = np.frombuffer(msg.data, SHAPE_DTYPE)
    assert [field.name for field in msg.fields] == list(SHAPE_DTYPE.names)
    assert (msg.height, msg.width, msg.header.frame_id) == (1, 3, 'camera')
    assert table['type'].tolist() == [1, 2, 3]
    assert table['label'].tolist() == [FIRST_SHAPE_LABEL + k for k in (7, 2, 5)]
    assert table['radius'] == pytest.approx([0.5, 0.2, 0.0])
    assert table['half_angle'] == pytest.approx([0.0, 0.0, 0.4])
    assert table['length'] == pytest.approx([0.0, 1.5, 0.9])
    assert [table[f'axis_{c}'][1] for c in 'xyz'] == pytest.approx(AXIS.tolist())


def test_pixels_carry_the_labels_of_the_shapes(detection):
    labels = pixel_labels(detection)
    assert labels[0, 0] == FIRST_SHAPE_LABEL + 7
    assert labels[12, 0] == FIRST_SHAPE_LABEL + 5
    assert labels[19, 19] == 0


def test_markers_show_the_shapes_and_delete_lost_ones(detection):
    gone = FIRST_SHAPE_LABEL + 9
    markers = scene_markers(detection, [()] * len(detection.planes), [], {gone})
    msg = deserialize_message(serialised_markers(Header(), markers, 0.0), MarkerArray)
    shown = {m.id: m for m in msg.markers if m.ns == NAMESPACE and m.action == Marker.ADD}
    assert [shown[FIRST_SHAPE_LABEL + k].type for k in (7, 2, 5)] == [
        Marker.SPHERE, Marker.CYLINDER, Marker.TRIANGLE_LIST]
    assert shown[FIRST_SHAPE_LABEL + 2].scale.z == pytest.approx(1.5)
    q = shown[FIRST_SHAPE_LABEL + 2].pose.orientation
    np.testing.assert_allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([0, 0, 1]), AXIS,
                               atol=1e-6)
    rim_m = [np.array([p.x, p.y, p.z]) for p in shown[FIRST_SHAPE_LABEL + 5].points]
    assert max(np.linalg.norm(p[:2]) for p in rim_m) == pytest.approx(0.9 * np.tan(0.4), rel=1e-6)
    deleted = [m for m in msg.markers if m.action == Marker.DELETE]
    assert (NAMESPACE, gone) in {(m.ns, m.id) for m in deleted}


def test_no_shape_is_an_empty_cloud(detection):
    empty = Detection((), detection.labels * 0 - 1, 0.0, detection.depth_m, 'metric')
    msg = shapes_to_msg(Header(), empty)
    assert (msg.width, len(msg.data)) == (0, 0)
