# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the inputs that are changed while the node is inactive or active."""

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from node_helpers import assert_true_to, change_state, send, small_room, start
from rclpy.parameter import Parameter
from ros_helpers import camera_info_msg, cloud_array, header, image_array, image_msg
from sensor_msgs.msg import Imu

from plane_detector.depth.observation import DepthFunction
from plane_detector.planes.classification import PlaneClass


@pytest.fixture
def room():
    return small_room()


def change(node, name, value):
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert result.successful, result.reason


def test_a_slop_that_is_set_while_the_node_is_inactive_is_used(robot, room):
    node = start(robot, depth__source='topic', stamp_slop=0.0)
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    change(node, 'stamp_slop', 0.5)
    assert change_state(robot, Transition.TRANSITION_ACTIVATE)
    robot.publish('camera_info', camera_info_msg(room.intrinsics, 1.0))
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    robot.publish('depth', image_msg(room.depth_m, '32FC1', 1.1))
    assert robot.wait_for('planes')[0].header == header(1.0)


def test_the_mounting_of_the_imu_changes_while_the_node_is_active(robot, room):
    node = start(robot, lambda rgb: room.depth_m, use_imu=True, directions__gravity=False)
    change(node, 'scale.imu_to_camera', [1.0, 0.0, 0.0, 0.0])  # half a turn about x
    imu = Imu(header=header(1.0))
    force = imu.linear_acceleration
    force.x, force.y, force.z = (-9.81 * room.gravity_camera * (1, -1, -1)).tolist()
    robot.publish('imu', imu)
    robot.spin(timeout_s=0.2)
    send(robot, room, 1.01)
    assert PlaneClass.FLOOR in cloud_array(robot.wait_for('planes')[0])[0]['class']


def test_measured_depth_is_subscribed_to_while_the_method_of_the_scale_uses_it(robot, room):
    disparity = (0.4 / room.depth_m - 0.03).astype(np.float32)
    node = start(robot, DepthFunction(lambda rgb: disparity, 'relative_disparity'),
                 scale__method='none')
    for method, count in (('depth_topic', 1), ('none', 0), ('auto', 1)):
        change(node, 'scale.method', method)
        assert robot.spin(lambda n=count: robot.node.count_subscribers('/depth') == n), method
    send(robot, room, 1.0, depth=True)
    robot.wait_for('planes')
    send(robot, room, 1.1, depth=True)
    planes = robot.wait_for('planes', 2)[1]
    assert_true_to(room, planes, image_array(robot.wait_for('labels', 2)[1], '<u2')[..., 0])
    assert robot.spin(lambda: robot.diagnosis()[1].get('scale') == 'depth_topic')
    assert robot.is_logged('depth_topic')
