# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes of a running node as a table, as JSON, and in RViz."""

import io
import json
import os
import select
import subprocess
import sys
import threading
from pathlib import Path

import output_scene as scene
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_helpers import camera_info_msg, cloud_array
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.plane_map import PlaneMap
from plane_detector.planes.classification import PlaneClass
from plane_detector.planes.outline import PlacedDetection
from plane_detector.ros.outputs.frame import MapView
from plane_detector.ros.outputs.map_messages import map_planes_to_msg
from plane_detector.ros.outputs.plane_json import planes_to_json
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools import rviz
from plane_detector.tools.show import PlanePrinter, camera_line, table_of
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
    assert table_of(two_planes(), warning='planes have no class').splitlines() == [
        lines[0], 'planes have no class', *lines[1:]]


def map_of(scene):
    """Return a map of one image, and its message, in which label 99 has become part of 1."""
    planes = PlaneMap()
    detection = PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
        scene.rgb, scene.intrinsics, scene.depth_m)
    planes.update(PlacedDetection(detection, scene.intrinsics, RigidTransform.identity(), 0.0))
    return planes, map_planes_to_msg(
        MapView(Header(frame_id='odom'), planes.snapshot(), {99: 1}))


def test_the_printed_table_of_a_map(room):
    planes, msg = map_of(room(3))
    lines = table_of(msg).splitlines()
    row, *_ = cloud_array(msg)[0]
    assert lines[0].startswith(f'{len(planes.planes)} planes at ')
    assert len(lines) == 2 + len(planes.planes)  # 99 is part of another one
    assert lines[2].split()[0] == str(row['label'])
    assert [f'{row[name]:.2f}' for name in 'xyz'] == lines[2].split()[-11:-8]


def test_what_another_node_sends_cannot_drive_the_terminal_or_end_the_program():
    msg = two_planes()
    msg.header.frame_id = '\x1b[2J' + 1000 * 'f'
    rows = cloud_array(msg).copy()
    rows['class'][0, 0] = 99
    msg.data = rows.tobytes()
    camera = camera_line({'drops': '\x1b]0;title\x07 3 points'})
    table = table_of(msg, camera=camera)
    assert '\x1b' not in table
    assert len(table) < 1500
    assert table.splitlines()[3].split()[:3] == ['7', 'class', '99']


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
        logged = process.stderr.read()
        assert process.returncode == 0 and 'Traceback' not in logged
        assert logged.startswith('waiting for /plane_detector/planes\n')


def test_json_is_a_line_with_units():
    found = json.loads(planes_to_json(two_planes()))
    assert (found['stamp'], found['frame_id']) == ('1.500000000', 'camera_optical_frame')
    assert (found['units']['d'], found['units']['area']) == ('m', 'm^2')
    wall, floor = found['planes']
    row = cloud_array(two_planes())[0][0]
    expected = {
        'label': 7, 'class': 'wall', 'normal': [-0.28, 0.0, -0.96],
        'centroid': [pytest.approx(row[axis], abs=1e-4) for axis in 'xyz'], 'd': 3.0,
        'width': pytest.approx(row['rect_width'], abs=1e-4),
        'height': pytest.approx(row['rect_height'], abs=1e-4), 'area': 2.5, 'rms': 0.003,
        'confidence': 0.75, 'num_inliers': row['num_inliers'],
        'sigma_normal': pytest.approx(3**0.5), 'sigma_d': 1.0}
    assert {name: wall[name] for name in expected} == expected
    assert (floor['label'], floor['class']) == (3, 'floor')
    assert json.loads(planes_to_json(two_planes(), is_metric=False))['units']['d'] is None


def test_json_of_a_map_leaves_out_what_is_part_of_another_plane(room):
    planes, msg = map_of(room(3))
    labels = [plane['label'] for plane in json.loads(planes_to_json(msg))['planes']]
    assert labels == [plane.label for plane in planes.planes]


def test_without_a_map_it_says_which_parameters_make_one(robot):
    printer = PlanePrinter('/plane_detector', io.StringIO(), of_map=True, context=robot.context)
    robot.add(printer)
    robot.publish('/plane_detector/planes', two_planes())
    assert robot.spin(lambda: 'map.enabled to true, and target_frame' in printer.why_nothing())
    assert '--node' not in printer.why_nothing()


def test_the_reason_that_the_node_states_is_the_reason(robot):
    printer = PlanePrinter('/plane_detector', io.StringIO(), context=robot.context)
    robot.add(printer)
    publisher = robot.node.create_publisher(PointCloud2, '/plane_detector/planes', 1)
    why = 'frames skipped: the CameraInfo has a K of zeros\x1b[2J'
    robot.publish('/diagnostics', DiagnosticArray(status=[
        DiagnosticStatus(name='another', level=DiagnosticStatus.WARN, message='hot'),
        DiagnosticStatus(name='plane_detector', level=DiagnosticStatus.WARN, message=why)]))
    assert robot.spin(lambda: 'K of zeros' in printer.why_nothing())
    assert printer.why_nothing().startswith('no planes on /plane_detector/planes yet: frames skip')
    assert '\x1b' not in printer.why_nothing()
    robot.node.destroy_publisher(publisher)


def test_json_is_printed_live(robot):
    printed = io.StringIO()
    robot.add(PlanePrinter('/plane_detector', printed, as_json=True, context=robot.context))
    robot.publish('/plane_detector/planes', two_planes())
    assert robot.spin(lambda: printed.getvalue().endswith('\n'))
    assert [plane['label'] for plane in json.loads(printed.getvalue())['planes']] == [7, 3]


def test_the_class_values_of_the_docs_are_those_of_the_code():
    listed = ', '.join(f'{kind.value} {kind.readable}' for kind in PlaneClass)
    assert listed in TOPICS.read_text(encoding='utf-8')


CAMERA = CameraIntrinsics(100.0, 100.0, 49.5, 39.5, 100, 80)


def topics_of(config):
    displays = yaml.safe_load(config)['Visualization Manager']['Displays']
    return {display['Topic']['Value'] for display in displays}


def test_the_configuration_shows_outputs_relative_to_its_namespace():
    shown = topics_of(rviz.find_config().read_text('utf-8'))
    of_map = {f'map/{name}' for name in ('planes', 'boundaries', 'markers')}
    assert shown <= {f'plane_detector/{name}' for name in (*OUTPUTS, *of_map)}
    assert shown >= {f'plane_detector/{name}' for name in (
        'points', 'markers', 'overlay', 'ground', 'points_without_floor', 'drops', *of_map)}


def test_the_frame_is_that_of_the_camera(robot):
    node = Node('viewer', context=robot.context)
    publisher = robot.node.create_publisher(type(camera_info_msg(CAMERA)), 'camera_info', 1)
    robot.node.create_timer(0.05, lambda: publisher.publish(camera_info_msg(CAMERA)))
    is_over = threading.Event()
    thread = threading.Thread(target=robot.spin, args=(is_over.is_set,))
    thread.start()
    try:
        found = rviz.wait_for_frame(node, 60.0)
    finally:
        is_over.set()
        thread.join()
        node.destroy_node()
    assert found == 'camera_optical_frame'


@pytest.mark.parametrize('frame, is_above', [('map', True), ('camera_optical_frame', False)])
def test_rviz_is_started_with_the_frame(frame, is_above, monkeypatch, tmp_path):
    """It looks from above: along -z of a frame of the robot, along y of an optical one."""
    program = tmp_path / 'rviz2'
    program.write_text('#!/bin/sh\n')
    program.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=os.pathsep)
    started = []
    monkeypatch.setattr(os, 'execv', lambda path, words: started.append(words))
    rviz.main(['--frame', frame, '--ros-args', '-r', '__ns:=/front'])
    (words,) = started
    assert words[0] == str(program)
    assert words[1] == '-d'
    assert words[3:] == ['--ros-args', '-r', '__ns:=/front']
    with open(words[2], encoding='utf-8') as file:
        display = yaml.safe_load(file)['Visualization Manager']
    assert display['Global Options']['Fixed Frame'] == frame
    view = display['Views']['Current']
    assert (view['Pitch'] > 0.3) == is_above  # of Orbit: the height of the eye over x and y
    assert view['Focal Point']['Z'] == (0 if is_above else 2)


@pytest.fixture(autouse=True)
def own_temporary_files(monkeypatch, tmp_path):
    monkeypatch.setattr(rviz.tempfile, 'tempdir', str(tmp_path))


def test_a_latched_map_is_printed_by_who_comes_later(robot):
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = robot.node.create_publisher(PointCloud2, '/plane_detector/map/planes', latched)
    publisher.publish(two_planes())
    printed = io.StringIO()
    robot.add(PlanePrinter('/plane_detector', printed, of_map=True, context=robot.context))
    assert robot.spin(lambda: '2 planes at 1.5' in printed.getvalue())
