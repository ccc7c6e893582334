# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node under control: parameters, services, lifecycle, quality of service."""

from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from node_helpers import CAMERA, change_state, send, small_room, start
from onnx_models import millimetres_as_rgb, write_depth_network
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import Robot, camera_info_msg, cloud_array, header, image_msg
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger


@pytest.fixture
def room():
    return small_room()


def test_on_demand_one_frame_per_call_that_is_answered_when_it_is_done(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    send(robot, room, 1.0)
    robot.spin(timeout_s=0.5)
    assert not robot.received['planes']
    answer = robot.ask(Trigger, 'plane_detector/detect')
    robot.spin(timeout_s=0.3)
    assert not answer.done(), 'no frame has come since'
    for stamp_s in (2.0, 3.0):
        send(robot, room, stamp_s)
        robot.spin(timeout_s=0.5)
    assert [msg.header for msg in robot.received['planes']] == [header(2.0)]
    assert robot.spin(answer.done)
    assert answer.result().success
    count = robot.received['planes'][0].width
    assert answer.result().message == f'{count} planes in the image of 2.000000000'


def test_a_call_without_a_frame_is_answered_with_the_reason(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    send(robot, room, 1.0)
    answer = robot.ask(Trigger, 'plane_detector/detect')
    robot.spin(timeout_s=0.2)
    robot.publish('image', image_msg(room.rgb, 'rgb32', 2.0))
    assert robot.spin(answer.done)
    assert not answer.result().success
    assert 'rgb32' in answer.result().message
    answer = robot.ask(Trigger, 'plane_detector/detect')
    robot.spin(timeout_s=0.2)
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert robot.spin(answer.done)
    assert answer.result().message == 'the node is not active'


def test_nothing_is_computed_without_subscribers(room):
    """But for calls; the diagnostics say so."""
    calls = []
    robot = Robot(outputs=())
    try:
        start(robot, lambda rgb: calls.append(1) or room.depth_m)
        send(robot, room, 1.0)
        robot.spin(timeout_s=0.5)
        assert not calls
        assert robot.diagnosis()[0].message == 'idle: nobody listens to an output'
        answer = robot.ask(Trigger, 'plane_detector/detect')
        robot.spin(timeout_s=0.2)
        send(robot, room, 2.0)
        assert robot.spin(answer.done)
        assert len(calls) == 1
    finally:
        robot.shutdown()


def labels_of(planes):
    return cloud_array(planes)[0]['label'].tolist()


def test_labels_stay_until_tracking_is_reset(robot, room):
    """The largest plane goes out of view: the others keep their labels, until the reset."""
    largest = np.bincount(room.labels[room.labels >= 0]).argmax()
    without = np.where(room.labels == largest, np.nan, room.depth_m).astype(np.float32)
    depths = [room.depth_m, without, without]
    start(robot, lambda rgb: depths.pop(0))
    send(robot, room, 1.0)
    first = labels_of(robot.wait_for('planes')[0])
    assert first == list(range(1, len(first) + 1))
    send(robot, room, 1.1)
    second = labels_of(robot.wait_for('planes', 2)[1])
    assert 1 not in second
    assert set(second) <= set(first)
    assert robot.call(Trigger, 'plane_detector/reset_tracking').success
    send(robot, room, 1.2)
    third = labels_of(robot.wait_for('planes', 3)[2])
    assert third == list(range(1, len(third) + 1))


def test_parameters_change_between_frames(robot, room):
    node = start(robot, lambda rgb: room.depth_m)
    send(robot, room, 1.0)
    assert robot.wait_for('planes')[0].width > 1
    (result,) = node.set_parameters([Parameter('segmentation.max_planes', value=1)])
    assert result.successful
    send(robot, room, 2.0)
    assert robot.wait_for('planes', 2)[1].width == 1


@pytest.mark.parametrize('name, value, reason', [
    ('segmentation.max_planes', 0, 'out of range'),
    ('segmentation.max_planes', 2.0, 'type'),
    ('mode', 'sometimes', 'must be one of'),
    ('depth.model', 'other.onnx', 'depth.model: read when the node is configured')])
def test_impossible_changes_are_refused_and_change_nothing(robot, name, value, reason):
    node = start(robot, lambda rgb: None)
    before = node.get_parameter(name).value
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert node.get_parameter(name).value == before


def test_configuring_fails_with_the_reason_and_can_be_tried_again(robot, tmp_path):
    node = start(robot, wait=False, depth__model=str(tmp_path / (200 * 'm') / 'missing.onnx'),
                 depth__output='metric_depth')
    status, values = robot.diagnosis()
    assert status.level == DiagnosticStatus.ERROR
    assert values['last_error'].endswith('metric3d_v2_small'), 'the whole reason'
    assert node.state == 'unconfigured'
    assert not change_state(robot, Transition.TRANSITION_CONFIGURE)


def test_settings_read_at_configure_can_be_set_before(robot, room, tmp_path):
    """A wrong network is mended without a restart; a dump loads quietly into an active node."""
    network = write_depth_network(tmp_path / 'network.onnx', height=240, width=320)
    node = start(robot, wait=False, depth__model=str(tmp_path / 'missing.onnx'),
                 depth__output='metric_depth', depth__mean=[0, 0, 0], depth__std=[1, 1, 1])
    assert robot.is_logged('cannot be configured')
    model = Parameter('depth.model', value=str(network))
    assert node.set_parameters([model])[0].successful
    assert change_state(robot, Transition.TRANSITION_CONFIGURE)
    assert change_state(robot, Transition.TRANSITION_ACTIVATE)
    assert node.set_parameters([model])[0].successful, 'the same value again'
    assert node.set_parameters([Parameter('scale.camera_height', value=1)])[0].successful
    assert node.get_parameter('scale.camera_height').value == 1.0
    check_that_a_dump_loads(robot, node)
    send(robot, replace(room, rgb=millimetres_as_rgb(room.depth_m)), 1.0)
    robot.wait_for('planes')
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        assert change_state(robot, transition)
    assert node.set_parameters([Parameter('depth.source', value='topic')])[0].successful
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        assert change_state(robot, transition)
    assert 'topic' in robot.diagnosis()[1]['depth_model']


def check_that_a_dump_loads(robot, node):
    """As `ros2 param load` does: all that there is, the read-only qos_overrides among it."""
    names = list(node.get_parameters_by_prefix(''))
    before = node.get_parameters(names)
    request = SetParameters.Request(parameters=[value.to_parameter_msg() for value in before])
    results = robot.call(SetParameters, 'plane_detector/set_parameters', request).results
    assert any(name.startswith('qos_overrides') for name in names)
    assert [result.reason for result in results if not result.successful] == []
    after = node.get_parameters(names)
    assert all(map(np.array_equal, [p.value for p in after], [p.value for p in before]))
    fixed = next(value for value in before if value.name.endswith('.depth') and value.value == 2)
    (result,) = node.set_parameters([Parameter(fixed.name, value=3)])
    assert 'read-only' in result.reason, 'another value is refused as before'


def test_lifecycle_without_autostart(robot, room):
    node = start(robot, lambda rgb: room.depth_m, wait=False, autostart=False)
    robot.spin(timeout_s=0.3)
    assert node.state == 'unconfigured'
    assert not robot.call(Trigger, 'plane_detector/detect').success
    assert not change_state(robot, Transition.TRANSITION_ACTIVATE), 'not from unconfigured'
    for _ in range(2):
        assert change_state(robot, Transition.TRANSITION_CONFIGURE)
        assert node.state == 'inactive'
        assert change_state(robot, Transition.TRANSITION_ACTIVATE)
        count = len(robot.received['planes'])
        send(robot, room)
        robot.wait_for('planes', count + 1)
        assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
        assert node.count_subscribers('image') == 0
        assert change_state(robot, Transition.TRANSITION_CLEANUP)
        assert node.state == 'unconfigured'
        assert node.count_publishers('plane_detector/planes') == 0


def reliabilities(robot):
    """Return the reliability of each subscription to the image."""
    return [info.qos_profile.reliability
            for info in robot.node.get_subscriptions_info_by_topic('/image')]


def test_reliability_follows_the_publishers(robot, room):
    start(robot, lambda rgb: room.depth_m)
    robot.publish('camera_info', camera_info_msg(CAMERA, 1.0))
    assert robot.spin(lambda: reliabilities(robot) == [ReliabilityPolicy.BEST_EFFORT])
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    robot.wait_for('planes')
    robot.publish('image', image_msg(room.rgb, 'rgb8', 2.0))
    robot.wait_for('planes', 2)
    assert robot.spin(lambda: reliabilities(robot) == [ReliabilityPolicy.RELIABLE])
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    other = robot.node.create_publisher(Image, 'image', best_effort)
    assert robot.spin(lambda: other.get_subscription_count() > 0)
    other.publish(image_msg(room.rgb, 'rgb8', 3.0))
    robot.wait_for('planes', 3)
    assert robot.spin(lambda: reliabilities(robot) == [ReliabilityPolicy.BEST_EFFORT])
    robot.publish('image', image_msg(room.rgb, 'rgb8', 4.0))
    planes = robot.wait_for('planes', 4)
    assert [msg.header for msg in planes] == [header(s) for s in (1.0, 2.0, 3.0, 4.0)]


def test_reliable_asked_for_of_a_best_effort_camera_names_the_parameter(robot):
    start(robot, lambda rgb: None, input_reliability='reliable')
    robot.node.create_publisher(
        Image, 'image', QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert robot.is_logged('the parameter input_reliability asks for reliable')


def test_a_paused_simulation_does_not_stop_the_node(robot, room):
    start(robot, lambda rgb: room.depth_m, use_sim_time=True)
    send(robot, room, 3.0)
    assert robot.wait_for('planes')[0].header == header(3.0)
    assert robot.diagnosis()[0].level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)
