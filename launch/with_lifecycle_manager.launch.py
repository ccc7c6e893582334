# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The node under the lifecycle manager of Nav2, which configures and activates it.

The arguments are those of plane_detector.launch.py.
"""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from launch.actions import IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE, MANAGER = 'plane_detector', 'nav2_lifecycle_manager'
# The first start compiles and may download a network. Managers without this parameter, older than
# its default of 5 s, wait as long as it takes.
CONFIGURE_TIMEOUT_S = 600.0


def generate_launch_description() -> LaunchDescription:
    """Return the check for Nav2, the node without autostart, and its manager."""
    file = Path(get_package_share_directory(PACKAGE)) / 'launch' / f'{PACKAGE}.launch.py'
    node = IncludeLaunchDescription(PythonLaunchDescriptionSource(str(file)),
                                    launch_arguments=[('autostart', 'false')])
    return LaunchDescription([OpaqueFunction(function=check_for_nav2), node,
                              OpaqueFunction(function=start_manager)])


def check_for_nav2(_context: LaunchContext) -> None:
    """Raise an error before the node starts: nobody would configure it."""
    try:
        get_package_share_directory(MANAGER)
    except PackageNotFoundError as error:
        raise RuntimeError(f'{MANAGER} is not installed: apt install '
                           'ros-jazzy-nav2-lifecycle-manager, or use plane_detector.launch.py, '
                           'which needs no manager') from error


def start_manager(context: LaunchContext) -> list[Node]:
    """Return the manager, beside the node and with its name; the node has no bond to it."""
    value = context.launch_configurations
    is_simulated = value['use_sim_time'].lower() == 'true'
    return [Node(
        package=MANAGER, executable='lifecycle_manager', name='lifecycle_manager_planes',
        namespace=value['namespace'], output='screen',
        parameters=[{'autostart': True, 'node_names': [value['node_name']], 'bond_timeout': 0.0,
                     'service_timeout': CONFIGURE_TIMEOUT_S, 'use_sim_time': is_simulated}])]
