# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The demo: its images, its files, its verdict, and a run of the node over DDS."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from data_files import read_ply

from plane_detector.tools.demo.photographs import Lens, own_images, workshop
from plane_detector.tools.files import write_ply
from plane_detector.types import CameraIntrinsics

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope='module')
def motorcycle():
    pytest.importorskip('skimage', reason='scikit-image holds the motorcycle')
    return workshop()


@pytest.mark.parametrize('wrong', [
    {'cx': 3.0}, {'fy': 3.0}, {'fx': 500.0, 'field_of_view_deg': 60.0},
    {'field_of_view_deg': 161.0}, {'field_of_view_deg': 0.0}])
def test_contradictory_lens_is_refused(wrong):
    with pytest.raises(ValueError, match='fx|field of view'):
        Lens(**wrong)


def test_own_images_are_read_in_order_as_rgb(tmp_path):
    for name, colour_bgr in (('b.png', (255, 0, 0)), ('a.jpg', (0, 0, 255))):
        cv2.imwrite(str(tmp_path / name), np.full((30, 40, 3), colour_bgr, np.uint8))
    (tmp_path / 'notes.txt').write_text('no image')
    found = own_images(tmp_path, Lens(fx=33.0))
    assert [photograph.name for photograph in found] == ['a', 'b']
    np.testing.assert_array_equal(found[1].rgb[0, 0], (0, 0, 255))
    assert found[0].rgb[0, 0, 0] > 250
    assert found[0].intrinsics == CameraIntrinsics(33, 33, 19.5, 14.5, 40, 30)
    for guess in (Lens(), Lens(field_of_view_deg=69.0)):
        assert own_images(tmp_path, guess)[0].intrinsics.is_guessed
    alone, = own_images(tmp_path / 'b.png', Lens(fx=33.0))
    np.testing.assert_array_equal(alone.rgb, found[1].rgb)


def test_ply_holds_the_valid_points(tmp_path):
    points_m = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    points_m[0, 1] = np.nan
    rgb = np.arange(18, dtype=np.uint8).reshape(2, 3, 3) + 100
    labels = np.array([[1, 2, 3], [0, 1, 2]], np.uint32)
    assert write_ply(tmp_path / 'cloud.ply', points_m, rgb, labels) == 5
    lines, vertices = read_ply(tmp_path / 'cloud.ply')
    assert lines[:2] == ['ply', 'format binary_little_endian 1.0']
    assert 'element vertex 5' in lines
    np.testing.assert_array_equal(vertices['label'], [1, 3, 0, 1, 2])
    np.testing.assert_array_equal(vertices['z'], [2, 8, 11, 14, 17])
    assert vertices[1]['red'] == 106
    assert vertices[1]['blue'] == 108


def test_demo_runs_the_node_over_dds(tmp_path, motorcycle):
    pytest.importorskip('rclpy')
    messages_of = pytest.importorskip('bags', reason='rosbags is missing').messages_of
    from sensor_msgs.msg import Image
    for kept in ('china.png', 'of_mine.png'):
        (tmp_path / kept).write_text('of an earlier run')
    (tmp_path / '.written_by_the_demo').write_text('china.png\n')
    run = subprocess.run(
        [sys.executable, '-m', 'plane_detector.tools.demo', '--without-network', '--output',
         str(tmp_path)], cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stderr
    assert 'ms from the image to the planes' in run.stdout
    assert run.stdout.startswith('With measured depth, as from a depth camera:')
    assert ' floor ' in run.stdout
    name = 'stereo_motorcycle_measured_depth'
    assert {path.name for path in tmp_path.iterdir()} == {
        'of_mine.png', '.written_by_the_demo', f'{name}.png', f'{name}.ply', f'{name}.csv',
        'example_bag'}
    bag = tmp_path / 'example_bag'
    assert sum(path.stat().st_size for path in bag.iterdir()) < 10e6
    depth_mm = messages_of(bag, '/camera/camera/aligned_depth_to_color/image_raw', Image)
    assert len(depth_mm) == 6 and depth_mm[0].encoding == '16UC1'
    seen = np.frombuffer(depth_mm[0].data, np.uint16).reshape(motorcycle.true_depth_m.shape)
    known = np.isfinite(motorcycle.true_depth_m)
    assert abs(seen[known] / 1000 - motorcycle.true_depth_m[known]).max() < 0.001
    assert not seen[~known].any()
    _is_a_robot(bag, motorcycle)
    rgb = motorcycle.rgb
    figure = cv2.imread(str(tmp_path / f'{name}.png'))
    assert figure.shape[0] > 2 * rgb.shape[0]
    assert figure.shape[1] > 2 * rgb.shape[1]
    with open(tmp_path / f'{name}.csv', newline='') as file:
        planes = list(csv.DictReader(file))
    floor = planes[0]
    assert float(floor['normal_y']) < -0.9
    assert 0.9 < float(floor['d']) < 1.2
    vertices = read_ply(tmp_path / f'{name}.ply')[1]
    assert len(vertices) == np.isfinite(motorcycle.true_depth_m).sum()
    assert (vertices['label'] == int(floor['label'])).sum() == int(floor['num_inliers'])


def _is_a_robot(bag, motorcycle):
    """The floor that the depth shows is the plane z = 0 of base_footprint, by TF in the bag."""
    from rosbags.highlevel import AnyReader

    from plane_detector.geometry.projection import depth_to_points
    from plane_detector.geometry.rigid_transform import RigidTransform
    with AnyReader([bag]) as reader:
        (connection,) = (one for one in reader.connections if one.topic == '/tf_static')
        ((_, _, raw),) = reader.messages([connection])
        edges = reader.deserialize(raw, connection.msgtype).transforms
    assert [(one.header.frame_id, one.child_frame_id) for one in edges] == [
        ('odom', 'base_footprint'), ('base_footprint', 'camera_color_optical_frame')]
    to, turn = edges[1].transform.translation, edges[1].transform.rotation
    place = RigidTransform.from_quaternion((turn.x, turn.y, turn.z, turn.w), (to.x, to.y, to.z))
    points_m = depth_to_points(motorcycle.true_depth_m.astype(np.float32), motorcycle.intrinsics)
    floor_m = place.points(points_m[-60:].reshape(-1, 3).astype(float))  # nearest to the robot
    floor_m = floor_m[np.isfinite(floor_m).all(axis=1)]
    assert abs(np.median(floor_m[:, 2])) < 0.02
    assert np.median(floor_m[:, 0]) > 1.0  # x is forward


def test_demo_is_quiet_when_it_is_ended(tmp_path):
    pytest.importorskip('rclpy')
    process = subprocess.Popen(
        [sys.executable, '-m', 'plane_detector.tools.demo', '--without-network', '--output',
         str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr.readline()  # of the node
    process.send_signal(signal.SIGINT)
    printed = ''.join(process.communicate(timeout=900))
    assert process.returncode == 130, printed
    assert 'Traceback' not in printed


@pytest.mark.parametrize(('arguments', 'reason'), [
    (['--images', '.'], 'demo: no image in'),
    (['--images', 'one.jpg'], 'demo: there is no image or folder one.jpg'),
    (['--fx', '525'], 'demo: a calibration'),
    (['--mounting', 'upright'], 'demo: a calibration, a field of view or a mounting applies'),
    (['--model', 'nowhere.onnx'], 'demo: --model nowhere.onnx is neither a file nor one of '),
    (['--model', __file__], 'demo: --model-output must state the kind of output of a network')])
def test_demo_reports_wrong_arguments(tmp_path, monkeypatch, capsys, arguments, reason):
    pytest.importorskip('skimage', reason='scikit-image holds the motorcycle')
    main = pytest.importorskip('plane_detector.tools.demo.__main__').main
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    assert capsys.readouterr().err.startswith(reason)
