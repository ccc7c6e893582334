# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node under control: parameters, services, lifecycle, quality of service."""


import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from node_helpers import CAMERA, change_state, send, small_room, start
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
    assert set(second) & set(first) == set(first) - {1}
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
    sent_s = send_until(robot, lambda stamp_s: robot.publish(
        'image', image_msg(room.rgb, 'rgb8', stamp_s)), ReliabilityPolicy.RELIABLE, [])
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    other = robot.node.create_publisher(Image, 'image', best_effort)
    assert robot.spin(lambda: other.get_subscription_count() > 0)
    sent_s = send_until(robot, lambda stamp_s: other.publish(
        image_msg(room.rgb, 'rgb8', stamp_s)), ReliabilityPolicy.BEST_EFFORT, sent_s)
    planes = robot.wait_for('planes', len(sent_s))
    assert [msg.header for msg in planes] == [header(stamp_s) for stamp_s in sent_s]


def send_until(robot, publish, reliability, sent_s):
    """Send images, each after the planes of the one before, until the node asks for this."""
    while reliabilities(robot) != [reliability]:
        assert len(sent_s) < 1000
        sent_s = [*sent_s, len(sent_s) + 1.0]
        publish(sent_s[-1])
        robot.wait_for('planes', len(sent_s))
    return sent_s


def test_a_paused_simulation_does_not_stop_the_node(robot, room):
    start(robot, lambda rgb: room.depth_m, use_sim_time=True)
    send(robot, room, 3.0)
    assert robot.wait_for('planes')[0].header == header(3.0)
    assert robot.diagnosis()[0].level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)
