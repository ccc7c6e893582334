# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node under the lifecycle manager of Nav2, which configures and activates it."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node

from launch import LaunchDescription

PACKAGE = 'plane_detector'


def generate_launch_description() -> LaunchDescription:
    """Return the node without autostart, and its manager; the node has no bond to it."""
    file = Path(get_package_share_directory(PACKAGE)) / 'launch' / f'{PACKAGE}.launch.py'
    node = IncludeLaunchDescription(PythonLaunchDescriptionSource(str(file)),
                                    launch_arguments=[('autostart', 'false')])
    manager = Node(package='nav2_lifecycle_manager', executable='lifecycle_manager',
                   name='lifecycle_manager_planes', output='screen',
                   parameters=[{'autostart': True, 'node_names': [PACKAGE],
                                'bond_timeout': 0.0}])
    return LaunchDescription([node, manager])
