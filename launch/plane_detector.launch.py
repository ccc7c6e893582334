# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node: `ros2 launch plane_detector plane_detector.launch.py image:=/camera/image_raw`.

`--show-args` lists the arguments; those that are given win over `params_file`. Arguments of the
launch file that includes this one reach it under the same names; docs/recipes.md has the remedy.
"""

import os
import re
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from plane_detector.config import DepthConfig, DirectionsConfig, NodeConfig

PACKAGE = 'plane_detector'
RESPAWN_DELAY_S = 5.0
# By name: default, description. An empty default keeps the value of params_file.
ARGUMENTS = {
    'params_file': ('', 'yaml file of the parameters; empty: the installed one'),
    'node_name': ('plane_detector', 'name of the node, and first part of its topics'),
    'namespace': ('', 'namespace of the node'),
    'camera': ('', 'camera driver: sets depth_source, and the topics below unless they are given'),
    'image': ('image', 'topic of the colour image; the compressed topic follows it'),
    'camera_info': ('', 'topic of its CameraInfo; empty: camera_info in the namespace of image'),
    'depth': ('depth', 'topic of measured depth, registered to the image'),
    'imu': ('imu', 'topic of the IMU, for use_imu'),
    'depth_source': ('', 'model, topic or points'),
    'depth_transport': ('', 'raw or compressedDepth'),
    'depth_colour': ('', 'none: depth alone, no colour image is needed'),
    'depth_model': ('', 'depth network: a name of the zoo, an .onnx file or auto'),
    'network_threads': ('', 'threads of the depth network; empty or 0: one per core'),
    'image_transport': ('', 'raw or compressed'),
    'max_side': ('', 'larger images are reduced to this many pixels'),
    'camera_height': ('', 'height of the camera above the floor in metres'),
    'gravity': ('', 'direction of gravity in the frame of the camera, level: "0 1 0"'),
    'mounting': ('', 'upright: the camera is not on its side or upside down; any: unknown'),
    'use_imu': ('', 'true: gravity from the IMU'),
    'base_frame': ('', 'frame of the robot on the floor, for gravity and camera height from TF'),
    'target_frame': ('', 'frame of the outputs'),
    'plane_map': ('', 'true: keep a map of the planes in target_frame (odom or map)'),
    'map_file': ('', 'file of the map for ~/map/save and ~/map/load'),
    'points_color': ('', 'colours of ~/points: image, label or overlay'),
    'processing_mode': ('', 'continuous or on_demand'),
    'autostart': ('', 'false: a lifecycle manager configures and activates the node'),
    'respawn': ('false', 'true: start the node again when it ends; with exit_on_failure'),
    'use_sim_time': ('', 'true: take the time from /clock'),
    'rviz': ('false', 'true: start RViz with the frame of the camera, and colour the points'),
    'log_level': ('info', 'debug, info, warn, error or fatal'),
}
# Launch files in Python pass True and False, those in XML and YAML true and false.
IS_ON = {'': False, 'true': True, 'True': True, 'false': False, 'False': False}
SWITCHES = ('use_imu', 'plane_map', 'autostart', 'use_sim_time', 'respawn', 'rviz')
TOPICS = ('image', 'camera_info', 'depth', 'imu')
# Those whose parameter has another name.
PARAMETERS = {'depth_source': 'depth.source', 'depth_transport': 'depth.transport',
              'depth_colour': 'depth.colour', 'depth_model': 'depth.model',
              'network_threads': 'depth.threads', 'processing_mode': 'mode',
              'camera_height': 'scale.camera_height', 'gravity': 'scale.gravity',
              'mounting': 'directions.mounting', 'plane_map': 'map.enabled',
              'map_file': 'map.file'}
OVERRIDES = ('depth_source', 'depth_transport', 'depth_colour', 'depth_model', 'network_threads',
             'image_transport', 'max_side', 'camera_height', 'gravity', 'mounting', 'use_imu',
             'base_frame', 'target_frame', 'plane_map', 'map_file', 'points_color',
             'processing_mode', 'autostart', 'use_sim_time')
# What their text is turned into, where the parameter is no text.
READ = {**dict.fromkeys(SWITCHES, IS_ON.get), 'max_side': int, 'network_threads': int,
        'camera_height': float,
        'gravity': lambda text: [float(number) for number in re.findall(r'[-+.\de]+', text)]}
# The topics of drivers, not tried with the devices: of Orbbec as its documentation names them, of
# the others as users' launch files do; the pages named are where to check. Depth is registered.
# QoS needs no entry: the inputs take the reliability that the driver offers.
CAMERAS = {
    # github.com/IntelRealSense/realsense-ros, README: align_depth.enable:=true.
    'realsense': {'image': '/camera/camera/color/image_raw',
                  'depth': '/camera/camera/aligned_depth_to_color/image_raw',
                  'depth_source': 'topic'},
    # docs.luxonis.com/software/ros/depthai-ros/driver: camera.launch.py, aligned by default.
    'oak': {'image': '/oak/rgb/image_raw', 'depth': '/oak/stereo/image_raw',
            'depth_source': 'topic'},
    # www.stereolabs.com/docs/ros2/zed-node: wrapper 5; rectified, depth registered to it.
    'zed': {'image': '/zed/zed_node/rgb/color/rect/image',
            'depth': '/zed/zed_node/depth/depth_registered', 'depth_source': 'topic'},
    # orbbec.github.io/OrbbecSDK_ROS2, Available Topics: depth_registration:=true.
    'orbbec': {'image': '/camera/color/image_raw', 'depth': '/camera/depth/image_raw',
               'depth_source': 'topic'},
    # github.com/ros-drivers/usb_cam, README: ros2 run usb_cam usb_cam_node_exe.
    'usb_cam': {'image': '/image_raw'},
}
CHOICES = {**dict.fromkeys(SWITCHES, [*IS_ON]), 'camera': ['', *CAMERAS], **{
    name: ['', *settings.__dataclass_fields__[
        PARAMETERS.get(name, name).rpartition('.')[2]].metadata['choices']]
    for settings, name in ((DepthConfig, 'depth_source'), (DepthConfig, 'depth_transport'),
                           (DepthConfig, 'depth_colour'), (DirectionsConfig, 'mounting'),
                           (NodeConfig, 'image_transport'),
                           (NodeConfig, 'points_color'), (NodeConfig, 'processing_mode'))}}
# Fast DDS as it comes loses images between processes.
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
PROFILE_NAMES = (PROFILES, 'FASTDDS_DEFAULT_PROFILES_FILE')


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = [DeclareLaunchArgument(
        name, default_value=default, description=description,
        choices=CHOICES.get(name))
        for name, (default, description) in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_nodes)])


def start_nodes(context: LaunchContext) -> list[Node]:
    """Return the node, and RViz if requested, with the values of the arguments."""
    value = dict(context.launch_configurations)
    for name, of_camera in CAMERAS.get(value['camera'], {}).items():
        if value[name] == ARGUMENTS[name][0]:
            value[name] = of_camera
    if IS_ON[value['rviz']]:  # as in replayed bags, planes are seen in the cloud
        value['points_color'] = value['points_color'] or 'overlay'
    share = Path(get_package_share_directory(PACKAGE))
    file = Path(value['params_file'] or share / 'config' / f'{PACKAGE}.yaml').expanduser()
    if not file.is_file():
        raise FileNotFoundError(f'params_file: there is no file {file}')
    overrides = {PARAMETERS.get(name, name): read(name, value[name])
                 for name in OVERRIDES if value[name]}
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
        frame = ['--frame', value['target_frame']] if value['target_frame'] else []
        nodes.append(Node(
            package=PACKAGE, executable='rviz', namespace=value['namespace'], output='screen',
            arguments=['--node', value['node_name'], *frame], remappings=remappings,
            parameters=[{'use_sim_time': bool(IS_ON[value['use_sim_time']])}],
            additional_env=profile))
    return nodes


def read(name: str, text: str) -> object:
    """Return the value of an argument for its parameter."""
    try:
        return READ.get(name, str)(text)
    except ValueError as error:
        raise ValueError(f'{name}:={text}: must be a number, such as 1.2') from error
