# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What users read and see of the node: command line, docstring, layout of Foxglove."""

import json
from pathlib import Path

import pytest
from node_helpers import start
from ros_helpers import bare_node

from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.inputs.subscriptions import input_topics
from plane_detector.ros.node import main, not_of_ros
from plane_detector.ros.outputs.topics import OUTPUTS

REPOSITORY = Path(__file__).resolve().parents[2]
TOPICS = {f'/plane_detector/{name}' for name in OUTPUTS} | {'/diagnostics'}


@pytest.mark.parametrize('arguments', [['--help'], ['-h'], ['-h', '--ros-args', '-p', 'a:=1']])
def test_help_is_printed(arguments, capsys):
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith('usage: ros2 run plane_detector node')
    assert printed.err == ''


@pytest.mark.parametrize('arguments', [['image:=/camera'], ['--ros-args', '--', '--fast']])
def test_arguments_that_are_not_of_ros_are_refused(arguments, capsys):
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ''
    assert printed.err.startswith('usage:')
    assert printed.err.endswith(f'not understood: {arguments[-1]}\n')


def test_arguments_between_ros_args_and_dashes_belong_to_ros():
    assert not_of_ros(['--ros-args', '-r', 'image:=/a', '--', 'x', '--ros-args', '-h']) == ['x']


def test_every_output_service_and_input_of_the_node_is_named(robot):
    """In its docstring."""
    node = start(robot, lambda rgb: None, use_imu=True)
    own = [service.srv_name for service in node.services if service.srv_name.startswith('~')]
    assert own
    for name in (*own, 'image', 'camera_info', 'imu', 'clicked_point',
                 *(f'~/{output}' for output in OUTPUTS)):
        assert name in PlaneDetectorNode.__doc__, name


def leaves(layout):
    """Return the panels of a layout, which is one or a pair of layouts."""
    if isinstance(layout, str):
        return {layout}
    return leaves(layout['first']) | leaves(layout['second'])


def test_foxglove_shows_overlay_cloud_markers_planes_and_state():
    """In panels that Lichtblick has too."""
    layout = json.loads((REPOSITORY / 'config' / 'foxglove_layout.json').read_text('utf-8'))
    panels = layout['configById']
    assert leaves(layout['layout']) == set(panels)
    # An ImageViewPanel is of no known type since 2023.
    assert {name.partition('!')[0] for name in panels} == {'Image', '3D', 'DiagnosticStatusPanel'}
    for panel in panels.values():
        assert panel['foxglovePanelTitle'] == panel['lichtblickPanelTitle']
    assert panels['Image!overlay']['imageMode']['imageTopic'] == '/plane_detector/overlay'
    topics = panels['3D!planes']['topics']
    assert set(topics) <= TOPICS
    assert {topic for topic, view in topics.items() if view['visible']} == {
        '/plane_detector/points', '/plane_detector/markers'}
    points = topics['/plane_detector/points']
    assert (points['colorMode'], points['colorField']) == ('rgb', 'rgb'), 'see points_color'


@pytest.mark.parametrize('transport, remaps, expected', [
    ('raw', (), ('/image', '/camera_info')),
    ('raw', ('__ns:=/front',), ('/front/image', '/front/camera_info')),
    ('raw', ('image:=/cam/color/image_raw',), ('/cam/color/image_raw', '/cam/color/camera_info')),
    ('raw', ('image:=/cam/image', 'camera_info:=/other/info'), ('/cam/image', '/other/info')),
    ('raw', ('image:=image_raw',), ('/image_raw', '/camera_info')),
    ('compressed', (), ('/image/compressed', '/camera_info')),
    ('compressed', ('image:=/cam/image_raw',), ('/cam/image_raw/compressed', '/cam/camera_info')),
    ('compressed', ('image:=/cam/image_raw/compressed',),
     ('/cam/image_raw/compressed', '/cam/camera_info')),
    ('compressed', ('image/compressed:=/cam/jpeg',), ('/cam/jpeg', '/cam/camera_info'))])
def test_topics_follow_a_remapped_image(transport, remaps, expected):
    arguments = tuple(word for remap in remaps for word in ('-r', remap))
    with bare_node('camera', arguments) as node:
        names = input_topics(node, transport)
    assert (names['image'], names['camera_info']) == expected
