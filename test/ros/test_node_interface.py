# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What users read and see of the node: command line, docstring, launch files, Foxglove."""

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from node_helpers import start
from ros_helpers import bare_node

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.inputs.subscriptions import input_topics
from plane_detector.ros.node import main, not_of_ros
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.settings import parameters_of

ROOT = Path(__file__).resolve().parents[2]
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
    layout = json.loads((ROOT / 'config' / 'foxglove_layout.json').read_text('utf-8'))
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


YAML = str(ROOT / 'config' / 'plane_detector.yaml')
PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'


@pytest.fixture
def read(monkeypatch):
    """Return a function: launch file -> its global names."""
    contents = {
        'launch': {'LaunchContext': object, 'LaunchDescription': list},
        'launch.actions': {
            'DeclareLaunchArgument': lambda name, **rest: (name, rest),
            'OpaqueFunction': lambda function: function,
            'IncludeLaunchDescription': lambda source, **rest: (source, rest)},
        'launch.launch_description_sources': {'PythonLaunchDescriptionSource': str},
        'launch_ros': {}, 'launch_ros.actions': {'Node': lambda **keywords: keywords},
        'ament_index_python.packages': {'get_package_share_directory': lambda _: str(ROOT)}}
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delenv(PROFILE, raising=False)
    return lambda name: runpy.run_path(str(ROOT / 'launch' / name))


@pytest.fixture
def file(read):
    return read('plane_detector.launch.py')


@pytest.fixture
def launched(file):
    """Return a function: values -> the keyword arguments of the nodes that are started."""
    def launch(**values):
        *declared, start = file['generate_launch_description']()
        defaults = {name: rest['default_value'] for name, rest in declared}
        assert set(values) <= set(defaults)
        return start(SimpleNamespace(launch_configurations={**defaults, **values}))
    return launch


def test_without_arguments_the_installed_file_is_used(launched):
    (node,) = launched()
    assert node['parameters'] == [YAML, {}]
    assert node['remappings'] == []
    assert node['additional_env'] == {
        PROFILE: str(ROOT / 'config' / 'fastdds_large_messages.xml')}


def test_arguments_become_parameters_and_remaps(launched):
    node, rviz = launched(
        image='/cam/image', depth_source='topic', use_imu='true', model='a.onnx', rviz='true',
        imu='/imu/data', autostart='false', respawn='true', mode='on_demand', namespace='front',
        node_name='planes')
    assert (node['executable'], node['name'], node['namespace']) == ('node', 'planes', 'front')
    assert node['remappings'] == [('image', '/cam/image'), ('imu', '/imu/data')]
    assert node['parameters'] == [YAML, {
        'depth.source': 'topic', 'depth.model': 'a.onnx', 'use_imu': True, 'mode': 'on_demand',
        'autostart': False, 'exit_on_failure': True}]
    assert node['respawn']
    assert (rviz['executable'], rviz['remappings']) == ('rviz', node['remappings'])


def test_every_parameter_of_an_argument_exists(launched, file):
    names = {name for part in (Config(), NodeConfig()) for name, _, _ in parameters_of(part)}
    node, _ = launched(**{name: 'true' for name in file['ARGUMENTS'] if name != 'params_file'})
    assert set(node['parameters'][1]) <= names | {'use_sim_time'}
    assert len(node['parameters'][1]) == len(file['OVERRIDES']) + 1


def test_a_profile_of_the_user_is_kept(launched, monkeypatch):
    monkeypatch.setenv(PROFILE, '/own.xml')
    assert launched()[0]['additional_env'] == {}


def test_the_lifecycle_manager_starts_the_node_without_autostart(read):
    file = read('with_lifecycle_manager.launch.py')
    (included, arguments), manager = file['generate_launch_description']()
    assert Path(included).is_file()
    assert dict(arguments['launch_arguments']) == {'autostart': 'false'}
    assert manager['parameters'][0]['node_names'] == ['plane_detector']
