# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Settings that are changed while the node is inactive or active, and one that is measured."""

import threading

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from node_helpers import assert_true_to, change_state, send, small_room, start
from onnx_models import write_depth_network
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_helpers import camera_info_msg, cloud_array, header, image_array, image_msg
from sensor_msgs.msg import Imu

from plane_detector.depth.observation import DepthFunction
from plane_detector.planes.classification import PlaneClass
from plane_detector.ros import live_settings
from plane_detector.shapes import detector


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


@pytest.fixture
def compiler(monkeypatch):
    """Return an event that ends the compiling of the shapes."""
    finished = threading.Event()

    def compile_slowly(subjects, tell, what='the loops'):
        if 'shapes' in subjects:
            tell(f'compiling {what}')
            finished.wait(60)

    monkeypatch.setattr(live_settings, 'compile_kernels', compile_slowly)
    monkeypatch.setattr(live_settings, 'are_ready', lambda subject: finished.is_set())
    yield finished
    finished.set()


def test_planes_are_found_while_the_loops_of_shapes_are_compiled(robot, room, monkeypatch,
                                                                  compiler):
    searched = []
    find = detector.find_shapes
    monkeypatch.setattr(detector, 'find_shapes',
                        lambda *given: searched.append(compiler.is_set()) or find(*given))
    start(robot, lambda rgb: room.depth_m)
    wanted = [Parameter('shapes.types', value='all').to_parameter_msg()]
    request = SetParameters.Request(parameters=wanted)
    assert robot.call(SetParameters, 'plane_detector/set_parameters',
                      request).results[0].successful
    for stamp_s in (1.0, 2.0):
        send(robot, room, stamp_s)
        assert robot.wait_for('planes', int(stamp_s))[-1].header == header(stamp_s)
    assert robot.log().count('compiling the loops of shapes.types') == 1
    assert robot.diagnosis()[1]['shapes'] == 'their loops are being compiled'
    compiler.set()
    assert robot.spin(lambda: 'shapes' not in robot.diagnosis()[1])
    send(robot, room, 3.0)
    robot.wait_for('planes', 3)
    assert searched == [True]


def test_log_and_diagnostics_name_the_input_chosen_for_target_rate(robot, tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx')
    start(robot, depth__model=str(path), depth__output='metric_depth', depth__short_side=140,
          depth__target_rate=1000.0, depth__input_scale=1.0, depth__mean=[0.0] * 3,
          depth__std=[1.0] * 3)
    values = {}
    while values.get('state') != 'active':  # a status may have been on its way before
        values = robot.diagnosis()[1]
    assert 'depth.target_rate 1000 Hz' in values['network_input_reason']
    assert ' x ' in values['network_input']
    assert values['network_input_reason'] in robot.log()
