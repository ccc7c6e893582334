# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Bags in and bags out: every format, the truth, the options, what can be wrong with a bag."""

import array
import csv
import shutil
import signal
import sys

import cv2
import numpy as np
import pytest
from bags import CUSTOM_TYPE, FORMATS, ROS1, messages_of, read_bag, write_bag
from onnx_models import millimetres_as_rgb, write_depth_network
from rclpy.parameter import Parameter
from ros_helpers import FRAME_ID, Robot, camera_info_msg, cloud_array, header, image_msg
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from plane_detector.ros.node import PlaneDetectorNode
from plane_detector.ros.outputs import OUTPUTS
from plane_detector.ros.processing import FrameProcessor
from plane_detector.tools.bag_reading import BagReader, to_message
from plane_detector.tools.bag_topics import input_class
from plane_detector.tools.replay import main
from plane_detector.tools.scenes import box, camera_rotation, render
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(130.0, 130.0, 79.5, 59.5, 160, 120)
START_S, PERIOD_S = 1700000000, 0.1
FLOORLESS = '/plane_detector/points_without_floor'  # only where gravity is known
IMAGE, INFO, DEPTH = '/cam/image_raw', '/cam/camera_info', '/cam/depth'


@pytest.fixture(scope='module')
def scenes():
    """Four steps through a room with a box in it."""
    size = np.array([4.0, 5.0, 2.5])
    rectangles = box(size / 2, size)
    rectangles += box(np.array([2.8, 3.5, 0.5]), np.array([1.0, 0.8, 1.0]), 20)
    return [render(rectangles, camera_rotation(5 * step, -15, 0),
                   np.array([2.0, 0.5 + 0.05 * step, 1.4]), CAMERA, np.random.default_rng(0))
            for step in range(4)]


def stamp_s(index):
    return START_S + PERIOD_S * index


def time_ns(index):
    """When a picture was recorded: a little after its stamp."""
    return round(stamp_s(index) * 1e9) + 5_000_000


def camera_messages(scenes, depth=True, names=(IMAGE, INFO, DEPTH)):
    """Return pictures, calibrations and depth images as they are recorded."""
    messages = []
    for index, scene in enumerate(scenes):
        messages += [(names[0], time_ns(index), image_msg(scene.rgb, 'rgb8', stamp_s(index))),
                     (names[1], time_ns(index) + 1000, camera_info_msg(CAMERA, stamp_s(index)))]
        if depth:
            messages.append((names[2], time_ns(index) + 2000,
                             image_msg(scene.depth_m, '32FC1', stamp_s(index))))
    return messages


@pytest.fixture
def bag(tmp_path, scenes):
    return write_bag(tmp_path / 'walk', camera_messages(scenes))


@pytest.fixture
def replay(tmp_path, capsys):
    """Return a function: run the program; return exit code, new bag, what it printed."""
    def run(source, *options, depth=DEPTH):
        target = tmp_path / 'planes'
        depth_option = ['--depth', depth] if depth else []
        code = main([str(source), str(target), *depth_option, *map(str, options)])
        printed = capsys.readouterr()
        return code, target, printed.out + printed.err
    return run


def planes_of(target):
    return messages_of(target, '/plane_detector/planes', PointCloud2)


def stamps_of(messages):
    return [round(msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec - START_S, 3)
            for msg in messages]


def assert_true(target, scenes):
    """Check coefficients, labels, stamps and frame of every picture."""
    planes = planes_of(target)
    labels = messages_of(target, '/plane_detector/labels', Image)
    assert stamps_of(planes) == [round(PERIOD_S * k, 3) for k in range(len(scenes))]
    for scene, msg, label_msg in zip(scenes, planes, labels, strict=True):
        assert msg.header == label_msg.header
        assert msg.header.frame_id == FRAME_ID
        table = cloud_array(msg)[0]
        pixels = np.frombuffer(label_msg.data, '<u2').reshape(scene.labels.shape)
        large = [k for k in range(len(scene.planes)) if (scene.labels == k).mean() > 0.03]
        assert len(large) >= 4
        for k in large:
            label = np.bincount(pixels[scene.labels == k]).argmax()
            (row,) = table[table['label'] == label]
            normal = np.array([row['normal_x'], row['normal_y'], row['normal_z']], float)
            assert normal @ scene.planes[k, :3] > np.cos(np.radians(1.0))
            assert row['d'] == pytest.approx(scene.planes[k, 3], abs=0.01)


@pytest.mark.parametrize('bag_format', [*FORMATS, ROS1])
def test_planes_of_every_format_are_true(tmp_path, scenes, replay, bag_format):
    source = write_bag(tmp_path / f'walk_{bag_format}', camera_messages(scenes), bag_format)
    code, target, text = replay(source)
    assert code == 0, text
    written = read_bag(target)
    assert set(written) == {f'/plane_detector/{name}' for name in OUTPUTS} - {FLOORLESS}
    assert all(len(messages) == len(scenes) for messages in written.values())
    assert_true(target, scenes)
    assert f'{len(scenes)} frames in' in text


@pytest.mark.parametrize('options', [
    ('--storage', 'sqlite3'), ('--compress',), ('--storage', 'sqlite3', '--compress')])
def test_the_new_bag_in_other_formats(bag, scenes, replay, options):
    code, target, _ = replay(bag, *options)
    assert code == 0
    assert_true(target, scenes)


def test_depth_from_a_network_and_compressed_pictures(tmp_path, scenes, replay):
    """The network reads millimetres out of the colours, which png keeps."""
    messages = [(INFO, time_ns(0) - 1000, camera_info_msg(CAMERA, stamp_s(0)))]
    for index, scene in enumerate(scenes):
        png = cv2.imencode('.png', millimetres_as_rgb(scene.depth_m)[..., ::-1])[1]
        msg = CompressedImage(header=header(stamp_s(index)), format='rgb8; png compressed bgr8')
        msg.data = array.array('B', png.tobytes())
        messages.append((f'{IMAGE}/compressed', time_ns(index), msg))
    network = write_depth_network(tmp_path / 'depth.onnx', height=120, width=160)
    code, target, text = replay(
        write_bag(tmp_path / 'walk', messages), '-p', f'depth.model:={network}',
        '-p', 'depth.output:=metric_depth', '-p', 'depth.mean:=[0.0, 0.0, 0.0]',
        '-p', 'depth.std:=[1.0, 1.0, 1.0]', depth='')
    assert code == 0, text
    assert_true(target, scenes)


def test_a_plane_keeps_its_label(bag, scenes, replay):
    _, target, _ = replay(bag)
    seen = {}
    for scene, msg in zip(scenes, messages_of(target, '/plane_detector/labels', Image),
                          strict=True):
        pixels = np.frombuffer(msg.data, '<u2').reshape(scene.labels.shape)
        for k, rectangle in enumerate(scene.rectangles):
            if (scene.labels == k).mean() > 0.03:
                label = np.bincount(pixels[scene.labels == k]).argmax()
                seen.setdefault(rectangle, set()).add(label)
    assert len(seen) >= 4
    assert all(len(labels) == 1 for labels in seen.values())


def test_the_live_node_gives_the_same(bag, scenes, replay):
    """Its frames are published one at a time, so that it has the time to see all of them."""
    _, target, _ = replay(bag)
    robot = Robot()
    try:
        node = PlaneDetectorNode(context=robot.context, parameter_overrides=[
            Parameter('depth.source', value='topic')])
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


def test_inputs_are_copied_on_request(bag, replay):
    _, target, _ = replay(bag, '--copy')
    source, copied = read_bag(bag), read_bag(target)
    assert {topic: copied[topic] for topic in source} == source


def test_other_topics_are_copied_by_name_whatever_their_type(tmp_path, scenes, replay):
    messages = camera_messages(scenes) + [('/bumper', time_ns(2), 'bang')]
    source = write_bag(tmp_path / 'walk', sorted(messages, key=lambda entry: entry[1]))
    code, target, text = replay(source, '--copy', '/bumper')
    assert code == 0, text
    assert read_bag(target)['/bumper'] == read_bag(source)['/bumper']
    assert IMAGE not in read_bag(target)
    code, _, text = replay(source, '--copy', '/nothing')
    assert code == 1


def test_part_of_a_bag(bag, replay):
    _, target, _ = replay(bag, '--start', 0.05, '--duration', 0.2)
    assert stamps_of(planes_of(target)) == [0.1, 0.2]


@pytest.mark.parametrize('asked', [
    ('--start', 5), ('--start', 0.1, '--duration', 0), ('--start', 0.11, '--duration', 0.05),
    ('--start', 1e300)])
def test_a_part_without_pictures_is_told_and_nothing_is_written(bag, replay, tmp_path, asked):
    code, target, text = replay(bag, *asked, '--figures', tmp_path / 'figures')
    assert code == 1
    asked_for = ' '.join(f'{word:g}' if isinstance(word, float) else str(word) for word in asked)
    assert text.startswith(f'replay: {bag} spans 0 to 0.300 s, and in what is asked for, '
                           f'{asked_for}')
    assert text.count('\n') == 1
    assert list(tmp_path.iterdir()) == [bag], target


def test_every_nth_frame_and_chosen_outputs(bag, replay):
    _, target, _ = replay(bag, '--every', 2, '--outputs', 'planes', 'labels')
    assert stamps_of(planes_of(target)) == [0.0, 0.2]
    assert set(read_bag(target)) == {'/plane_detector/planes', '/plane_detector/labels'}


def test_a_calibration_that_comes_once_serves_all_pictures(tmp_path, scenes, replay):
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
    assert set(read_bag(target)) == {'/plane_detector/labels'}
    names = [f'{index:06d}' for index in range(len(scenes))]
    assert sorted(path.stem for path in (tmp_path / 'figures').iterdir()) == names
    assert sorted(path.stem for path in (tmp_path / 'ply').iterdir()) == names
    figure = cv2.imread(str(tmp_path / 'figures' / '000000.jpg'))
    assert figure.shape[1] >= 3 * CAMERA.width
    assert (tmp_path / 'ply' / '000000.ply').read_bytes().startswith(b'ply\n')
    with open(tmp_path / 'planes.csv', encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    assert {row['frame'] for row in rows} == {str(index) for index in range(len(scenes))}
    assert float(rows[0]['stamp']) == START_S
    assert all(float(row['d']) >= 0 and int(row['label']) >= 1 for row in rows)


def test_parameters_from_a_file(bag, replay, tmp_path):
    file = tmp_path / 'parameters.yaml'
    file.write_text('/**:\n  ros__parameters:\n    use_sim_time: true\n    segmentation:\n'
                    '      max_planes: 1\nother_node:\n  ros__parameters:\n    speed: 3\n')
    _, target, _ = replay(bag, '--params-file', file)
    assert all(msg.width == 1 for msg in planes_of(target))


def test_measured_depth_may_only_give_the_unit(tmp_path, scenes, replay):
    """The network's relative disparity is 3 / z: its unit is that of the depth topic."""
    messages = camera_messages(scenes)
    for (_, _, msg), scene in zip(messages[::3], scenes, strict=True):
        msg.data = image_msg(millimetres_as_rgb(3 / scene.depth_m), 'rgb8').data
    network = write_depth_network(tmp_path / 'disparity.onnx', height=120, width=160)
    code, target, text = replay(
        write_bag(tmp_path / 'walk', messages), '-p', 'depth.source:=model',
        '-p', f'depth.model:={network}', '-p', 'depth.output:=relative_disparity',
        '-p', 'depth.mean:=[0.0, 0.0, 0.0]', '-p', 'depth.std:=[1.0, 1.0, 1.0]')
    assert code == 0, text
    assert f'Reading {IMAGE}, {INFO}, {DEPTH}' in text
    for scene, msg in zip(scenes, planes_of(target), strict=True):
        offsets_m = cloud_array(msg)[0]['d'][:3]
        assert (np.abs(offsets_m[:, None] - scene.planes[:, 3]).min(axis=1) < 0.05).all()


@pytest.mark.parametrize('options, told', [
    (('-p', 'segmentation.max_plane:=1'), 'unknown parameter segmentation.max_plane'),
    (('-p', 'segmentation.max_planes:=0'), 'max_planes must be in'),
    (('-p', 'segmentation.max_planes=1'), 'NAME:=VALUE'),
    (('--params-file', 'nowhere.yaml'), 'nowhere.yaml')])
def test_wrong_parameters_are_told(bag, replay, options, told):
    code, target, text = replay(bag, *options)
    assert (code, target.exists()) == (1, False)
    assert told in text


def test_an_interrupted_replay_leaves_a_bag_of_what_was_done(bag, replay, monkeypatch):
    process = FrameProcessor.process

    def interrupted(self, frame, wanted):
        if frame.image.header.stamp.nanosec:
            signal.raise_signal(signal.SIGINT)
        return process(self, frame, wanted)

    monkeypatch.setattr(FrameProcessor, 'process', interrupted)
    code, target, text = replay(bag)
    assert code == 130
    assert 'interrupted' in text
    assert stamps_of(planes_of(target)) == [0.0, 0.1]
    assert {len(messages) for messages in read_bag(target).values()} == {2}


def test_a_frame_that_cannot_be_used_is_told_and_left_out(tmp_path, scenes, replay):
    messages = camera_messages(scenes)
    messages[3][2].encoding = 'rainbow'
    code, target, text = replay(write_bag(tmp_path / 'walk', messages))
    assert code == 0
    assert stamps_of(planes_of(target)) == [0.0, 0.2, 0.3]
    assert "1 frames skipped: image encoding 'rainbow' is not known" in text


def test_no_planes_are_claimed_where_no_frame_could_be_used(tmp_path, scenes, replay):
    messages = camera_messages(scenes[:1])
    messages[0][2].encoding = 'rainbow'
    code, _, text = replay(write_bag(tmp_path / 'walk', messages))
    assert code == 1
    assert 'no frame could be processed' in text
    assert 'The planes are in' not in text


def test_pictures_without_depth_are_counted(tmp_path, scenes, replay):
    messages = [entry for index, entry in enumerate(camera_messages(scenes)) if index != 5]
    code, target, text = replay(write_bag(tmp_path / 'walk', messages))
    assert code == 0
    assert stamps_of(planes_of(target)) == [0.0, 0.2, 0.3]
    assert '1 pictures had no calibration or depth' in text


def test_depth_of_the_pictures_frame_is_found(tmp_path, scenes, replay):
    other = camera_messages(scenes)
    for entry in other:
        entry[2].header.frame_id = 'another_frame'
    messages = camera_messages(scenes) + [
        ('/other/depth', when, msg) for topic, when, msg in other if topic == DEPTH]
    source = write_bag(tmp_path / 'walk', sorted(messages, key=lambda entry: entry[1]))
    code, target, text = replay(source, '-p', 'depth.source:=topic', depth='')
    assert code == 0, text
    assert_true(target, scenes)


def test_of_several_pictures_the_rectified_colour_one_is_taken(tmp_path, scenes, replay):
    messages = camera_messages(scenes)
    for index, scene in enumerate(scenes):
        for name, pixels, encoding in (('/cam/image_rect', scene.rgb, 'rgb8'),
                                       ('/cam/grey_rect', scene.rgb[..., 0], 'mono8')):
            messages.append((name, time_ns(index) + 3000,
                             image_msg(np.ascontiguousarray(pixels), encoding, stamp_s(index))))
    code, _, text = replay(write_bag(tmp_path / 'walk', messages))
    assert code == 0
    assert 'Reading /cam/image_rect, /cam/camera_info, /cam/depth' in text


def test_of_two_cameras_one_must_be_named(tmp_path, scenes, replay):
    right = ('/right/image_raw', '/right/camera_info', '/right/depth')
    messages = camera_messages(scenes) + camera_messages(scenes, names=right)
    source = write_bag(tmp_path / 'walk', sorted(messages, key=lambda entry: entry[1]))
    code, target, text = replay(source)
    assert (code, target.exists()) == (1, False)
    assert '/cam/image_raw, /right/image_raw may all be meant: say which by --image' in text
    code, _, text = replay(source, '--image', right[0], depth=right[2])
    assert code == 0
    assert f'Reading {", ".join(right)}' in text


@pytest.mark.parametrize('options, told', [
    (('--image', '/cam/picture'), 'there is no topic /cam/picture, as --image says'),
    (('--image', '/bumper'), f'/bumper is of type {CUSTOM_TYPE}, but --image must be '
                             'sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage'),
    (('--camera-info', IMAGE), '--camera-info must be sensor_msgs/msg/CameraInfo')])
def test_wrong_topics_are_told_with_what_is_there(tmp_path, scenes, replay, options, told):
    messages = [*camera_messages(scenes), ('/bumper', time_ns(9), 'bang')]
    code, target, text = replay(write_bag(tmp_path / 'walk', messages), *options)
    assert (code, target.exists()) == (1, False)
    assert told in text
    for topic in (IMAGE, INFO, DEPTH, '/bumper'):
        assert topic in text.partition('holds')[2]
    assert f'{CUSTOM_TYPE}, 1 messages' in text


@pytest.mark.parametrize('missing, told', [
    (IMAGE, 'no topic for --image'), (INFO, 'no topic for --camera-info'),
    (DEPTH, 'no topic for --depth')])
def test_missing_topics_are_told(tmp_path, scenes, replay, missing, told):
    messages = [entry for entry in camera_messages(scenes) if entry[0] != missing]
    source = write_bag(tmp_path / 'walk', messages)
    code, target, text = replay(source, '-p', 'depth.source:=topic', depth='')
    assert (code, target.exists()) == (1, False)
    assert told in text


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


@pytest.mark.parametrize('kind', ['mcap_cut', 'mcap_garbled', 'mcap_gone', 'sqlite3_cut',
                                  'sqlite3_garbled', 'ros1_cut', 'ros1_garbled', 'metadata'])
def test_damaged_bags_are_told_in_one_line(tmp_path, scenes, replay, kind):
    source = damaged(tmp_path, scenes, kind)
    code, _, text = replay(source)
    assert code == 1
    assert text.startswith(f'replay: {source} cannot be read: ')
    assert text.count('\n') == 1
    assert 'There is ' in text


def test_a_bag_that_breaks_off_leaves_what_was_read(tmp_path, scenes, replay):
    """A record in the middle is garbled, the index at the end is whole."""
    source = write_bag(tmp_path / ROS1, camera_messages(scenes), ROS1)
    data = bytearray(source.read_bytes())
    pixels = bytes(data).rindex(scenes[2].depth_m.tobytes())
    data[pixels - 120:pixels] = b'\xff' * 120
    source.write_bytes(bytes(data))
    code, target, text = replay(source)
    assert code == 1
    assert 'Traceback' not in text
    assert stamps_of(planes_of(target)) == [0.0, 0.1]


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


def test_what_is_no_bag_is_told(tmp_path, replay):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'folder' / 'notes.txt').write_text('no bag')
    (tmp_path / 'walk.avi').write_bytes(b'RIFF')
    for name, told in (('nowhere', 'there is no bag'), ('folder', 'There is notes.txt (6 bytes)'),
                       ('walk.avi', 'is no bag')):
        code, _, text = replay(tmp_path / name)
        assert code == 1
        assert told in text


def test_an_empty_bag_is_told(tmp_path, replay):
    code, _, text = replay(write_bag(tmp_path / 'empty', []))
    assert code == 1
    assert 'holds no topic' in text


def test_nothing_is_overwritten(bag, replay, tmp_path):
    (tmp_path / 'planes').mkdir()
    code, target, text = replay(bag)
    assert code == 1
    assert 'is there already' in text
    assert list(target.iterdir()) == []


def test_without_rosbags_it_says_what_to_install(bag, replay, monkeypatch):
    modules = ('rosbags', 'plane_detector.tools.bag', 'plane_detector.tools.replaying')
    for name in [name for name in sys.modules if name.startswith(modules)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'rosbags', None)
    code, _, text = replay(bag)
    assert code == 1
    assert 'pip install rosbags' in text
