# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Table of outputs: name of the topic, type, and function that makes the message; publishers.

The node publishes them and replay writes them to a bag; this table defines their content.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from geometry_msgs.msg import PoseArray
from nav_msgs.msg import OccupancyGrid
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from plane_detector.ros import qos
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.clouds import (
    boundaries_to_msg,
    drops_to_msg,
    ground_to_msg,
    planes_to_msg,
    points_to_msg,
    points_without_floor_to_msg,
    shapes_to_msg,
)
from plane_detector.ros.outputs.detections import Detection3DArray, detections_to_msg
from plane_detector.ros.outputs.frame import DetectedFrame, MapView
from plane_detector.ros.outputs.grid import grid_to_msg
from plane_detector.ros.outputs.map_messages import (
    map_boundaries_to_msg,
    map_markers_to_msg,
    map_planes_to_msg,
)
from plane_detector.ros.outputs.markers import markers_to_msg
from plane_detector.ros.outputs.plane_json import planes_to_json


class Output(NamedTuple):
    """
    Type of a topic's messages, and the function that makes one from the source of the table.

    It returns None if the message is not available now. Outputs that are ``placed`` are in the
    target frame, and need its pose. A ``picture`` is for people, who need no more than
    ``picture_rate``.
    """

    msg_type: Any
    make: Callable[[Any], Any]
    is_placed: bool = True
    is_picture: bool = False


def frame_to_json(frame: DetectedFrame) -> str:
    """Return the planes of a frame as one line of JSON."""
    return planes_to_json(planes_to_msg(frame), frame.detection.scale.is_metric)


OUTPUTS: dict[str, Output] = {
    'points': Output(PointCloud2, points_to_msg),
    'points_without_floor': Output(PointCloud2, points_without_floor_to_msg),
    'ground': Output(PointCloud2, ground_to_msg),
    'drops': Output(PointCloud2, drops_to_msg),
    'grid': Output(OccupancyGrid, grid_to_msg, is_placed=False),
    'planes': Output(PointCloud2, planes_to_msg),
    'boundaries': Output(PointCloud2, boundaries_to_msg),
    'planes_json': Output(String, lambda frame: String(data=frame_to_json(frame))),
    'plane_poses': Output(PoseArray, lambda frame: messages.poses_to_msg(
        frame.target_header, frame.planes)),
    'markers': Output(MarkerArray, markers_to_msg, is_picture=True),
    'labels': Output(Image, lambda frame: messages.labels_to_msg(frame.header, frame.labels),
                     is_placed=False),
    'depth': Output(Image, lambda frame: messages.depth_to_msg(
        frame.header, frame.detection.depth_m), is_placed=False),
    'overlay': Output(Image, lambda frame: messages.rgb_to_msg(frame.header, frame.overlay),
                      is_placed=False, is_picture=True),
    'overlay/compressed': Output(CompressedImage, lambda frame: messages.jpeg_to_msg(
        frame.header, frame.overlay), is_placed=False, is_picture=True),
    'camera_info': Output(CameraInfo, lambda frame: camera_info_to_msg(
        frame.header, frame.intrinsics, frame.distortion), is_placed=False),
    'shapes': Output(PointCloud2, shapes_to_msg),
}
if Detection3DArray is not None:
    OUTPUTS['detections'] = Output(Detection3DArray, detections_to_msg)


# Of a MapView; with map.enabled.
MAP_OUTPUTS: dict[str, Output] = {
    'map/planes': Output(PointCloud2, map_planes_to_msg),
    'map/boundaries': Output(PointCloud2, map_boundaries_to_msg),
    'map/markers': Output(MarkerArray, map_markers_to_msg),
}


def make_map_messages(view: MapView | None) -> dict[str, Any]:
    """Return the messages of the map: latched, so they are made even if nobody listens."""
    return {} if view is None else {name: output.make(view)
                                    for name, output in MAP_OUTPUTS.items()}


class OutputPublishers:
    """
    The publishers of a table of outputs; all or none are created.

    ``latched`` messages are kept for later subscribers.
    """

    def __init__(self, node: LifecycleNode, outputs: Mapping[str, Output], latched: bool = False):
        self._node = node
        self._publishers: dict[str, Any] = {}
        try:
            for name, output in outputs.items():
                self._publishers[name] = node.create_lifecycle_publisher(
                    output.msg_type, f'~/{name}', qos.output_profile(latched),
                    event_callbacks=qos.SILENT_PUBLISHER,
                    qos_overriding_options=qos.overriding_options())
        except Exception:  # a wrong qos_overrides parameter
            self.destroy()
            raise

    @property
    def are_activated(self) -> bool:
        """Whether published messages are sent: the node is active."""
        return all(publisher.is_activated for publisher in self._publishers.values())

    def wanted(self) -> list[str]:
        """Return the names of the outputs that have subscribers."""
        return [name for name, publisher in self._publishers.items()
                if publisher.get_subscription_count()]

    def publish(self, messages: Mapping[str, Any]) -> None:
        """Publish messages by the names of their outputs."""
        for name, msg in messages.items():
            self._publishers[name].publish(msg)

    def misfits(self) -> dict[str, str]:
        """Return why subscribers receive nothing, by topic and node: incompatible QoS."""
        found: dict[str, str] = {}
        for publisher in self._publishers.values():
            topic = publisher.topic_name
            if self._node.count_subscribers(topic) <= publisher.get_subscription_count():
                continue
            for info in self._node.get_subscriptions_info_by_topic(topic):
                if reason := self._misfit(topic, info):
                    reader = f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                    found[f'{topic} {reader}'] = (
                        f'{reader} subscribes to {topic}, but receives nothing, because its QoS '
                        f'does not fit ({reason}): change it there, or here by the '
                        'qos_overrides parameters')
        return found

    def _misfit(self, topic: str, reader: TopicEndpointInfo) -> str:
        """Return why a subscriber cannot receive the messages of this node; empty if it can."""
        own = self._node.get_name(), self._node.get_namespace()
        # From the graph: the profile of the publisher itself has placeholders for its defaults.
        for info in self._node.get_publishers_info_by_topic(topic):
            if (info.node_name, info.node_namespace) == own:
                fits, reason = qos_check_compatible(info.qos_profile, reader.qos_profile)
                return _plain(reason) if fits == QoSCompatibility.ERROR else ''
        return ''

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)


def _plain(reason: str) -> str:
    """Return the reasons of rclpy, "ERROR: This and that;ERROR: ...", as part of a sentence."""
    return ', '.join(part.removeprefix('ERROR: ').lower() for part in reason.split(';')
                     if part.startswith('ERROR: '))
