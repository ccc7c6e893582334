# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The depth that a replay uses, as reported in its output and in the new bag."""

import array
import shutil

import cv2
import numpy as np
import pytest
from bags import messages_of, write_bag
from depth_messages import cloud_msg, compressed_depth_msg
from diagnostic_msgs.msg import DiagnosticArray
from onnx_models import millimetres_as_rgb, network_arguments, write_depth_network
from replay_helpers import CAMERA, DEPTH, IMAGE, INFO, assert_true, camera_messages
from ros_helpers import image_msg
from sensor_msgs.msg import CompressedImage

from plane_detector.geometry.projection import depth_to_points


@pytest.fixture
def network(tmp_path):
    """Return options for a network that reads millimetres out of the colours."""
    path = write_depth_network(tmp_path / 'depth.onnx', height=120, width=160)
    _, _, *options = network_arguments(path)  # without the network itself
    return options, path


def coded(scenes, **options):
    """Return the walk with images that this network understands."""
    messages = camera_messages(scenes, **options)
    images = [msg for topic, _, msg in messages if topic == IMAGE]
    for msg, scene in zip(images, scenes, strict=True):
        msg.data = image_msg(millimetres_as_rgb(scene.depth_m), 'rgb8').data
    return messages


def facts_of(target):
    return [{pair.key: pair.value for pair in msg.status[0].values}
            for msg in messages_of(target, '/diagnostics', DiagnosticArray)]


def test_available_measured_depth_is_used(bag, scenes, replay):
    code, target, text = replay(bag, depth='')
    assert code == 0, text
    assert_true(target, scenes)
    line = (f"measured: {DEPTH} (160 x 120, 32FC1, frame_id 'camera_optical_frame'), registered "
            'to the image')
    assert f'Depth: {line}; --network uses a network instead' in text
    assert f'Scale of {len(scenes)} frames: metres, as measured' in text
    facts = facts_of(target)
    assert [one['frame'] for one in facts] == ['0', '1', '2', '3']
    assert {one['depth'] for one in facts} == {line}
    assert {one['scale'] for one in facts} == {'metres, as measured'}


def test_a_network_is_used_on_request_despite_measured_depth(
        tmp_path, scenes, replay, network):
    options, path = network
    source = write_bag(tmp_path / 'walk', coded(scenes))
    code, target, text = replay(source, '--network', path, *options, depth='')
    assert code == 0, text
    assert f'Reading {IMAGE}, /cam/camera_info of' in text
    assert 'Depth: network ' in text
    assert 'depth.onnx' in text
    assert 'not measured depth, as requested' in text
    assert 'Scale of 4 frames: metric' in text
    assert_true(target, scenes)


def compressed(messages):
    """Return the messages with images as PNG files; of each the stamp stays."""
    for k, (topic, when, msg) in enumerate(messages):
        if topic == IMAGE:
            pixels = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.width, 3)
            png = CompressedImage(header=msg.header, format='rgb8; png compressed bgr8')
            png.data = array.array('B', cv2.imencode('.png', pixels[..., ::-1])[1].tobytes())
            messages[k] = f'{IMAGE}/compressed', when, png
    return messages


@pytest.mark.parametrize('change, expected', [
    ('none', 'because the bag has no depth images'),
    ('compressed', 'because the bag has no depth images'),
    ('frame', "because /cam/depth (160 x 120, 32FC1, frame_id 'depth_optical') is not registered "
              "to the image (160 x 120, frame_id 'camera_optical_frame')"),
    ('size', 'because /cam/depth (80 x 60, 32FC1')])
def test_without_registered_depth_a_network_is_used_with_the_reason(
        tmp_path, scenes, replay, network, change, expected):
    messages = coded(scenes, depth=change in ('frame', 'size'))
    if change == 'compressed':
        messages = compressed(messages)
    for topic, _, msg in messages:
        if topic == DEPTH and change == 'frame':
            msg.header.frame_id = 'depth_optical'
        elif topic == DEPTH:
            half = image_msg(scenes[0].depth_m[::2, ::2].copy(), '32FC1')
            msg.width, msg.height, msg.step, msg.data = 80, 60, half.step, half.data
    options, path = network
    yaml = tmp_path / 'network.yaml'
    yaml.write_text(f'/**:\n  ros__parameters:\n    depth:\n      model: {path}\n')
    code, target, text = replay(write_bag(tmp_path / 'walk', messages), '--params-file', yaml,
                                *options, depth='')
    assert code == 0, text
    assert expected in text
    assert_true(target, scenes)
    assert expected in facts_of(target)[0]['depth']


def in_form(scenes, form, keep_raw=False, colour=True):
    """Return the walk with depth as a driver sends it; the topic of that depth."""
    name = {'points': '/cam/points'}.get(form, f'{DEPTH}/compressedDepth')
    messages = []
    for index, (topic, when, msg) in enumerate(camera_messages(scenes)):
        depth_m = scenes[index // 3].depth_m
        if topic == DEPTH:
            other = (cloud_msg(depth_to_points(depth_m, CAMERA)) if form == 'points'
                     else compressed_depth_msg(depth_m, kind=form))
            other.header = msg.header
            messages.append((name, when + 1, other))
        if topic == INFO or topic == IMAGE and colour or topic == DEPTH and keep_raw:
            messages.append((topic, when, msg))
    return sorted(messages, key=lambda entry: entry[1]), name


@pytest.mark.parametrize('form, colour', [('png', True), ('rvl', False)])
def test_compressed_depth_is_measured_depth(tmp_path, scenes, replay, form, colour):
    """No network is used although none was asked for: that one is weak."""
    messages, name = in_form(scenes, form, colour=colour)
    code, target, text = replay(write_bag(tmp_path / 'walk', messages), depth='')
    assert code == 0, text
    assert f'Depth: measured: {name} (160 x 120, 16UC1; compressedDepth {form}' in text
    assert ('registered to the image' if colour else 'without a colour image') in text
    assert_true(target, scenes)


def test_of_two_transports_of_one_depth_the_raw_one_is_read(tmp_path, scenes, replay):
    messages, _ = in_form(scenes, 'png', keep_raw=True)
    code, _, text = replay(write_bag(tmp_path / 'walk', messages), depth='')
    assert code == 0, text
    assert f'Depth: measured: {DEPTH} (160 x 120, 32FC1' in text


def test_a_topic_named_by_depth_may_be_of_any_form(tmp_path, scenes, replay):
    for form in ('rvl', 'points'):
        messages, name = in_form(scenes, form)
        code, target, text = replay(write_bag(tmp_path / form, messages), depth=name)
        assert code == 0, text
        assert_true(target, scenes)
        shutil.rmtree(target)


def test_organised_clouds_are_depth_on_request(tmp_path, scenes, replay):
    messages, name = in_form(scenes, 'points', colour=False)
    code, target, text = replay(
        write_bag(tmp_path / 'walk', messages), '-p', 'depth.source:=points', '-p',
        'depth.colour:=none', depth='')
    assert code == 0, text
    assert f'Depth: measured: {name} (160 x 120, points' in text
    assert_true(target, scenes)


def test_depth_in_another_unit(tmp_path, scenes, replay):
    messages = camera_messages(scenes)
    for index, scene in enumerate(scenes):
        msg = messages[3 * index + 2][2]
        counts = np.nan_to_num(scene.depth_m / 0.00025).round().astype(np.uint16)
        msg.encoding, msg.step, msg.data = '16UC1', 320, image_msg(counts, '16UC1').data
    code, target, text = replay(write_bag(tmp_path / 'walk', messages), '-p',
                                'depth.unit:=0.00025', depth='')
    assert code == 0, text
    assert_true(target, scenes)
