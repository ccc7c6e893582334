# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node: `ros2 launch plane_detector plane_detector.launch.py image:=/camera/image_raw`.

`--show-args` lists the arguments. `model` and `use_sim_time` win over `params_file` when given.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = 'plane_detector'
ARGUMENTS = {
    'params_file': (str(Path(get_package_share_directory(PACKAGE)) / 'config' / f'{PACKAGE}.yaml'),
                    'yaml file of the parameters'),
    'namespace': ('', 'namespace of the node'),
    'image': ('image', 'topic of the colour picture'),
    'camera_info': ('camera_info', 'topic of its CameraInfo'),
    'depth': ('depth', 'topic of measured depth, for depth.source: topic'),
    'imu': ('imu', 'topic of the IMU, for use_imu'),
    'model': ('', 'depth network: a name of the zoo, an .onnx file or auto'),
    'use_sim_time': ('', 'true: take the time from /clock'),
    'log_level': ('info', 'debug, info, warn, error or fatal'),
}


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the node."""
    arguments = [DeclareLaunchArgument(name, default_value=default, description=description)
                 for name, (default, description) in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_node)])


def start_node(context: LaunchContext) -> list[Node]:
    """Return the node with the values of the arguments."""
    value = context.launch_configurations
    overrides = {}
    if value['model']:
        overrides['depth.model'] = value['model']
    if value['use_sim_time']:
        overrides['use_sim_time'] = value['use_sim_time'].lower() == 'true'
    return [Node(
        package=PACKAGE,
        executable='node',
        name=PACKAGE,
        namespace=value['namespace'],
        output='screen',
        parameters=[value['params_file'], overrides],
        remappings=[
            ('image', value['image']),
            ('image/compressed', f'{value["image"]}/compressed'),
            ('camera_info', value['camera_info']),
            ('depth', value['depth']),
            ('imu', value['imu']),
        ],
        arguments=['--ros-args', '--log-level', value['log_level']],
    )]
