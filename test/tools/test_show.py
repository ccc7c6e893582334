# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes of a running node as a table, by the snippet of the docs, and in RViz."""

import io
import os
import re
import select
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType

import output_scene as scene
import pytest
import rclpy
import yaml
from rclpy.node import Node
from ros_helpers import camera_info_msg, cloud_array, random_domain

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools import rviz
from plane_detector.tools.show import PlanePrinter, table_of
from plane_detector.types import CameraIntrinsics

TOPICS = Path(__file__).resolve().parents[2] / 'docs' / 'topics.md'


def two_planes():
    return OUTPUTS['planes'].make(scene.frame())


def test_the_printed_table():
    lines = table_of(two_planes()).splitlines()
    assert lines[0] == '2 planes at 1.500000000 in camera_optical_frame, metres'
    (wall, _), = cloud_array(two_planes())
    assert lines[2].split() == [
        '7', 'wall', '3.00', f'{wall["rect_width"]:.2f}', f'{wall["rect_height"]:.2f}', '2.50',
        '0.003', '75%', '-0.28', '+0.00', '-0.96']
    assert 'unknown unit' in table_of(two_planes(), is_metric=False)
    assert len(lines) == 4


def test_the_table_is_printed_live(robot):
    printed = io.StringIO()
    robot.add(PlanePrinter('/plane_detector', printed, context=robot.context))
    robot.publish('/plane_detector/planes', two_planes())
    assert robot.spin(lambda: '2 planes at' in printed.getvalue())


def test_a_reader_that_ends_ends_it_quietly(robot):
    """As of `show | head -1`."""
    domain = str(robot.context.get_domain_id())
    process = subprocess.Popen(
        [sys.executable, '-m', 'plane_detector.tools.show'], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env={**os.environ, 'ROS_DOMAIN_ID': domain})
    with process:
        def publish_until(condition):
            assert robot.spin(lambda: robot.publish('/plane_detector/planes', two_planes())
                              or robot.spin(timeout_s=0.1) or condition(), 60.0)
        publish_until(lambda: select.select([process.stdout], [], [], 0)[0])
        assert '2 planes at' in process.stdout.readline()
        process.stdout.close()
        publish_until(lambda: process.poll() is not None)
        assert (process.returncode, process.stderr.read()) == (
            0, 'waiting for /plane_detector/planes\n')


@pytest.fixture
def snippet(monkeypatch):
    """Run the snippet with a stand-in for sensor_msgs_py, which is not a package of PyPI."""
    module = ModuleType('sensor_msgs_py.point_cloud2')
    module.read_points = lambda msg: cloud_array(msg).ravel()  # as it does for all fields
    monkeypatch.setitem(sys.modules, 'sensor_msgs_py', ModuleType('sensor_msgs_py'))
    monkeypatch.setitem(sys.modules, 'sensor_msgs_py.point_cloud2', module)
    source, = re.findall(r'```python\n(.*?)```', TOPICS.read_text(encoding='utf-8'), re.DOTALL)
    names = {'__name__': 'snippet'}
    exec(compile(source, 'topics.md', 'exec'), names)
    rclpy.init(domain_id=random_domain())
    yield names
    rclpy.try_shutdown()


def test_the_snippet_joins_planes_to_points(snippet, capsys):
    reader, planes = snippet['PlaneReader'](), two_planes()
    reader.on_planes(planes)
    reader.on_points(OUTPUTS['points'].make(scene.frame()))
    reader.on_planes(planes)
    assert capsys.readouterr().out.splitlines() == [
        f'{row["label"]} {name} {row["d"]:.2f} m away, {row["rect_width"]:.2f} x '
        f'{row["rect_height"]:.2f} m, {row["num_inliers"]} points'
        for row, name in zip(cloud_array(planes)[0], ('wall', 'floor'), strict=True)]
    reader.destroy_node()


def test_the_class_values_of_the_docs_are_those_of_the_code(snippet):
    assert snippet['CLASSES'] == tuple(kind.name.lower().replace('_', ' ') for kind in PlaneClass)
    told = ', '.join(f'{kind.value} {kind.name.lower().replace("_", " ")}' for kind in PlaneClass)
    assert told in TOPICS.read_text(encoding='utf-8')


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
