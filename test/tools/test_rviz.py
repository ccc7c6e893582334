# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The RViz configuration, and the program that sets its frame; RViz itself is a stand-in."""

import os

import pytest
import yaml
from rclpy.executors import ExternalShutdownException
from ros_helpers import camera_info_msg, random_domain

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


def test_frame_and_name_are_set():
    config = rviz.with_frame(rviz.find_config().read_text('utf-8'), 'front_optical', 'front')
    options = yaml.safe_load(config)['Visualization Manager']['Global Options']
    assert options['Fixed Frame'] == 'front_optical'
    assert {topic.split('/')[0] for topic in topics_of(config)} == {'front'}


def test_the_frame_is_that_of_the_camera(robot):
    from rclpy.node import Node
    node = Node('viewer', context=robot.context)
    robot.add(node)
    publisher = robot.node.create_publisher(type(camera_info_msg(CAMERA)), 'camera_info', 1)
    robot.node.create_timer(0.05, lambda: publisher.publish(camera_info_msg(CAMERA)))
    robot.executor.remove_node(node)
    import threading
    thread = threading.Thread(target=robot.spin, kwargs={'timeout_s': 3.0})
    thread.start()
    try:
        from rclpy.executors import SingleThreadedExecutor
        executor = SingleThreadedExecutor(context=robot.context)
        found = rviz.wait_for_frame(node, 10.0, executor)
    finally:
        thread.join()
    assert found == 'camera_optical_frame'


def test_without_a_camera_the_remedy_is_printed(monkeypatch, tmp_path, capsys):
    program = tmp_path / 'rviz2'
    program.write_text('#!/bin/sh\n')
    program.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv('ROS_DOMAIN_ID', str(random_domain()))
    assert rviz.main(['--timeout', '0.2']) == 1
    assert '--frame' in capsys.readouterr().err


@pytest.mark.parametrize('interrupt', [KeyboardInterrupt, ExternalShutdownException])
def test_an_interrupt_while_waiting_for_the_camera_is_exit_code_130(monkeypatch, interrupt):
    def interrupted(of_ros, timeout_s):
        raise interrupt
    monkeypatch.setattr(rviz, '_frame_of_camera', interrupted)
    monkeypatch.setattr(rviz.shutil, 'which', lambda name: f'/bin/{name}')
    assert rviz.main([]) == 130


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


def test_without_rviz_the_remedy_is_printed(monkeypatch, capsys):
    monkeypatch.setenv('PATH', '/nowhere')
    assert rviz.main([]) == 1
    assert 'ros-jazzy-rviz2' in capsys.readouterr().err


@pytest.fixture(autouse=True)
def own_temporary_files(monkeypatch, tmp_path):
    monkeypatch.setattr(rviz.tempfile, 'tempdir', str(tmp_path))
