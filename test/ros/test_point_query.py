# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The plane at a clicked point."""

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped
from node_helpers import CAMERA, send, small_room, start
from ros_helpers import FRAME_ID, cloud_array, header, image_array

from plane_detector.config import NodeConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.outputs.topics import DetectedFrame
from plane_detector.ros.point_query import plane_at, point_in_camera
from plane_detector.types import METRIC, Detection, Plane, Planes

WALL = Plane(np.array([0.0, 0.0, -1.0]), 2.0, np.array([0.1, 0.0, 2.0]), 10, 0.0, 1.0,
             np.eye(4), 1.0)
TO_MAP = RigidTransform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([5.0, 0, 1]))


def result_of(labels, to_target=None):
    found = Detection(Planes.of([WALL]), labels, 0.0, np.full(labels.shape, 2.0, np.float32),
                      METRIC)
    return DetectedFrame(found, CAMERA, to_target, header=header(1.0),
                         rgb=np.zeros((*labels.shape, 3), np.uint8),
                         settings=NodeConfig(target_frame='map' if to_target else ''))


def click_at(frame_id, point_m):
    msg = PointStamped(header=header(9.0))
    msg.header.frame_id = frame_id
    msg.point.x, msg.point.y, msg.point.z = point_m
    return msg


@pytest.fixture
def labels():
    labels = np.full((240, 320), -1, np.int32)
    labels[100:140, 100:200] = 0
    return labels


def test_the_pixel_that_shows_the_point_or_the_nearest(labels):
    result = result_of(labels)
    assert plane_at(result, np.array([0.0, 0.0, 2.0])) == 0
    six_px_above = np.array([0.0, (94 - CAMERA.cy) / CAMERA.fy * 2, 2.0])
    assert plane_at(result, six_px_above) == 0


@pytest.mark.parametrize('point_m, reason', [
    ((0.0, 0.0, -2.0), 'behind the camera'), ((9.0, 0.0, 2.0), 'not in the image'),
    ((np.inf, 0.0, 2.0), 'not in the image'), ((np.nan, 0.0, 2.0), 'not in the image'),
    ((1.0, 0.0, 1e-320), 'not in the image'),
    ((0.0, -0.6, 2.0), 'there is no plane')])
def test_a_click_without_a_plane_is_reported(labels, point_m, reason):
    with pytest.raises(ValueError, match=reason):
        plane_at(result_of(labels), np.array(point_m))


def test_a_click_is_in_the_frame_of_the_image_or_of_the_outputs(labels):
    in_map = result_of(labels, TO_MAP)
    np.testing.assert_allclose(point_in_camera(in_map, click_at('map', (7.0, 0.0, 1.0))),
                               [0, 0, 2], atol=1e-12)
    np.testing.assert_allclose(point_in_camera(in_map, click_at(FRAME_ID, (0.0, 0.0, 2.0))),
                               [0, 0, 2])
    with pytest.raises(ValueError, match='set target_frame to odom'):
        point_in_camera(in_map, click_at('odom', (7.0, 0.0, 1.0)))


def test_answers_to_many_clicks_are_logged_at_intervals(robot, monkeypatch):
    monkeypatch.setattr('plane_detector.ros.point_query._LOG_PERIOD_S', 1000.0)
    room = small_room()
    node = start(robot, lambda rgb: room.depth_m)
    robot.listen(PoseStamped, '/plane_detector/clicked_plane', 'clicked')
    row, column = np.argwhere(room.labels == 0)[len(np.argwhere(room.labels == 0)) // 2]
    z_m = float(room.depth_m[row, column])
    point_m = (float((column - CAMERA.cx) / CAMERA.fx * z_m),
               float((row - CAMERA.cy) / CAMERA.fy * z_m), z_m)
    node._query._clicks.extend([click_at(FRAME_ID, point_m)] * 10)
    send(robot, room, 1.0)
    assert len(robot.wait_for('clicked', 10)) == 10
    assert robot.is_logged('clicked point: plane')
    assert robot.log().count('clicked point: plane') == 1


def test_a_click_is_answered_by_the_node_even_on_demand(robot):
    room = small_room()
    node = start(robot, lambda rgb: room.depth_m, mode='on_demand')
    robot.listen(PoseStamped, '/plane_detector/clicked_plane', 'clicked')
    send(robot, room, 1.0)
    robot.settle()
    row, column = np.argwhere(room.labels == 0)[len(np.argwhere(room.labels == 0)) // 2]
    z_m = float(room.depth_m[row, column])
    point_m = (float((column - CAMERA.cx) / CAMERA.fx * z_m),
               float((row - CAMERA.cy) / CAMERA.fy * z_m), z_m)
    robot.publish('clicked_point', click_at(FRAME_ID, point_m))
    assert robot.spin(lambda: node._query.is_waiting)
    send(robot, room, 2.0)
    (clicked,) = robot.wait_for('clicked')
    assert clicked.header == header(2.0)
    label = image_array(robot.wait_for('labels')[0], '<u2')[row, column, 0]
    table = cloud_array(robot.wait_for('planes')[0])[0]
    index = table['label'].tolist().index(label)
    assert robot.wait_for('plane_poses')[0].poses[index] == clicked.pose
    assert robot.is_logged(f'clicked point: plane {label}')
