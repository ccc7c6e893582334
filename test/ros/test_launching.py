# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The launch file with stand-ins for launch and launch_ros, which come with ROS only."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.launching import ARGUMENTS, check_command_line, node_arguments
from plane_detector.settings import parameters_of

ROOT = Path(__file__).resolve().parents[2]
YAML = str(ROOT / 'config' / 'plane_detector.yaml')
DEFAULTS = {name: default for name, (default, _) in ARGUMENTS.items()}


def arguments(**values):
    return node_arguments({**DEFAULTS, **values}, YAML)


def test_without_arguments_the_file_is_used():
    assert arguments() == ([YAML, {}], [], False, False)


def test_arguments_become_parameters_and_remaps():
    given = arguments(image='/cam/image', depth_source='topic', use_imu='True', model='a.onnx',
                      imu='/imu/data', autostart='false', respawn='true', mode='on_demand')
    assert given.remappings == [('image', '/cam/image'), ('imu', '/imu/data')]
    assert given.parameters == [YAML, {
        'depth.source': 'topic', 'depth.model': 'a.onnx', 'use_imu': True, 'mode': 'on_demand',
        'autostart': False, 'exit_on_failure': True}]
    assert given.respawn


def test_every_parameter_of_an_argument_exists():
    names = {name for part in (Config(), NodeConfig()) for name, _, _ in parameters_of(part)}
    given = arguments(**{name: 'true' for name in ARGUMENTS if name != 'params_file'})
    assert set(given.parameters[1]) <= names | {'use_sim_time'}


@pytest.mark.parametrize('name', ['use_imu', 'respawn', 'use_sim_time', 'autostart', 'rviz'])
def test_values_that_are_not_boolean_are_an_error(name):
    with pytest.raises(ValueError, match=f"{name} must be true or false, not 'maybe'"):
        arguments(**{name: 'maybe'})


def test_a_missing_file_is_an_error():
    with pytest.raises(FileNotFoundError, match=r'/nowhere\.yaml'):
        arguments(params_file='/nowhere.yaml')


def test_an_unknown_argument_is_an_error_unless_it_is_of_an_including_file():
    program = ['ros2', 'launch', 'plane_detector', 'plane_detector.launch.py', 'imgae:=/cam']
    with pytest.raises(ValueError, match=r'no argument imgae \(meant: image\?\)'):
        check_command_line(['imgae:=/cam'], program)
    check_command_line(['image:=/cam'], program)
    check_command_line(['imgae:=/cam'], ['ros2', 'launch', 'robot', 'robot.launch.py'])


@pytest.fixture
def launched(monkeypatch):
    """Return a function: values -> the keyword arguments of the nodes that are started."""
    modules = {name: ModuleType(name) for name in (
        'launch', 'launch.actions', 'launch_ros', 'launch_ros.actions',
        'ament_index_python.packages')}
    modules['launch'].LaunchContext = object
    modules['launch'].LaunchDescription = list
    modules['launch.actions'].DeclareLaunchArgument = lambda name, **rest: (name, rest)
    modules['launch.actions'].OpaqueFunction = lambda function: function
    modules['launch_ros.actions'].Node = lambda **keywords: keywords
    modules['ament_index_python.packages'].get_package_share_directory = lambda _: str(ROOT)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)

    def launch(**values):
        file = runpy.run_path(str(ROOT / 'launch' / 'plane_detector.launch.py'))
        *declared, start = file['generate_launch_description']()
        assert [name for name, _ in declared] == list(ARGUMENTS)
        context = SimpleNamespace(argv=[], launch_configurations={**DEFAULTS, **values})
        return start(context)
    return launch


def test_the_launch_file_starts_the_node(launched):
    (node,) = launched(node_name='planes', namespace='front', image='/cam/image')
    assert node['package'] == 'plane_detector'
    assert (node['executable'], node['name'], node['namespace']) == ('node', 'planes', 'front')
    assert node['remappings'] == [('image', '/cam/image')]
    assert node['respawn'] is False


def test_rviz_is_started_on_request(launched):
    _, rviz = launched(rviz='true', image='/cam/image')
    assert rviz['executable'] == 'rviz'
    assert rviz['remappings'] == [('image', '/cam/image')]
