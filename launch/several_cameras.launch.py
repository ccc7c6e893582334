# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Start a node for each camera, with `several_cameras.launch.py cameras:=front,rear`.

Each node has its camera as namespace, so that relative topics are those of its camera: `image`
is `/front/image`, and `image:=color/image_raw` is `/front/color/image_raw`. The other arguments
are those of plane_detector.launch.py, the same for all; what differs is in sections of
params_file, as `/front/plane_detector`. The nodes share the compiled kernels and the cores.
"""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchContext, LaunchDescription

PACKAGE = 'plane_detector'


def generate_launch_description() -> LaunchDescription:
    """Return the list of cameras, and what starts their nodes."""
    return LaunchDescription([
        DeclareLaunchArgument('cameras', description='namespaces of the cameras: front,rear',
                              choices=None, default_value=''),
        OpaqueFunction(function=start_cameras)])


def start_cameras(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return the launch file of one node for each camera."""
    value = context.launch_configurations
    cameras = [name.strip().strip('/') for name in value['cameras'].split(',') if name.strip()]
    if not cameras or len(set(cameras)) < len(cameras):
        raise ValueError(f'cameras:={value["cameras"]}: must be different names, such as '
                         'front,rear')
    if value.get('camera') or value.get('namespace'):
        raise ValueError('camera and namespace are for a single camera: give image:= and depth:= '
                         'relative to the namespaces of the cameras')
    file = Path(get_package_share_directory(PACKAGE)) / 'launch' / f'{PACKAGE}.launch.py'
    threads = value.get('network_threads') or str(max(1, (os.cpu_count() or 1) // len(cameras)))
    # Only once: one RViz shows the outputs of all in the frame of the robot.
    rviz = [value.get('rviz', 'false'), *['false'] * (len(cameras) - 1)]
    return [IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(file)),
        launch_arguments=[('namespace', name), ('network_threads', threads), ('rviz', shown)])
        for name, shown in zip(cameras, rviz, strict=True)]
