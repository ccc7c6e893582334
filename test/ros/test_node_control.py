# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node under control: parameters, services, lifecycle, quality of service."""

import json
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from node_helpers import CAMERA, assert_true_to, change_state, send, start
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import Robot, camera_info_msg, cloud_array, header, image_array, image_msg
from sensor_msgs.msg import Image, Imu
from std_srvs.srv import Trigger

from plane_detector.depth.networks import NETWORKS
from plane_detector.depth.observation import DepthFunction
from plane_detector.planes.classification import PlaneClass
from plane_detector.ros import detector_node, diagnostics, live_settings, transitions
from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.diagnostics import Report, introduction, large_image, slow_network
from plane_detector.shapes import detector


def test_on_demand_one_frame_per_call_that_is_answered_when_it_is_done(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    send(robot, room, 1.0)
    robot.settle()
    answer = robot.ask(Trigger, 'plane_detector/detect')
    robot.spin(timeout_s=0.3)
    assert not answer.done() and not robot.received['planes'], 'no frame has come since'
    send(robot, room, 2.0)
    robot.settle()
    send(robot, room, 3.0)
    assert robot.spin(lambda: answer.done() and robot.received['planes'])
    robot.spin(timeout_s=0.3)
    assert [msg.header for msg in robot.received['planes']] == [header(2.0)]
    assert answer.result().success
    count = robot.received['planes'][0].width
    assert answer.result().message == f'{count} planes in the image of 2.000000000'


def test_planes_are_returned_as_json(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    send(robot, room, 1.0)
    robot.settle()
    answer = robot.ask(Trigger, 'plane_detector/get_planes')
    send(robot, room, 2.0)
    assert robot.spin(answer.done)
    assert answer.result().success
    found = json.loads(answer.result().message)
    assert (found['stamp'], found['units']['d']) == ('2.000000000', 'm')
    rows = cloud_array(robot.wait_for('planes')[0])[0]
    assert [plane['label'] for plane in found['planes']] == rows['label'].tolist()
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    refused = robot.call(Trigger, 'plane_detector/get_planes')
    assert (refused.success, refused.message) == (False, 'the node is not active')


def test_a_call_without_a_frame_is_answered_with_the_reason(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    send(robot, room, 1.0)
    robot.settle()
    answer = robot.ask(Trigger, 'plane_detector/detect')
    robot.publish('image', image_msg(room.rgb, 'rgb32', 2.0))
    assert robot.spin(answer.done)
    assert not answer.result().success
    assert 'rgb32' in answer.result().message
    answer = robot.ask(Trigger, 'plane_detector/detect')
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
    assert min(set(second) - set(first), default=len(first) + 1) > len(first)
    assert robot.call(Trigger, 'plane_detector/reset_tracking').success
    send(robot, room, 1.2)
    third = labels_of(robot.wait_for('planes', 3)[2])
    assert third == list(range(1, len(third) + 1))


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
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert not node.set_parameters([Parameter(name, value=value)])[0].successful


def test_dumped_parameters_start_the_same_node(robot, tmp_path):
    """What ros2 param dump writes: the parameters nested by the points in their names."""
    def active(**options):
        node = PlaneDetectorNode(lambda rgb: None, context=robot.context, **options)
        robot.add(node)
        assert robot.spin(lambda: node.state == 'active')
        return {name: parameter_value_to_python(node.get_parameter(name).get_parameter_value())
                for name in node.list_parameters([], 0).names}

    values = active() | {'segmentation.max_planes': 5, 'depth.source': 'topic'}
    dumped = tmp_path / 'dumped.yaml'
    dumped.write_text(yaml.safe_dump({'/plane_detector': {'ros__parameters': nested(values)}}))
    again = active(cli_args=['--ros-args', '--params-file', str(dumped)])
    assert {name: again[name] for name in values} == values


def nested(values):
    tree = {}
    for name, value in values.items():
        *groups, leaf = name.split('.')
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
        node[leaf] = list(value) if isinstance(value, (list, tuple)) else value
    return tree


def test_configuring_fails_with_the_reason_and_can_be_tried_again(robot, tmp_path, monkeypatch):
    """Before loops are compiled."""
    pytest.importorskip('onnxruntime', reason='names of networks need ONNX Runtime')
    compiled = []
    monkeypatch.setattr(detector_node, 'load_kernels', lambda *_: compiled.append(1))
    node = start(robot, wait=False, depth__model=str(tmp_path / (200 * 'm') / 'missing.onnx'),
                 depth__output='metric_depth')
    assert robot.is_logged('cannot be configured')
    status, values = robot.diagnosis()
    assert status.level == DiagnosticStatus.ERROR
    assert values['last_error'].endswith([*NETWORKS][-1]), 'the whole reason'
    assert node.state == 'unconfigured'
    assert not change_state(robot, Transition.TRANSITION_CONFIGURE)
    assert not compiled


def test_lifecycle_without_autostart(robot, room):
    node = start(robot, lambda rgb: room.depth_m, wait=False, autostart=False)
    assert robot.is_logged('waiting for a lifecycle manager, or for ros2 lifecycle set '
                           '/plane_detector configure, then activate')
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
        assert robot.spin(lambda: node.count_subscribers('image') == 0)
        assert change_state(robot, Transition.TRANSITION_CLEANUP)
        assert node.state == 'unconfigured'
        assert robot.spin(lambda: node.count_publishers('plane_detector/planes') == 0)
    for state in ('active', 'inactive', 'unconfigured'):
        assert robot.log().count(f'[plane_detector]: {state}\n') == 2


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
    robot.settle()  # before the image
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
    assert robot.is_logged('compiling the kernels of shapes.types')
    assert robot.log().count('compiling the kernels of shapes.types') == 1
    assert robot.diagnosis()[1]['shapes'] == 'their kernels are being compiled'
    compiler.set()
    assert robot.spin(lambda: 'compiled' not in robot.diagnosis()[1]['shapes'])
    send(robot, room, 3.0)
    robot.wait_for('planes', 3)
    assert searched == [True]


def test_planes_are_found_while_the_loops_of_drops_are_compiled(robot, room, monkeypatch):
    begun, finished = [], threading.Event()
    monkeypatch.setattr(detector_node, 'compile_kernels', lambda subjects, *_: (
        begun.append(subjects), finished.wait(60)))
    start(robot, lambda rgb: room.depth_m)
    send(robot, room, 1.0)
    assert robot.wait_for('planes', 1)[-1].header == header(1.0)
    assert begun == [['ground_pixels']] and not finished.is_set()
    finished.set()


def test_loops_that_cannot_be_compiled_later_are_said(robot, room, monkeypatch):
    def fail(*_):
        raise MemoryError('no room')

    monkeypatch.setattr(detector_node, 'compile_kernels', fail)
    monkeypatch.setattr(diagnostics, 'are_ready', lambda subject: False)
    start(robot, lambda rgb: room.depth_m, scale__gravity=room.gravity_camera.tolist())
    assert robot.is_logged('no ground, obstacles and drops, because their kernels cannot be '
                           'compiled')
    send(robot, room, 1.0)
    assert robot.wait_for('planes', 1)[-1].header == header(1.0)
    assert robot.spin(lambda: 'drops' in robot.diagnosis()[1])
    drops = robot.diagnosis()[1]['drops']
    assert 'MemoryError: no room' in drops and 'restart the node' in drops


@pytest.fixture
def tries(monkeypatch):
    """Let the pipeline be made at the third try only, and return the errors to come."""
    errors = [ConnectionError('unreachable'), FileNotFoundError('unreachable')]
    make = detector_node.PlaneDetector

    def make_detector(*arguments):
        if errors:
            raise errors.pop()
        return make(*arguments)

    monkeypatch.setattr(detector_node, 'PlaneDetector', make_detector)
    monkeypatch.setattr(transitions, 'FIRST_PAUSE_S', 0.05)
    return errors


def test_temporary_failures_are_retried_after_growing_pauses(robot, tries):
    node = start(robot, lambda rgb: None, wait=False)
    assert robot.spin(lambda: node.state == 'active')
    assert robot.log().count('unreachable') == 2
    assert not robot.diagnosis()[1]['state'].startswith('unconf')


def test_a_wrong_setting_is_not_retried(robot, tries):
    tries[:] = [ValueError('no provider runs')] * 5
    node = start(robot, lambda rgb: None, wait=False)
    assert robot.is_logged('no provider runs')
    robot.spin(timeout_s=0.5)
    assert node.state == 'unconfigured'
    assert len(tries) == 4


def test_the_log_at_configure_is_three_lines():
    facts = {'depth_model': 'a network', 'depth_model_reason': 'as requested',
             'execution_provider': 'on a GPU'}
    topics = {'image': '/image', 'camera_info': '/camera_info'}
    assert introduction(facts, topics, '/plane_detector/planes') == [
        'depth from a network, on a GPU', 'as requested',
        '/image, /camera_info -> /plane_detector/planes and the other outputs']


def test_a_network_that_is_slower_than_the_camera_is_reported_with_both_times():
    report = Report(1, 0, 0, 2.5, {'depth': 0.4, 'segmentation': 0.01}, arrival_hz=10.0)
    assert slow_network(report, '686 x 518').startswith(
        'the network takes 400 ms for an input of 686 x 518, the camera sends an image every '
        '100 ms: set a smaller depth.short_side (half takes a quarter)')
    assert not slow_network(replace(report, arrival_hz=2.5), '686 x 518')
    assert not slow_network(report, ''), 'a sensor, or a function'


@pytest.mark.parametrize(('side', 'advice'), [
    (4000, 'an image of 4000 x 2000 takes 410 ms: set max_side to 1280 to reduce it first'),
    (2500, '')])
def test_images_larger_than_helps_are_reported(side, advice):
    last = SimpleNamespace(detection=SimpleNamespace(labels=np.empty((2000, side))))
    report = Report(1, 0, 0, 2.5, {'depth': 0.4, 'segmentation': 0.01}, last=last)
    assert large_image(report) == advice
    assert not large_image(replace(report, last=None))
