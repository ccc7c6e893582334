# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of planes from a bag: ~/map topics and the file, where the last pose sees it."""

import json
import shutil

import numpy as np
import pytest
from bags import messages_of, read_bag, write_bag
from node_helpers import send, start
from replay_helpers import CAMERA, camera_messages, stamp_s, tf_message, time_ns
from ros_helpers import FRAME_ID, cloud_array, transform_msg
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from plane_detector.evaluation.scenes.walks import walk, with_errors
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer
from plane_detector.tools.replay.__main__ import main

IMAGES = 8
WITH_MAP = '-p', 'target_frame:=odom'


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return a bag of a walk with drifting poses, these poses, and the scenes."""
    rng = np.random.default_rng(4)
    walked = walk('box', rng, 40)
    scenes = [walked.scene(k, CAMERA, rng) for k in range(IMAGES)]
    poses = with_errors(walked.poses[:IMAGES], 'drift', rng)
    bag = write_bag(tmp_path_factory.mktemp('map') / 'walk', [
        *(('/tf', time_ns(k), tf_message(
            'odom', FRAME_ID, pose.translation_m, pose.quaternion, round(stamp_s(k) * 1e9)))
          for k, pose in enumerate(poses)), *camera_messages(scenes)])
    return bag, poses, scenes


def rows_of(target):
    return cloud_array(messages_of(target, '/plane_detector/map/planes', PointCloud2)[-1])[0]


def test_the_last_pose_sees_the_planes_of_the_map(recorded, replay, tmp_path):
    bag, poses, (*_, scene) = recorded
    file = tmp_path / 'map.json'
    code, target, text = replay(bag, *WITH_MAP, '--map', str(file))
    assert code == 0, text
    last = messages_of(target, '/plane_detector/map/planes', PointCloud2)[-1]
    assert last.header.frame_id == 'odom'
    assert last.header.stamp.nanosec == 700_000_000
    rows, large = rows_of(target), 0
    for k, (*normal_camera, offset_m) in enumerate(scene.planes):
        if (scene.labels == k).mean() < 0.05:
            continue
        large += 1
        normal = poses[-1].rotation @ normal_camera
        d = offset_m - normal @ poses[-1].translation_m
        off = [np.hypot(row['d'] - d, 3 * (1 - normal @ [
            row['normal_x'], row['normal_y'], row['normal_z']])) for row in rows]
        row = rows[np.argmin(off)]
        assert row['d'] == pytest.approx(d, abs=0.015)
        assert normal @ [row['normal_x'], row['normal_y'], row['normal_z']] > 0.9998
        on_plane = row['d'] + sum(row[axis] * row[f'normal_{axis}'] for axis in 'xyz')
        assert on_plane == pytest.approx(0, abs=1e-4)
    assert large >= 3
    assert (rows['views'] > 1).all()
    assert (rows['sigma_d'] > 0).all()
    assert rows['first_seen'].min() == pytest.approx(stamp_s(0), abs=0.2)
    corners = cloud_array(messages_of(target, '/plane_detector/map/boundaries', PointCloud2)[-1])
    assert set(corners[0]['label']) <= set(rows['label'])
    markers = messages_of(target, '/plane_detector/map/markers', MarkerArray)[-1].markers
    assert {marker.id for marker in markers[1:]} == set(rows['label'])
    assert json.loads(file.read_text())['frame'] == 'odom'


def test_the_map_of_a_bag_is_that_of_the_live_node(recorded, replay, robot, tmp_path):
    bag, poses, scenes = recorded
    from_bag, live, buffer = tmp_path / 'bag.json', tmp_path / 'live.json', TransformBuffer()
    code, _, text = replay(bag, *WITH_MAP, '--map', str(from_bag))
    assert code == 0, text
    start(robot, transforms=FrameTransforms(buffer), **{
        'depth.source': 'topic', 'target_frame': 'odom', 'map.enabled': True,
        'map.file': str(live)})
    for k, (pose, scene) in enumerate(zip(poses, scenes, strict=True)):
        buffer.add(transform_msg('odom', FRAME_ID, pose.translation_m.tolist(),
                                 pose.quaternion.tolist(), stamp_s(k)))
        send(robot, scene, stamp_s(k), depth=True)
        robot.wait_for('planes', k + 1)
    saved = robot.call(Trigger, '/plane_detector/map/save')
    assert saved.success, saved.message
    assert len(json.loads(live.read_text())['planes']) >= 3
    assert live.read_text() == from_bag.read_text()


def test_a_map_goes_on_from_a_file(recorded, replay, tmp_path):
    bag, *_ = recorded
    file = tmp_path / 'map.json'
    _, target, _ = replay(bag, *WITH_MAP, '--map', str(file), '--duration', '0.45')
    before = rows_of(target)
    shutil.rmtree(target)
    code, target, text = replay(bag, *WITH_MAP, '--load', str(file), '--start', '0.35')
    assert code == 0, text
    after = rows_of(target)
    assert set(after['label']) & set(before['label'][before['area'] > 1])
    assert len(after) <= len(before) + 3


def test_a_file_that_does_not_fit_ends_the_replay_with_the_reason(recorded, replay, tmp_path):
    bag, *_ = recorded
    file = tmp_path / 'map.json'
    file.write_text('{"version": 2}')
    code, _, text = replay(bag, *WITH_MAP, '--load', str(file))
    assert code == 1
    assert 'version 2, this program reads up to 1' in text
    code, _, text = replay(bag, '--map', str(file))
    assert code == 1
    assert 'map.enabled needs target_frame' in text


def test_a_viewer_that_comes_late_gets_the_map_and_the_copied_transforms(recorded, replay):
    """`ros2 bag play` offers the durability that the bag states; RViz asks for Transient Local."""
    bag, *_ = recorded
    code, target, text = replay(bag, *WITH_MAP, '-p', 'map.enabled:=true', '--copy',
                                '--duration', '0.15')
    assert code == 0, text
    with Reader(target) as reader:
        durability = {one.topic: [qos.durability for qos in one.ext.offered_qos_profiles]
                      for one in reader.connections}
    for name in ('planes', 'boundaries', 'markers'):
        assert durability[f'/plane_detector/map/{name}'] == [QosDurability.TRANSIENT_LOCAL]
    assert QosDurability.TRANSIENT_LOCAL not in durability['/plane_detector/planes']
    assert len(read_bag(target)['/tf']) == 2, 'those of the images in the first .15 s'


def test_what_cannot_be_written_is_refused_before_the_first_frame(
        recorded, replay, tmp_path, monkeypatch):
    bag, *_ = recorded
    monkeypatch.setattr('plane_detector.tools.replay.replay_bag._process', pytest.fail)
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'file').touch()
    for option, path, reason in (
            ('--map', 'folder', 'folder is a folder: name a file'),
            ('--csv', 'folder', 'folder is a folder: name a file'),
            ('--map', 'file/map.json', 'file'), ('--csv', 'file/planes.csv', 'file')):
        code, target, text = replay(bag, *WITH_MAP, option, str(tmp_path / path))
        assert code == 1
        assert reason in text
        assert not target.exists()


def test_the_folder_of_the_map_is_made(recorded, replay, tmp_path):
    bag, *_ = recorded
    file = tmp_path / 'no' / 'folder' / 'map.json'
    code, _, text = replay(bag, *WITH_MAP, '--duration', '0.15', '--map', str(file))
    assert code == 0, text
    assert json.loads(file.read_text())['planes']


def test_many_bags_have_a_map_each_and_a_map_that_is_missing_is_said(
        recorded, replay, tmp_path, capsys):
    bag, *_ = recorded
    shutil.copytree(bag, tmp_path / 'other')
    words = [str(bag), str(tmp_path / 'other'), '--output-folder', str(tmp_path / 'out'),
             '--duration', '0.15', '--jobs', '1', *WITH_MAP, '--map']
    assert main([*words, str(tmp_path / 'maps')]) == 0, capsys.readouterr()
    for name in ('walk', 'other'):
        assert json.loads((tmp_path / 'maps' / f'{name}.json').read_text())['planes']
    assert main([*words, str(tmp_path / 'maps')]) == 0
    assert '2 done before' in capsys.readouterr().out
    assert main([*words, str(tmp_path / 'elsewhere')]) == 1
    summary = (tmp_path / 'out' / 'summary.csv').read_text()
    assert f'was made before, without {tmp_path / "elsewhere" / "walk.json"}' in summary


def test_without_a_map_there_are_no_topics_of_it(recorded, replay):
    bag, *_ = recorded
    _, target, _ = replay(bag, '--duration', '0.15')
    assert not [topic for topic in read_bag(target) if '/map/' in topic]
