# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The RViz configuration, and the program that sets its frame; RViz itself is a stand-in."""

import os
import threading

import pytest
import yaml
from rclpy.node import Node
from ros_helpers import camera_info_msg

from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools import rviz
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(100.0, 100.0, 49.5, 39.5, 100, 80)


def topics_of(config):
    displays = yaml.safe_load(config)['Visualization Manager']['Displays']
    return {display['Topic']['Value'] for display in displays}


def test_the_configuration_shows_outputs_relative_to_its_namespace():
    shown = topics_of(rviz.find_config().read_text('utf-8'))
    assert shown <= {f'plane_detector/{name}' for name in OUTPUTS}
    assert {'plane_detector/points', 'plane_detector/markers', 'plane_detector/overlay'} <= shown


def test_the_frame_is_that_of_the_camera(robot):
    node = Node('viewer', context=robot.context)
    publisher = robot.node.create_publisher(type(camera_info_msg(CAMERA)), 'camera_info', 1)
    robot.node.create_timer(0.05, lambda: publisher.publish(camera_info_msg(CAMERA)))
    thread = threading.Thread(target=robot.spin, kwargs={'timeout_s': 3.0})
    thread.start()
    try:
        found = rviz.wait_for_frame(node, 10.0)
    finally:
        thread.join()
        node.destroy_node()
    assert found == 'camera_optical_frame'


def test_rviz_is_started_with_the_frame(monkeypatch, tmp_path):
    program = tmp_path / 'rviz2'
    program.write_text('#!/bin/sh\n')
    program.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=os.pathsep)
    started = []
    monkeypatch.setattr(os, 'execv', lambda path, words: started.append(words))
    rviz.main(['--frame', 'map', '--ros-args', '-r', '__ns:=/front'])
    (words,) = started
    assert words[0] == str(program)
    assert words[1] == '-d'
    assert words[3:] == ['--ros-args', '-r', '__ns:=/front']
    with open(words[2], encoding='utf-8') as file:
        assert 'Fixed Frame: map' in file.read()


@pytest.fixture(autouse=True)
def own_temporary_files(monkeypatch, tmp_path):
    monkeypatch.setattr(rviz.tempfile, 'tempdir', str(tmp_path))
