# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the node knows about missing inputs and results, in its log, once, and its diagnostics."""

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from node_helpers import change_state, send, start
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_helpers import camera_info_msg, image_msg
from std_srvs.srv import Trigger

from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.ros.diagnostics import FLOORLESS, Health, Report, gap_of
from plane_detector.ros.frame_worker import ANSWERED_WITHIN_S
from plane_detector.ros.inputs.topic_watch import ImageLoss


def test_depth_with_other_stamps_is_told_with_the_difference_and_mended_live(robot, room):
    node = start(robot, depth__source='topic')
    stamps_s = iter(np.arange(1.0, 100.0, 0.2))

    def send_both(off_s):
        stamp_s = next(stamps_s)
        robot.publish('camera_info', camera_info_msg(room.intrinsics, stamp_s))
        robot.publish('image', image_msg(room.rgb, 'rgb8', stamp_s))
        robot.publish('depth', image_msg(room.depth_m, '32FC1', stamp_s + off_s))
        robot.spin(timeout_s=0.05)

    def told(text):
        return robot.spin(lambda: send_both(off_s) or text in robot.log())
    off_s = 0.06
    assert told('the nearest is 60 ms later; synchronise the camera, or: ros2 param set '
                '/plane_detector stamp_slop 0.08')
    for _ in range(10):
        send_both(off_s)
    assert robot.log().count('synchronise the camera') == 1
    off_s = -0.09
    assert told('the nearest is 90 ms earlier'), 'again when it changes'
    assert not robot.received['planes']
    node.set_parameters([Parameter('stamp_slop', value=0.11)])
    assert robot.spin(lambda: send_both(off_s) or robot.received['planes'])


def test_lost_images_are_counted_and_told_with_the_remedy(robot, room):
    start(robot, lambda rgb: room.depth_m)
    for index in range(60):
        robot.publish('camera_info', camera_info_msg(room.intrinsics, index / 15))
        if index % 5 not in (1, 3):
            robot.publish('image', image_msg(room.rgb, 'rgb8', index / 15))
        robot.spin(timeout_s=0.02)
    assert robot.is_logged('% of the images on /image do not arrive')
    assert 'config/fastdds_large_messages.xml' in robot.log()
    received, _, implied = robot.diagnosis()[1]['images_received'].split(',')[0].split()
    assert int(received) <= 0.65 * int(implied)


@pytest.mark.parametrize('jitter', [0.0, 0.15])
@pytest.mark.parametrize('lost_share', [0.0, 0.1, 0.3, 0.6])
def test_stamps_tell_how_many_images_were_sent(lost_share, jitter):
    rng, loss, arrived = np.random.default_rng(0), ImageLoss(), 0
    for index in range(300):
        stamp_ns = round((index + jitter * rng.uniform(-1, 1)) / 30 * 1e9)
        if rng.random() >= lost_share:
            loss.add_image(stamp_ns)
            arrived += index >= 150
    found = loss.arrivals()
    assert found.received == pytest.approx(arrived, abs=6)
    assert found.implied == pytest.approx(150, abs=10)
    assert found.are_few == (lost_share >= 0.3)


RNG = np.random.default_rng(1)
STAMPS = {
    'triggered': np.cumsum(RNG.exponential(2, 150)),
    'unsteady': np.sort(np.arange(150) + RNG.uniform(-0.6, 0.6, 150)),
    'throttled': np.flatnonzero(np.arange(300) % 3),
    'slower since it is dark': np.concatenate([np.arange(90), 90 + 2 * np.arange(40)]),
    'pausing': np.flatnonzero(np.arange(600) % 100 < 70),
    'looping bag': np.tile(np.arange(100), 3),
    'swapped': np.arange(150).reshape(-1, 2)[:, ::-1].ravel()}


@pytest.mark.parametrize('infos', ['with_each', 'none', 'with_other_stamps'])
@pytest.mark.parametrize('camera', STAMPS)
def test_a_camera_that_does_not_send_at_a_constant_rate_loses_no_images(camera, infos):
    loss = ImageLoss()
    for stamp_s in STAMPS[camera] / 30:
        if infos != 'none':
            loss.add_camera_info(round(1e9 * (stamp_s + 0.004 * (infos != 'with_each'))))
        loss.add_image(round(1e9 * stamp_s))
        found = loss.arrivals()
        assert not found.are_few
        assert found.received <= 151, 'nothing from before a jump of time is counted'


def test_a_parameter_file_for_another_node_is_told(robot, tmp_path, monkeypatch):
    other, own = tmp_path / 'other.yaml', tmp_path / 'own.yaml'
    other.write_text('front/planes: {ros__parameters: {max_side: 640}}\n'
                     'robot: {camera: {ros__parameters: {max_side: 640}}}\n')
    own.write_text('/**: {ros__parameters: {max_side: 640}}\n')
    monkeypatch.setattr(sys, 'argv', ['node', '--ros-args', '--params-file', str(other),
                                      '--params-file', str(own)])
    start(robot, lambda rgb: None)
    assert robot.log().count('has no section') == 1
    assert (f'{other} has no section for /plane_detector; it has: /front/planes, /robot/camera'
            in robot.log())


def test_a_call_is_answered_as_soon_as_the_camera_is_known_to_have_stopped(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    for index in range(5):
        send(robot, room, 1.0 + 0.1 * index)
        robot.spin(timeout_s=0.1)
    start_s = time.monotonic()
    answer = robot.call(Trigger, 'plane_detector/detect')
    assert not answer.success
    assert '/image has stopped' in answer.message
    assert time.monotonic() - start_s < ANSWERED_WITHIN_S / 2


@pytest.mark.parametrize('transition', [None, Transition.TRANSITION_DEACTIVATE])
def test_what_is_read_at_configure_is_refused_until_cleanup(robot, transition):
    node = start(robot, lambda rgb: None)
    if transition:
        assert change_state(robot, transition)
    (result,) = node.set_parameters([Parameter('depth.source', value='topic')])
    assert not result.successful
    assert 'clean up, set this, then configure' in result.reason
    assert node.get_parameter('depth.source').value == 'model'


def test_two_nodes_of_one_name_are_told_once(robot):
    start(robot, lambda rgb: None)
    assert 'another node is called' not in robot.log()
    robot.add(Node('plane_detector', context=robot.context))
    assert robot.is_logged('another node is called /plane_detector too')
    robot.spin(timeout_s=0.7)
    assert robot.log().count('another node is called') == 1


def test_a_name_that_no_network_has_is_final_and_the_names_are_listed(robot):
    node = start(robot, wait=False, depth__model='depth_anything_v3')
    assert robot.is_logged('cannot be configured: depth.model')
    assert robot.is_logged('fastdepth')
    robot.spin(timeout_s=0.3)
    assert 'trying again' not in robot.log()
    assert node.state == 'unconfigured'


def test_tf_is_listened_to_only_while_the_settings_need_it(robot, monkeypatch):
    listening = []

    class TransformListener:
        def __init__(self, buffer, node):
            listening.append(self)

        def unregister(self):
            listening.remove(self)
    monkeypatch.setitem(sys.modules, 'tf2_ros', SimpleNamespace(
        Buffer=lambda: None, TransformListener=TransformListener))
    node = start(robot, lambda rgb: None, base_frame='base_footprint')
    assert len(listening) == 1
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert change_state(robot, Transition.TRANSITION_CLEANUP)
    assert not listening
    assert node.set_parameters([Parameter('base_frame', value='')])[0].successful
    assert change_state(robot, Transition.TRANSITION_CONFIGURE)
    assert not listening


def detection(classes, scale='metric', planes=2, gravity_note='', shape=(480, 640)):
    return SimpleNamespace(labels=np.zeros(shape), planes=(None,) * planes, classes=classes,
                           scale_method=scale, scale_note='why', scale_event='',
                           gravity_source='none', gravity_note=gravity_note,
                           gravity_probability=float('nan'),
                           camera_height_m=1.25, tilt_deg=float('nan'), drops_m=(),
                           drop_note='', disparity_noise=0.002, systematic_noise=0.001)


@pytest.mark.parametrize('found, wanted, told', [
    (detection((1, 3)), (FLOORLESS,), ''),
    (detection((), planes=0), (FLOORLESS,), ''),
    (detection((0, 0)), ('planes',), 'the direction of gravity is not known'),
    (detection((0, 0)), (FLOORLESS,), 'points_without_floor is silent'),
    (detection((0, 0), gravity_note='only 3 straight lines'), (), 'not known (only 3 straight'),
    (detection((0, 0), 'relative'), ('planes',), 'neither metres nor gravity'),
    (detection((1, 0), 'relative'), ('planes',), ''),
    (detection((1, 0), 'relative'), (FLOORLESS,), 'the unit of depth is not known (why)')])
def test_gaps(found, wanted, told):
    gap = gap_of(found, wanted)
    assert told in gap
    assert bool(told) == bool(gap)


def test_each_gap_is_logged_once_and_cleared_when_it_ends():
    lines = []
    health = Health(SimpleNamespace(warning=lines.append, info=lines.append))
    for _ in range(3):
        health.note(detection((0, 0)), ())
        level, message = health.status(Report(3, 0, 0, 1.0), '')
        assert level == DiagnosticStatus.WARN
        assert 'gravity' in message
    assert len(lines) == 1
    health.note(detection((1, 3)), ())
    assert health.status(Report(4, 0, 0, 1.0), '') == (DiagnosticStatus.OK, 'active')


def test_a_silent_imu_is_reported(robot, room):
    start(robot, lambda rgb: room.depth_m, use_imu=True)
    for stamp_s in np.arange(1.0, 6.0, 0.25):
        send(robot, room, stamp_s)
        robot.spin(timeout_s=0.1)
    assert robot.is_logged('nobody publishes /imu')
    status, _ = robot.diagnosis()
    assert status.level == DiagnosticStatus.WARN
    assert '/imu' in status.message


def test_the_probability_of_the_vertical_of_the_image_is_told(robot):
    room = textured(random_room, 300)
    start(robot, lambda rgb: room.depth_m)
    send(robot, room)
    assert robot.spin(lambda: robot.diagnosis()[1].get('gravity') == 'image')
    assert 0.9 <= float(robot.diagnosis()[1]['gravity_probability']) <= 1


def test_the_probability_of_other_sources_is_not_told(robot, room):
    start(robot, lambda rgb: room.depth_m, scale__gravity=room.gravity_camera.tolist())
    send(robot, room)
    assert robot.spin(lambda: robot.diagnosis()[1].get('gravity') == 'parameter')
    assert 'gravity_probability' not in robot.diagnosis()[1]


def test_without_a_unit_no_drops_are_told_and_why(robot, room):
    start(robot, DepthFunction(lambda rgb: 1 / room.depth_m, 'relative_disparity'),
          scale__gravity=room.gravity_camera.tolist())
    send(robot, room)
    assert robot.wait_for('planes')
    assert robot.spin(lambda: robot.diagnosis()[1].get('drops', '').startswith('none told: '))
    assert not robot.received['drops'] and not robot.received['ground']
