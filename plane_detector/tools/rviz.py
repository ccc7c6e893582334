# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Start RViz with the frame of the camera as fixed frame.

    ros2 run plane_detector rviz --ros-args -r image:=/camera/color/image_raw
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

from plane_detector import PAGES
from plane_detector._runtime.dependencies import explained_imports
from plane_detector._runtime.ending import INTERRUPTED, quiet_interrupt

with quiet_interrupt(), explained_imports():
    import rclpy
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from rclpy.wait_for_message import wait_for_message
    from sensor_msgs.msg import CameraInfo

    from plane_detector.config import DepthConfig
    from plane_detector.ros.inputs.subscriptions import input_topics

_FILE = 'plane_detector.rviz'
_NODE, _FRAME = 'plane_detector/', 'Fixed Frame: camera_optical_frame'
# The view in the file is for an optical frame, whose y axis points down; in odom, map and
# base_link, z points up (REP-103, REP-105).
_VIEW = re.compile(r'(Focal Point:\s+X: )\S+(\s+Y: )\S+(\s+Z: )\S+'
                   r'(.*?Pitch: )\S+(\s+Yaw: )\S+', re.DOTALL)
_VIEW_OF_Z_UP = r'\g<1>1\g<2>0\g<3>0\g<4>0.7\g<5>3.14'


def wait_for_frame(node: Node, timeout_s: float) -> str:
    """Return the frame of the camera; TimeoutError if no CameraInfo arrives within this time."""
    topic = input_topics(node, 'raw', DepthConfig())['camera_info']
    is_there, msg = wait_for_message(
        CameraInfo, node, topic, qos_profile=qos_profile_sensor_data, time_to_wait=timeout_s)
    if is_there:
        return msg.header.frame_id
    if not node.context.ok():  # by a signal
        raise KeyboardInterrupt
    raise TimeoutError(f'nothing on {topic} within {timeout_s:g} s: remap image, or state the '
                       'frame by --frame')


def find_config() -> Path:
    """Return the path of the configuration: in the sources, or where colcon installs it."""
    beside = Path(__file__).resolve().parents[2] / 'config' / _FILE
    if beside.is_file():
        return beside
    from ament_index_python.packages import get_package_share_directory
    return Path(get_package_share_directory('plane_detector')) / 'config' / _FILE


def main(args: list[str] | None = None) -> int:
    """Wait for the camera and start RViz in this process; return an exit code without RViz."""
    parser = argparse.ArgumentParser(prog='ros2 run plane_detector rviz',
                                     description=__doc__.strip().splitlines()[0],
                                     epilog=f'More: {PAGES}/recipes.md')
    parser.add_argument('--frame', default='', help='fixed frame (default: the frame of the '
                                                    'camera)')
    parser.add_argument('--node', default='plane_detector', help='name of the detector')
    parser.add_argument('--timeout', type=float, default=60.0, metavar='S',
                        help='time to wait for a camera, s (default: %(default)s)')
    options, of_ros = parser.parse_known_args(args)
    program = shutil.which('rviz2')
    if program is None:
        print('rviz2 is not installed: apt install ros-jazzy-rviz2', file=sys.stderr)
        return 1
    frame = options.frame
    if not frame:
        rclpy.init(args=of_ros)
        node = Node('plane_detector_rviz')
        try:
            frame = wait_for_frame(node, options.timeout)
        except TimeoutError as error:
            print(error, file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            return INTERRUPTED
        finally:
            node.destroy_node()
            rclpy.try_shutdown()
    folder = Path(tempfile.mkdtemp(prefix='plane_detector_'))
    file = folder / _FILE
    config = find_config().read_text('utf-8').replace(_FRAME, f'Fixed Frame: {frame}')
    if options.frame and 'optical' not in options.frame:
        config = _VIEW.sub(_VIEW_OF_Z_UP, config)
    file.write_text(config.replace(f'Value: {_NODE}', f'Value: {options.node}/'), 'utf-8')
    return os.execv(program, [program, '-d', str(file), *of_ros])


if __name__ == '__main__':
    sys.exit(main())
