# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node: `ros2 launch plane_detector plane_detector.launch.py image:=/camera/image_raw`.

`--show-args` lists the arguments; those that are given win over `params_file`.
"""

import sys
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from plane_detector.ros.launching import ARGUMENTS, check_command_line, node_arguments

PACKAGE = 'plane_detector'
RESPAWN_DELAY_S = 5.0


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = [DeclareLaunchArgument(name, default_value=default, description=description)
                 for name, (default, description) in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_nodes)])


def start_nodes(context: LaunchContext) -> list[Node]:
    """Return the node, and RViz if requested, with the values of the arguments."""
    check_command_line(context.argv, sys.argv)
    value = context.launch_configurations
    share = Path(get_package_share_directory(PACKAGE))
    arguments = node_arguments(value, str(share / 'config' / f'{PACKAGE}.yaml'))
    detector = Node(
        package=PACKAGE, executable='node', name=value['node_name'],
        namespace=value['namespace'], output='screen', parameters=arguments.parameters,
        remappings=arguments.remappings, respawn=arguments.respawn,
        respawn_delay=RESPAWN_DELAY_S, arguments=['--ros-args', '--log-level',
                                                  value['log_level']])
    if not arguments.rviz:
        return [detector]
    rviz = Node(package=PACKAGE, executable='rviz', namespace=value['namespace'], output='screen',
                arguments=['--node', value['node_name'],],
                remappings=arguments.remappings)
    return [detector, rviz]
