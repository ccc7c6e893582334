# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Running work does not block services, transitions or the end of the node."""

import signal
import threading

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from node_helpers import change_state, send, start
from onnx_models import network_arguments, network_parameters
from ros_helpers import (
    STARTED_S,
    NodeProcess,
    Robot,
    camera_info_msg,
    header,
    image_msg,
    next_domain,
)
from slow_networks import HEIGHT, WIDTH, write_slow_network

from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(60.0, 60.0, 31.5, 23.5, WIDTH, HEIGHT)
BRIGHT = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
STUCK_S = 120.0


class Estimator:
    """Gives a depth as soon as it is let, like C++ that hears nothing in between."""

    def __init__(self, depth_m):
        self.depth_m = depth_m
        self.busy, self.free = threading.Event(), threading.Event()
        self.calls = self.at_once = 0

    def __call__(self, rgb):
        self.calls += 1
        self.at_once += 1
        assert self.at_once == 1
        self.busy.set()
        assert self.free.wait(STUCK_S)
        self.at_once -= 1
        return self.depth_m


def test_the_node_answers_while_it_is_configured(robot, tmp_path):
    model = write_slow_network(tmp_path / 'slow.onnx', always=True)
    node = start(robot, wait=False, **network_parameters(model))
    assert robot.spin(lambda: node.state == 'configuring')
    state = robot.call(GetState, 'plane_detector/get_state').current_state
    assert state.label == 'configuring'
    assert robot.diagnosis()[1]['state'] == 'configuring'
    assert not change_state(robot, Transition.TRANSITION_CONFIGURE), 'it is at it'
    assert not change_state(robot, Transition.TRANSITION_ACTIVATE)
    assert robot.call(GetState, 'plane_detector/get_state').current_state.label == 'configuring'


def test_deactivating_does_not_wait_and_discards_the_frame(robot, room):
    estimate = Estimator(room.depth_m)
    node = start(robot, estimate)
    send(robot, room, 1.0)
    assert robot.spin(estimate.busy.is_set)
    send(robot, room, 2.0)
    robot.settle()
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert (node.state, estimate.calls) == ('inactive', 1)
    assert change_state(robot, Transition.TRANSITION_ACTIVATE)
    send(robot, room, 3.0)
    robot.spin(timeout_s=0.3)
    assert estimate.calls == 1, 'the network is still at work'
    estimate.free.set()
    assert robot.wait_for('planes')[0].header == header(3.0)
    assert robot.diagnosis()[1]['frames_skipped'] == '0'


def test_the_next_network_waits_for_the_running_one(robot, room):
    estimate = Estimator(room.depth_m)
    node = start(robot, estimate)
    send(robot, room, 1.0)
    assert robot.spin(estimate.busy.is_set)
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        assert change_state(robot, transition)
    assert node.state == 'unconfigured'
    answer = robot.ask(ChangeState, 'plane_detector/change_state', ChangeState.Request(
        transition=Transition(id=Transition.TRANSITION_CONFIGURE)))
    robot.spin(timeout_s=0.3)
    assert (node.state, answer.done()) == ('configuring', False)
    estimate.free.set()
    assert robot.spin(answer.done)
    assert answer.result().success
    assert node.state == 'inactive'


@pytest.fixture
def started(tmp_path):
    """Return a function: nodes side by side, each with a network and a robot it hears."""
    begun, robots = [], []

    def begin(*kinds):
        for number, kind in enumerate(kinds):
            domain, name = next_domain(), f'node_{number}'
            path = write_slow_network(tmp_path / f'{name}.onnx', **kind)
            begun.append(NodeProcess(network_arguments(path), domain, tmp_path / f'{name}.log'))
            robots.append(Robot(outputs=('planes',), domain=domain))
        return zip(begun, robots, strict=True)

    yield begin
    for node in begun:
        node.process.kill()
        node.process.wait()
    for robot in robots:
        robot.shutdown()


def is_in_state(robot, label):
    return lambda: robot.received['diagnostics'] and robot.diagnosis()[1]['state'] == label


def test_a_signal_ends_the_node_in_the_middle_of_a_warm_up(started):
    for node, robot in started({'always': True}, {'always': True, 'deaf': True}):
        assert robot.spin(is_in_state(robot, 'configuring'), STARTED_S), node.log()
        assert node.end(signal.SIGTERM) == 0
        assert 'Traceback' not in node.log()


def test_a_signal_ends_the_node_in_the_middle_of_a_frame(started):
    """Of a deaf network: how one heeds a stop is the same in a warm-up."""
    ((node, robot),) = started({'deaf': True})
    assert robot.spin(is_in_state(robot, 'active'), STARTED_S), node.log()
    stamps_s = iter(range(10_000))

    def is_busy():  # a frame is worked on, the next are dropped
        stamp_s = next(stamps_s)
        robot.publish('camera_info', camera_info_msg(CAMERA, stamp_s))
        robot.publish('image', image_msg(BRIGHT, 'rgb8', stamp_s))
        return int(robot.diagnosis()[1]['frames_dropped'])
    assert robot.spin(is_busy, STARTED_S), node.log()
    assert node.end(signal.SIGINT) == 0
    assert 'Traceback' not in node.log()
