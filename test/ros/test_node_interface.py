# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What users read and see of the node: command line, docstring, launch files, Foxglove."""

import ast
import json
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from node_helpers import start
from rclpy.parameter import Parameter
from ros_helpers import bare_node

from plane_detector.config import Config, DepthConfig, NodeConfig
from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.inputs.subscriptions import input_topics
from plane_detector.ros.node import main, not_of_ros
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.ros.parameters import updated
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
    of_map = {f'/plane_detector/map/{name}' for name in ('planes', 'boundaries', 'markers')}
    assert set(topics) <= TOPICS | of_map
    assert {topic for topic, view in topics.items() if view['visible']} == {
        f'/plane_detector/{name}' for name in ('points', 'markers', 'map/markers')}
    assert set(topics) >= of_map | {
        f'/plane_detector/{name}' for name in ('ground', 'points_without_floor', 'drops')}
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
        names = input_topics(node, transport, DepthConfig())
    assert (names['image'], names['camera_info']) == expected


@pytest.mark.parametrize('remap, settings, depth, camera_info', [
    ('depth:=/cam/depth/image', {}, '/cam/depth/image', '/camera_info'),
    ('depth:=/cam/depth/image', {'transport': 'compressedDepth'},
     '/cam/depth/image/compressedDepth', '/camera_info'),
    ('depth/compressedDepth:=/cam/rvl', {'transport': 'compressedDepth'}, '/cam/rvl',
     '/camera_info'),
    ('depth:=/cam/depth/image', {'transport': 'compressedDepth', 'colour': 'none'},
     '/cam/depth/image/compressedDepth', '/cam/depth/camera_info'),
    ('depth/points:=/cam/depth/points', {'source': 'points', 'colour': 'none'}, '/depth',
     '/cam/depth/camera_info')])
def test_topics_of_depth(remap, settings, depth, camera_info):
    with bare_node('camera', ('-r', remap)) as node:
        names = input_topics(node, 'raw', DepthConfig(**{'source': 'topic', **settings}))
    assert (names['depth'], names['camera_info']) == (depth, camera_info)


CHOSEN = ('depth_source', 'depth_transport', 'depth_colour', 'mounting', 'image_transport',
          'points_color', 'processing_mode')
YAML = str(ROOT / 'config' / 'plane_detector.yaml')
PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'


@pytest.fixture
def read(monkeypatch):
    """
    Return a function: launch file -> its global names.

    The packages of launch cannot be installed here; these members do what theirs do.
    """
    def share_of(package):
        if package != 'plane_detector':
            raise LookupError(package)
        return str(ROOT)

    contents = {
        'launch': {'LaunchContext': object, 'LaunchDescription': list},
        'launch.actions': {
            'DeclareLaunchArgument': lambda name, **rest: (name, rest),
            'OpaqueFunction': lambda function: function,
            'IncludeLaunchDescription': lambda source, **rest: (source, rest)},
        'launch.launch_description_sources': {'PythonLaunchDescriptionSource': str},
        'launch_ros': {}, 'launch_ros.actions': {'Node': lambda **keywords: keywords},
        'ament_index_python.packages': {'get_package_share_directory': share_of,
                                        'PackageNotFoundError': LookupError}}
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delenv(PROFILE, raising=False)
    return lambda name: runpy.run_path(str(ROOT / 'launch' / name))


@pytest.fixture
def file(read):
    return read('plane_detector.launch.py')


def declared(file, values):
    """Return the values after the declarations, which take those that are there already."""
    *arguments, start = file['generate_launch_description']()
    values = {name: values.get(name, rest['default_value']) for name, rest in arguments} | values
    for name, rest in arguments:
        assert rest['choices'] is None or rest['default_value'] in rest['choices']
        if rest['choices'] is not None and values[name] not in rest['choices']:
            raise RuntimeError(f'Argument "{name}" provided value "{values[name]}" is not valid')
    return values, start


@pytest.fixture
def launched(file):
    """Return a function: values -> the keyword arguments of the nodes that are started."""
    def launch(**values):
        values, start = declared(file, values)
        return start(SimpleNamespace(launch_configurations=values))
    return launch


def test_without_arguments_the_installed_file_is_used(launched):
    (node,) = launched()
    assert node['parameters'] == [YAML, {}]
    assert node['remappings'] == []
    assert node['additional_env'] == {
        PROFILE: str(ROOT / 'config' / 'fastdds_large_messages.xml')}


def test_arguments_become_parameters_and_remaps(launched):
    node, rviz = launched(
        image='/cam/image', depth_source='topic', use_imu='true', depth_model='a.onnx',
        rviz='true', imu='/imu/data', autostart='false', respawn='true',
        processing_mode='on_demand', namespace='front', node_name='planes')
    assert (node['executable'], node['name'], node['namespace']) == ('node', 'planes', 'front')
    assert node['remappings'] == [('image', '/cam/image'), ('imu', '/imu/data')]
    assert node['parameters'] == [YAML, {
        'depth.source': 'topic', 'depth.model': 'a.onnx', 'use_imu': True, 'mode': 'on_demand',
        'autostart': False, 'exit_on_failure': True, 'points_color': 'overlay'}]
    assert node['respawn']
    assert (rviz['executable'], rviz['remappings']) == ('rviz', node['remappings'])


def test_every_parameter_of_an_argument_exists(launched, file):
    names = {name for part in (Config(), NodeConfig()) for name, _, _ in parameters_of(part)}
    texts = dict.fromkeys(file['ARGUMENTS'], 'true') | {
        'params_file': '', 'camera': '', 'max_side': '640', 'camera_height': '1.2',
        'network_threads': '2', 'gravity': '0 1 0'} | {
            name: file['CHOICES'][name][1] for name in CHOSEN}
    node, _ = launched(**texts)
    assert set(node['parameters'][1]) <= names | {'use_sim_time'}
    assert len(node['parameters'][1]) == len(file['OVERRIDES']) + 1


@pytest.mark.parametrize('name', CHOSEN)
def test_every_choice_of_an_argument_is_one_of_its_parameter(launched, file, name):
    _, *choices = file['CHOICES'][name]
    for choice in choices:
        node, = launched(**{name: choice})
        ((parameter, value),) = node['parameters'][1].items()
        (settings,) = (part for part in (Config(), NodeConfig())
                       if parameter in {key for key, _, _ in parameters_of(part)})
        updated(settings, [Parameter('depth.source', value='topic'),
                           Parameter(parameter, value=value)])
    with pytest.raises(RuntimeError, match=f'"{name}" provided value "labels"'):
        launched(**{name: 'labels'})


def test_a_number_with_a_comma_is_explained(launched):
    with pytest.raises(ValueError, match=r'camera_height:=1,2: must be a number, such as 1\.2'):
        launched(camera_height='1,2')


def test_rviz_has_the_clock_and_the_frame_of_the_node(launched):
    _, rviz = launched(rviz='true', use_sim_time='true', target_frame='odom')
    assert rviz['parameters'] == [{'use_sim_time': True}]
    assert rviz['arguments'][-2:] == ['--frame', 'odom']


def test_switches_as_launch_files_in_python_write_them(launched):
    node, _rviz = launched(use_sim_time='True', rviz='True', respawn='False', use_imu='False')
    assert node['parameters'] == [YAML, {'use_imu': False, 'use_sim_time': True,
                                         'points_color': 'overlay'}]
    assert node['respawn'] is False
    with pytest.raises(RuntimeError, match='"rviz" provided value "yes"'):
        launched(rviz='yes')


@pytest.mark.parametrize('gravity', ['0 1 0', '[0.0, 1.0, 0.0]', '0,1,0'])
def test_numbers_are_passed_as_what_the_parameters_are(launched, gravity):
    (node,) = launched(camera_height='1.2', gravity=gravity, max_side='640', points_color='label',
                       plane_map='true')
    given = node['parameters'][1]
    assert given == {'scale.camera_height': 1.2, 'scale.gravity': [0.0, 1.0, 0.0],
                     'max_side': 640, 'points_color': 'label', 'map.enabled': True}
    assert isinstance(given['max_side'], int)


@pytest.mark.parametrize('camera', ['realsense', 'oak', 'zed', 'orbbec', 'usb_cam'])
def test_a_camera_brings_its_topics(launched, file, camera):
    (node,) = launched(camera=camera)
    topics = dict(node['remappings'])
    assert all(topic.startswith('/') for topic in topics.values())
    assert set(topics) == ({'image'} if camera == 'usb_cam' else {'image', 'depth'})
    assert node['parameters'][1].get('depth.source') == (
        None if camera == 'usb_cam' else 'topic')
    recipes = (ROOT / 'docs' / 'recipes.md').read_text('utf-8')
    assert f'| `{camera}` |' in recipes
    assert all(f'`{topic}`' in recipes for topic in topics.values())


def test_what_is_given_wins_over_the_camera(launched):
    (node,) = launched(camera='realsense', image='/left/image', depth_source='model')
    assert dict(node['remappings'])['image'] == '/left/image'
    assert node['parameters'][1] == {'depth.source': 'model'}


def test_a_camera_without_topics_is_refused(launched):
    with pytest.raises(RuntimeError, match='"camera" provided value "kinect"'):
        launched(camera='kinect')


def test_model_and_mode_of_a_robot_have_no_effect(launched):
    (node,) = launched(model='/robot.urdf', mode='localization', map='/maps/office.yaml')
    assert node['parameters'] == [YAML, {}]


def test_a_profile_of_the_user_is_kept(launched, monkeypatch):
    monkeypatch.setenv(PROFILE, '/own.xml')
    assert launched()[0]['additional_env'] == {}


def test_the_recipe_passes_only_what_it_names(file):
    recipe = (ROOT / 'docs' / 'recipes.md').read_text('utf-8')
    (code,) = [code for code in re.findall(r'```python\n(.*?)```', recipe, re.DOTALL)
               if 'GroupAction' in code]
    calls = {node.func.id: node for node in ast.walk(ast.parse(code))
             if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    keywords = {word.arg: word.value for word in calls['GroupAction'].keywords}
    assert keywords['forwarding'].value is False
    (given,) = (word.value for word in calls['IncludeLaunchDescription'].keywords)
    assert {name.value for name in given.func.value.keys} <= set(file['ARGUMENTS'])


@pytest.fixture
def managed(read):
    """Return a function: values -> the node and its manager, as launch executes the file."""
    def launch(**values):
        file = read('with_lifecycle_manager.launch.py')
        check, (included, rest), start_manager = file['generate_launch_description']()
        check(None)
        values, start = declared(runpy.run_path(included),
                                 values | dict(rest['launch_arguments']))
        context = SimpleNamespace(launch_configurations=values)
        return start(context)[0], *start_manager(context)
    return launch


def test_without_nav2_nothing_is_started(managed):
    with pytest.raises(RuntimeError, match='apt install ros-jazzy-nav2-lifecycle-manager'):
        managed()


def test_the_manager_has_name_and_namespace_of_the_node(managed, monkeypatch):
    monkeypatch.setattr(sys.modules['ament_index_python.packages'],
                        'get_package_share_directory', lambda _: str(ROOT))
    node, manager = managed(node_name='planes', namespace='front', use_sim_time='True')
    assert node['parameters'][1] == {'autostart': False, 'use_sim_time': True}
    assert (node['name'], node['namespace']) == ('planes', 'front')
    assert manager['namespace'] == 'front'
    assert manager['parameters'] == [{'autostart': True, 'node_names': ['planes'],
                                      'bond_timeout': 0.0, 'service_timeout': 600.0,
                                      'use_sim_time': True}]


@pytest.fixture
def several(read):
    """Return a function: values -> the keyword arguments of all nodes, as launch starts them."""
    def launch(**values):
        argument, start = read('several_cameras.launch.py')['generate_launch_description']()
        values = {argument[0]: argument[1]['default_value']} | values
        started = []
        for included, rest in start(SimpleNamespace(launch_configurations=values)):
            # Arguments of an included file stay set for those after it.
            values |= dict(rest['launch_arguments'])
            file = runpy.run_path(included)
            its, start_nodes = declared(file, values)
            started += start_nodes(SimpleNamespace(launch_configurations=its))
        return started
    return launch


def test_each_camera_has_a_node_in_its_namespace_and_its_share_of_the_cores(several, monkeypatch):
    monkeypatch.setattr('os.cpu_count', lambda: 8)
    front, rviz, rear = several(cameras='front, rear', image='color/image_raw', rviz='true',
                                base_frame='base_footprint')
    assert (front['namespace'], rear['namespace']) == ('front', 'rear')
    assert rviz['executable'] == 'rviz'
    for node in (front, rear):
        assert node['executable'] == 'node'
        assert node['remappings'] == [('image', 'color/image_raw')], 'below its namespace'
        assert node['parameters'][1]['depth.threads'] == 4
        assert node['parameters'][1]['base_frame'] == 'base_footprint'


def test_threads_that_are_given_are_kept_and_never_none(several, monkeypatch):
    monkeypatch.setattr('os.cpu_count', lambda: 2)
    assert {node['parameters'][1]['depth.threads'] for node in several(cameras='a,b,c')} == {1}
    assert {node['parameters'][1]['depth.threads']
            for node in several(cameras='a,b', network_threads='3')} == {3}


@pytest.mark.parametrize('values', [{'cameras': ''}, {'cameras': 'front,front'},
                                    {'cameras': 'front', 'camera': 'realsense'},
                                    {'cameras': 'front', 'namespace': 'robot'}])
def test_cameras_that_make_no_sense_are_refused(several, values):
    with pytest.raises(ValueError, match='different names|single camera'):
        several(**values)
