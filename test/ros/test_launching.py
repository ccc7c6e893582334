# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The launch files with stand-ins for launch and launch_ros, which come with ROS only."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from plane_detector.config import Config, NodeConfig
from plane_detector.settings import parameters_of

ROOT = Path(__file__).resolve().parents[2]
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
