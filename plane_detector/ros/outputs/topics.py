# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Table of outputs: name of the topic, type, and function that makes the message.

The node publishes them and replay writes them to a bag; this table defines their content.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from visualization_msgs.msg import MarkerArray

from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.clouds import (
    drops_to_msg,
    ground_to_msg,
    obstacles_to_msg,
    points_to_msg,
)
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.markers import markers_to_msg
from plane_detector.ros.outputs.plane_table import (
    boundaries_to_msg,
    planes_to_msg,
    shapes_to_msg,
)


class Output(NamedTuple):
    """
    Type of a topic's messages, and the function that makes one.

    It returns None if the message is not available now.
    """

    msg_type: Any
    make: Callable[[DetectedFrame], Any]


OUTPUTS: dict[str, Output] = {
    'points': Output(PointCloud2, points_to_msg),
    'points_without_floor': Output(PointCloud2, obstacles_to_msg),
    'ground': Output(PointCloud2, ground_to_msg),
    'drops': Output(PointCloud2, drops_to_msg),
    'planes': Output(PointCloud2, planes_to_msg),
    'boundaries': Output(PointCloud2, boundaries_to_msg),
    'plane_poses': Output(PoseArray, lambda frame: messages.poses_to_msg(
        frame.target_header, frame.target_detection.planes)),
    'markers': Output(MarkerArray, markers_to_msg),
    'labels': Output(Image, lambda frame: messages.labels_to_msg(frame.header, frame.labels)),
    'depth': Output(Image, lambda frame: messages.depth_to_msg(
        frame.header, frame.detection.depth_m)),
    'overlay': Output(Image, lambda frame: messages.rgb_to_msg(frame.header, frame.overlay)),
    'overlay/compressed': Output(CompressedImage, lambda frame: messages.jpeg_to_msg(
        frame.header, frame.overlay)),
    'camera_info': Output(CameraInfo, lambda frame: camera_info_to_msg(
        frame.header, frame.intrinsics, frame.distortion)),
    'shapes': Output(PointCloud2, shapes_to_msg),
}
