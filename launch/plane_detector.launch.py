# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node: `ros2 launch plane_detector plane_detector.launch.py image:=/camera/image_raw`.

`--show-args` lists the arguments; those that are given win over `params_file`. Arguments of the
launch file that includes this one reach it under the same names; docs/recipes.md has the remedy.
"""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = 'plane_detector'
RESPAWN_DELAY_S = 5.0
# By name: default, description. An empty default keeps the value of params_file.
ARGUMENTS = {
    'params_file': ('', 'yaml file of the parameters; empty: the one that is installed'),
    'node_name': ('plane_detector', 'name of the node, and first part of its topics'),
    'namespace': ('', 'namespace of the node'),
    'image': ('image', 'topic of the colour image; the compressed one follows it'),
    'camera_info': ('', 'topic of its CameraInfo; empty: camera_info beside image'),
    'depth': ('depth', 'topic of measured depth, registered to the image'),
    'imu': ('imu', 'topic of the IMU, for use_imu'),
    'depth_source': ('', 'model or topic'),
    'depth_model': ('', 'depth network: a name of the zoo, an .onnx file or auto'),
    'image_transport': ('', 'raw or compressed'),
    'use_imu': ('', 'true: gravity from the IMU'),
    'base_frame': ('', 'frame of the robot on the floor, for gravity and camera height from TF'),
    'target_frame': ('', 'frame of the outputs'),
    'processing_mode': ('', 'continuous or on_demand'),
    'autostart': ('', 'false: a lifecycle manager configures and activates'),
    'respawn': ('false', 'true: start the node again when it ends; with exit_on_failure'),
    'use_sim_time': ('', 'true: take the time from /clock'),
    'rviz': ('false', 'true: start RViz with the frame of the camera'),
    'log_level': ('info', 'debug, info, warn, error or fatal'),
}
# Launch files in Python pass True and False, those in XML and YAML true and false.
IS_ON = {'': False, 'true': True, 'True': True, 'false': False, 'False': False}
SWITCHES = ('use_imu', 'autostart', 'use_sim_time', 'respawn', 'rviz')
TOPICS = ('image', 'camera_info', 'depth', 'imu')
# Those whose parameter has another name.
PARAMETERS = {'depth_source': 'depth.source', 'depth_model': 'depth.model',
              'processing_mode': 'mode'}
OVERRIDES = ('depth_source', 'depth_model', 'image_transport', 'use_imu', 'base_frame',
             'target_frame', 'processing_mode', 'autostart', 'use_sim_time')
# Fast DDS as it comes loses images between processes.
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
PROFILE_NAMES = (PROFILES, 'FASTDDS_DEFAULT_PROFILES_FILE')


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = [DeclareLaunchArgument(
        name, default_value=default, description=description,
        choices=[*IS_ON] if name in SWITCHES else None)
        for name, (default, description) in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_nodes)])


def start_nodes(context: LaunchContext) -> list[Node]:
    """Return the node, and RViz if requested, with the values of the arguments."""
    value = context.launch_configurations
    share = Path(get_package_share_directory(PACKAGE))
    file = Path(value['params_file'] or share / 'config' / f'{PACKAGE}.yaml').expanduser()
    if not file.is_file():
        raise FileNotFoundError(f'params_file: there is no file {file}')
    overrides = {PARAMETERS.get(name, name): IS_ON[value[name]] if name in SWITCHES
                 else value[name] for name in OVERRIDES if value[name]}
    respawn = IS_ON[value['respawn']]
    if respawn:
        overrides['exit_on_failure'] = True
    remappings = [(name, value[name]) for name in TOPICS if value[name] not in ('', name)]
    profile = {} if any(name in os.environ for name in PROFILE_NAMES) else {
        PROFILES: str(share / 'config' / 'fastdds_large_messages.xml')}
    nodes = [Node(
        package=PACKAGE, executable='node', name=value['node_name'],
        namespace=value['namespace'], output='screen', parameters=[str(file), overrides],
        remappings=remappings, respawn=respawn, respawn_delay=RESPAWN_DELAY_S,
        additional_env=profile, arguments=['--ros-args', '--log-level', value['log_level']])]
    if IS_ON[value['rviz']]:
        nodes.append(Node(
            package=PACKAGE, executable='rviz', namespace=value['namespace'], output='screen',
            arguments=['--node', value['node_name']], remappings=remappings,
            additional_env=profile))
    return nodes
