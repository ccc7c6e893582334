# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The inputs that a replay reads from a bag, and errors in bags."""

import shutil

import pytest
from bags import CUSTOM_TYPE, ROS1, write_bag
from replay_helpers import (
    DEPTH,
    IMAGE,
    INFO,
    assert_true,
    camera_messages,
    planes_of,
    stamps_of,
    time_ns,
)


def test_an_unusable_frame_is_reported_and_skipped(tmp_path, scenes, replay):
    messages = camera_messages(scenes)
    messages[3][2].encoding = 'rainbow'
    code, target, text = replay(write_bag(tmp_path / 'walk', messages))
    assert code == 3
    assert stamps_of(planes_of(target)) == [0.0, 0.2, 0.3]
    assert ("not everything could be used: 1 frames skipped: image encoding 'rainbow' is not known"
            in text.splitlines()[-1])


def test_depth_in_the_frame_of_the_image_is_found(tmp_path, scenes, replay):
    other = camera_messages(scenes)
    for entry in other:
        entry[2].header.frame_id = 'another_frame'
    messages = camera_messages(scenes) + [
        ('/other/depth', when, msg) for topic, when, msg in other if topic == DEPTH]
    source = write_bag(tmp_path / 'walk', sorted(messages, key=lambda entry: entry[1]))
    code, target, text = replay(source, '-p', 'depth.source:=topic', depth='')
    assert code == 0, text
    assert_true(target, scenes)


def test_one_of_two_cameras_must_be_named(tmp_path, scenes, replay):
    right = ('/right/image_raw', '/right/camera_info', '/right/depth')
    messages = camera_messages(scenes) + camera_messages(scenes, names=right)
    source = write_bag(tmp_path / 'walk', sorted(messages, key=lambda entry: entry[1]))
    code, target, text = replay(source)
    assert (code, target.exists()) == (1, False)
    assert '/cam/image_raw, /right/image_raw all fit: select one by --image' in text
    code, _, text = replay(source, '--image', right[0], depth=right[2])
    assert code == 0
    assert f'Reading {", ".join(right)}' in text


@pytest.mark.parametrize('options, expected', [
    (('--image', '/cam/image'), 'there is no topic /cam/image, as given by --image'),
    (('--image', '/bumper'), f'/bumper is of type {CUSTOM_TYPE}, but --image must be '
                             'sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage'),
    (('--camera-info', IMAGE), '--camera-info must be sensor_msgs/msg/CameraInfo')])
def test_wrong_topics_are_reported_with_the_existing_ones(
        tmp_path, scenes, replay, options, expected):
    messages = [*camera_messages(scenes), ('/bumper', time_ns(9), 'bang')]
    code, target, text = replay(write_bag(tmp_path / 'walk', messages), *options)
    assert (code, target.exists()) == (1, False)
    assert expected in text
    for topic in (IMAGE, INFO, DEPTH, '/bumper'):
        assert topic in text.partition(' has ')[2]
    assert f'{CUSTOM_TYPE}, 1 messages' in text


def damaged(tmp_path, scenes, kind):
    bag_format = {'sqlite3': 'sqlite3', 'ros1': ROS1}.get(kind.split('_')[0], 'mcap')
    path = write_bag(tmp_path / f'walk_{bag_format}', camera_messages(scenes), bag_format)
    if kind == 'metadata':
        (path / 'metadata.yaml').write_text('rosbag2_bagfile_information: {version: 5')
        return path
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != '.yaml')
    data = file.read_bytes()
    if kind.endswith('cut'):
        file.write_bytes(data[:len(data) // 2])
    elif kind.endswith('garbled'):
        file.write_bytes(b'\x5a' * len(data))
    elif kind.endswith('gone'):
        file.unlink()
    return path


MCAP_TOOL = 'mcap recover, or ros2 bag reindex for metadata.yaml alone, may help'


@pytest.mark.parametrize(('kind', 'tool'), [
    ('mcap_cut', MCAP_TOOL), ('mcap_garbled', MCAP_TOOL), ('mcap_gone', ''),
    ('sqlite3_cut', '.recover of sqlite3'), ('sqlite3_garbled', '.recover of sqlite3'),
    ('ros1_cut', 'rosbag reindex may help'), ('ros1_garbled', 'rosbag reindex may help'),
    ('metadata', MCAP_TOOL)])
def test_damaged_bags_are_reported_in_one_line(tmp_path, scenes, replay, kind, tool):
    source = damaged(tmp_path, scenes, kind)
    code, _, text = replay(source)
    assert code == 1
    assert text.startswith(f'replay: {source} cannot be read: ')
    assert text.count('\n') == 1
    assert 'There is ' in text
    assert tool in text


def test_reading_continues_after_a_damaged_record(tmp_path, scenes, replay):
    """A record in the middle is garbled, the index at the end is whole."""
    source = write_bag(tmp_path / ROS1, camera_messages(scenes), ROS1)
    data = bytearray(source.read_bytes())
    pixels = bytes(data).rindex(scenes[2].depth_m.tobytes())
    data[pixels - 120:pixels] = b'\xff' * 120
    source.write_bytes(bytes(data))
    code, target, text = replay(source)
    assert code == 3
    assert '1 damaged messages were skipped' in text
    assert stamps_of(planes_of(target)) == [0.0, 0.1, 0.3]


@pytest.mark.parametrize('bag_format', ['mcap', 'sqlite3'])
def test_a_recording_without_metadata_and_a_single_file_are_read(
        tmp_path, scenes, replay, bag_format):
    folder = write_bag(tmp_path / 'walk', camera_messages(scenes), bag_format)
    (folder / 'metadata.yaml').unlink()
    code, target, _ = replay(folder)
    assert code == 0
    assert_true(target, scenes)
    shutil.rmtree(target)
    (file,) = folder.iterdir()
    assert replay(file)[0] == 0
