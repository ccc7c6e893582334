# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Bags in and bags out: every format, the truth, the options."""

import shutil

import cv2
import numpy as np
import pytest
from bags import FORMATS, ROS1, messages_of, read_bag, write_bag
from data_files import read_ply
from rclpy.parameter import Parameter
from replay_helpers import (
    CAMERA,
    DEPTH,
    IMAGE,
    INFO,
    assert_true,
    camera_messages,
    planes_of,
    rows_of,
    stamp_s,
    stamps_of,
    time_ns,
)
from ros_helpers import Robot, camera_info_msg

from plane_detector.evaluation.scenes.rendering import Rectangle, camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import ellipsoid
from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.outputs.clouds import SHAPE_DTYPE
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools.replay.bag_reader import BagReader, to_message
from plane_detector.tools.replay.inputs import input_class
from plane_detector.types import PlaneClass

# Not written by default.
MISSING = {f'/plane_detector/{name}'
           for name in ('points_without_floor', 'planes_json', 'shapes')}
DIAGNOSTICS = '/diagnostics'


@pytest.mark.parametrize('bag_format', [*FORMATS, ROS1])
def test_planes_of_every_format_are_true(tmp_path, scenes, replay, bag_format):
    source = write_bag(tmp_path / f'walk_{bag_format}', camera_messages(scenes), bag_format)
    code, target, text = replay(source, '-p', 'directions.mounting:=upright')
    assert code == 0, text
    written = read_bag(target)
    assert set(written) == (
        {DIAGNOSTICS} | {f'/plane_detector/{name}' for name in OUTPUTS}) - MISSING
    assert all(len(messages) == len(scenes) for messages in written.values())
    assert_true(target, scenes)
    assert f'{len(scenes)} frames in' in text


def test_the_live_node_gives_the_same(bag, scenes, replay):
    """Its frames are published one at a time, so that it has the time to see all of them."""
    _, target, _ = replay(bag)
    robot = Robot()
    try:
        node = PlaneDetectorNode(context=robot.context, parameter_overrides=[
            Parameter('depth.source', value='topic'),
            Parameter('points_color', value='overlay'),
            Parameter('picture_rate', value=0.0)])
        robot.add(node)
        assert robot.spin(lambda: node.state == 'active'), robot.log()
        names = {IMAGE: 'image', INFO: 'camera_info', DEPTH: 'depth'}
        with BagReader(bag) as reader:
            for index, recorded in enumerate(reader.read(list(names))):
                robot.publish(names[recorded.topic],
                              to_message(recorded, input_class(reader, recorded.topic)))
                if (index + 1) % len(names) == 0:
                    robot.wait_for('planes', (index + 1) // len(names))
        for name in ('planes', 'points', 'labels', 'markers', 'plane_poses'):
            live = robot.wait_for(name, len(scenes))
            assert live == messages_of(target, f'/plane_detector/{name}', OUTPUTS[name].msg_type)
    finally:
        robot.shutdown()


def test_other_topics_are_copied_by_name_whatever_their_type(tmp_path, scenes, replay):
    """Whole, while of the images only those of the frames are copied, if at all."""
    messages = camera_messages(scenes) + [
        ('/bumper', time_ns(index) + 1, 'bang') for index in range(len(scenes))]
    source = write_bag(tmp_path / 'walk', sorted(messages, key=lambda entry: entry[1]))
    recorded = read_bag(source)
    code, target, text = replay(source, '--copy', '/bumper')
    assert code == 0, text
    assert read_bag(target)['/bumper'] == recorded['/bumper']
    assert IMAGE not in read_bag(target)
    shutil.rmtree(target)
    replay(source, '--every', 2, '--copy', '/bumper', IMAGE)
    assert read_bag(target)['/bumper'] == recorded['/bumper']
    assert read_bag(target)[IMAGE] == recorded[IMAGE][::2]
    code, _, text = replay(source, '--copy', '/nothing')
    assert code == 1


def test_every_nth_frame_and_chosen_outputs(bag, replay):
    _, target, _ = replay(bag, '--every', 2, '--outputs', 'planes', 'labels')
    assert stamps_of(planes_of(target)) == [0.0, 0.2]
    assert set(read_bag(target)) == {'/plane_detector/planes', '/plane_detector/labels',
                                     DIAGNOSTICS}


def test_a_calibration_that_comes_once_serves_all_images(tmp_path, scenes, replay):
    """Even those from before it, and those after a late start."""
    messages = [entry for entry in camera_messages(scenes) if entry[0] != INFO]
    messages.insert(5, (INFO, time_ns(1) + 3000, camera_info_msg(CAMERA, stamp_s(1))))
    source = write_bag(tmp_path / 'walk', messages)
    _, target, _ = replay(source)
    assert_true(target, scenes)
    shutil.rmtree(target)
    _, target, _ = replay(source, '--start', 0.25)
    assert stamps_of(planes_of(target)) == [0.3]


def test_figures_clouds_and_table(bag, scenes, replay, tmp_path):
    code, target, _ = replay(bag, '--figures', tmp_path / 'figures', '--ply', tmp_path / 'ply',
                             '--csv', tmp_path / 'planes.csv', '--outputs', 'labels')
    assert code == 0
    assert set(read_bag(target)) == {'/plane_detector/labels', DIAGNOSTICS}
    names = [f'{index:06d}' for index in range(len(scenes))]
    assert sorted(path.stem for path in (tmp_path / 'figures').iterdir()) == names
    assert sorted(path.stem for path in (tmp_path / 'ply').iterdir()) == names
    figure = cv2.imread(str(tmp_path / 'figures' / '000000.jpg'))
    assert figure.shape[1] >= 3 * CAMERA.width
    image = figure[-4 - CAMERA.height:-4, 4:4 + CAMERA.width, ::-1].astype(float)
    assert abs(image - scenes[0].rgb).mean() < 10 < abs(image[..., ::-1] - scenes[0].rgb).mean()
    assert (tmp_path / 'ply' / '000000.ply').read_bytes().startswith(b'ply\n')
    rows = rows_of(tmp_path / 'planes.csv')
    assert {row['frame'] for row in rows} == {str(index) for index in range(len(scenes))}
    assert all(float(row['stamp']) == pytest.approx(stamp_s(int(row['frame']))) for row in rows)
    assert all(float(row['d']) >= 0 and int(row['label']) >= 1 for row in rows)
    assert {row['class_name'] for row in rows} == {
        PlaneClass(int(row['class'])).readable for row in rows}


def test_parameters_from_a_file(bag, replay, tmp_path):
    file = tmp_path / 'parameters.yaml'
    file.write_text('/**:\n  ros__parameters:\n    use_sim_time: true\n    segmentation:\n'
                    '      max_planes: 1\nother_node:\n  ros__parameters:\n    speed: 3\n')
    _, target, _ = replay(bag, '--params-file', file)
    assert all(msg.width == 1 for msg in planes_of(target))
    file.write_text('other_node:\n  ros__parameters:\n    speed: 3\n')
    shutil.rmtree(target)
    code, _, text = replay(bag, '--params-file', file)
    assert code == 1
    assert f'{file} has no section for /plane_detector; it has: other_node' in text


WALLS = [Rectangle(*(np.array(vector, float) for vector in one)) for one in (
    ([-5, 4, -1], [10, 0, 0], [0, 0, 4]), ([-5, -1, 0], [10, 0, 0], [0, 5, 0]))]
RADIUS_M = 0.5


def with_ball():
    ball = ellipsoid(RADIUS_M, RADIUS_M).at(0.1, 1.9, 0.9).curved_pieces()
    return render(WALLS, camera_rotation(3, -12, 2), np.array([0, 0, 1.2]), CAMERA,
                  np.random.default_rng(0), ball)


def test_shapes_have_a_table_and_their_labels_are_in_the_cloud(replay, tmp_path):
    scene = with_ball()
    source = write_bag(tmp_path / 'walk', camera_messages([scene, scene]))
    code, _, text = replay(source, '-p', 'shapes.types:=all', '--csv', tmp_path / 'planes.csv',
                           '--ply', tmp_path / 'ply')
    assert code == 0, text
    rows = rows_of(tmp_path / 'planes_shapes.csv')
    assert list(rows[0]) == ['frame', 'stamp', *SHAPE_DTYPE.names]
    assert [row['frame'] for row in rows] == ['0', '1']
    assert all(float(row['stamp']) == pytest.approx(stamp_s(int(row['frame']))) for row in rows)
    assert float(rows[0]['radius']) == pytest.approx(RADIUS_M, rel=0.02)
    labels = read_ply(tmp_path / 'ply' / '000000.ply')[1]['label']
    assert (labels == int(rows[0]['label'])).sum() == int(rows[0]['num_inliers']) > 900
    assert rows[0]['label'] not in {row['label'] for row in rows_of(tmp_path / 'planes.csv')}
