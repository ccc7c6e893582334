# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node as a separate process over DDS: started, fed, ended by signals."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from node_helpers import assert_true_to, points_and_planes
from onnx_models import millimetres_as_rgb, network_arguments, write_depth_network
from ros_helpers import (
    STARTED_S,
    NodeProcess,
    Robot,
    camera_info_msg,
    cloud_array,
    header,
    image_msg,
    next_domain,
)

from plane_detector.evaluation.scenes.rooms import random_room

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE',
                       str(ROOT / 'config' / 'fastdds_large_messages.xml'))
    return next_domain()


@pytest.fixture
def robot(domain):
    robot = Robot(domain=domain)
    yield robot
    robot.shutdown()


@pytest.fixture
def start(domain, tmp_path):
    started = []

    def start(*arguments):
        started.append(NodeProcess(arguments, domain, tmp_path / f'node_{len(started)}.log'))
        return started[-1]

    yield start
    for node in started:
        node.process.kill()
        node.process.wait()


def diagnosis(robot, node):
    """Return the values of the next diagnostics, once there are any."""
    assert robot.spin(lambda: robot.received['diagnostics'] or node.process.poll() is not None,
                      STARTED_S), node.log()
    assert node.process.poll() is None, node.log()
    return robot.diagnosis()


def test_planes_through_a_network_over_dds(start, robot, tmp_path):
    room = random_room(np.random.default_rng(3))
    model = write_depth_network(tmp_path / 'network.onnx', height=480, width=640)
    node = start(*network_arguments(model))
    assert robot.spin(lambda: diagnosis(robot, node)[1]['state'] == 'active', STARTED_S)
    image = millimetres_as_rgb(room.depth_m)
    for stamp_s in range(20):  # until both ends of every topic have found each other
        robot.publish('camera_info', camera_info_msg(room.intrinsics, stamp_s))
        robot.publish('image', image_msg(image, 'rgb8', stamp_s))
        if robot.spin(lambda: points_and_planes(robot), 1.0):
            break
    assert robot.spin(lambda: points_and_planes(robot)), node.log()
    points, planes = points_and_planes(robot)
    assert points.header in [header(stamp_s) for stamp_s in range(20)]
    cloud = cloud_array(points)
    assert cloud.shape == (480, 640)
    np.testing.assert_allclose(cloud['z'], room.depth_m, atol=0.001)
    assert_true_to(room, planes, cloud['label'])
    assert diagnosis(robot, node)[1]['depth_model'] == str(model)
    for stamp_s in range(20, 25):
        robot.publish('image', image_msg(image, 'rgb8', stamp_s))
    assert node.end(signal.SIGTERM) == 0, 'also in the middle of its work'
    assert 'Traceback' not in node.log()


def test_a_signal_ends_a_download(start, monkeypatch, tmp_path):
    """As soon as it comes: npm, a stand-in here, would take longer than the test waits."""
    begun = tmp_path / 'begun'
    npm = tmp_path / 'npm'
    npm.write_text(f'#!/bin/sh\n[ $1 = view ] || {{ : > {begun}; exec sleep {2 * STARTED_S}; }}\n')
    npm.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=os.pathsep)
    node = start('-p', 'depth.model:=fastdepth', '-p', f'depth.cache_dir:={tmp_path / "cache"}')
    node.wait_until(begun.exists)
    assert node.end(signal.SIGTERM) == 0
    assert 'Traceback' not in node.log()
    assert not list((tmp_path / 'cache').iterdir())


def test_with_exit_on_failure_a_missing_network_is_exit_code_1(start, tmp_path):
    node = start('-p', f'depth.model:={tmp_path / "missing.onnx"}', '-p', 'exit_on_failure:=true')
    assert node.process.wait(STARTED_S) == 1
    lines = [line for line in node.log().splitlines() if 'missing.onnx' in line]
    assert len(lines) == 1
    assert 'Traceback' not in node.log()


def test_an_impossible_argument_ends_the_start_with_the_reason(start):
    """One that rclpy refuses, of a parameter and of its own; a choice is in test_spinning."""
    reasons = {('-p', 'segmentation.max_planes:=0'): 'segmentation.max_planes',
               ('--params-file', '/nowhere.yaml'): '/nowhere.yaml'}
    nodes = [start(*arguments) for arguments in reasons]  # side by side: importing takes a second
    for node, reason in zip(nodes, reasons.values(), strict=True):
        assert node.process.wait(STARTED_S) == 1, reason
        assert reason in node.log()
        assert 'Traceback' not in node.log()
