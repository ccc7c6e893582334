# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Table of outputs: name of the topic, type, and function that makes the message.

The node publishes them and replay writes them to a bag; this table defines their content.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from plane_detector.config import NodeConfig
from plane_detector.drawing import label_image, overlay
from plane_detector.geometry.label_places import LabelPlace, label_places
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.classification import PlaneClass
from plane_detector.planes.outline import (
    Polygon,
    Rectangle,
    all_polygons,
    enclosing_rectangle,
)
from plane_detector.ros.calibration import NO_DISTORTION, Distortion, camera_info_to_msg
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.captions import plane_captions
from plane_detector.ros.outputs.cdr import serialised_markers
from plane_detector.ros.outputs.clouds import PixelPoints, obstacles_to_msg, points_to_msg
from plane_detector.ros.outputs.markers import moved, scene_markers
from plane_detector.ros.outputs.plane_table import boundaries_to_msg, planes_to_msg
from plane_detector.ros.outputs.shapes import shapes_to_msg
from plane_detector.scale.estimate import RELATIVE
from plane_detector.types import CameraIntrinsics, Detection


@dataclass(frozen=True)
class ProcessedFrame:
    """
    A processed image.

    Attributes
    ----------
    header : std_msgs.msg.Header
        Of the image message.
    rgb : (H, W, 3) uint8
        The rectified image.
    intrinsics : CameraIntrinsics
        Of this image.
    detection : Detection
        Result of the pipeline.
    settings : NodeConfig
        For this frame.
    shown : frozenset of int
        Labels of the markers published last.
    to_target : RigidTransform or None
        From the frame of the image into the target frame; None: they are equal.
    distortion : Distortion
        That the image still has.
    merged : tuple of int
        Label that was merged into each plane, 0 for none; empty: none for all.

    """

    header: Header
    rgb: np.ndarray
    intrinsics: CameraIntrinsics
    detection: Detection
    settings: NodeConfig
    shown: frozenset[int] = frozenset()
    to_target: RigidTransform | None = None
    distortion: Distortion = NO_DISTORTION
    merged: tuple[int, ...] = ()

    @cached_property
    def target_header(self) -> Header:
        """Header of the outputs in the target frame, with the stamp of the image."""
        if self.to_target is None:
            return self.header
        return Header(stamp=self.header.stamp, frame_id=self.settings.target_frame)

    @cached_property
    def target_detection(self) -> Detection:
        """The detection with planes and shapes in the target frame; depth is not changed."""
        turn, found = self.to_target, self.detection
        if turn is None:
            return found
        shapes = tuple(replace(shape, position_m=turn.points(shape.position_m),
                               axis=turn.rotation @ shape.axis) for shape in found.shapes)
        return replace(found, planes=tuple(map(turn.plane, found.planes)), shapes=shapes)

    @cached_property
    def camera_polygons(self) -> tuple[tuple[Polygon, ...], ...]:
        """Outlines of each plane in the frame of the camera."""
        found = self.detection
        return all_polygons(found.labels, found.depth_m, self.intrinsics, found.planes)

    @cached_property
    def polygons(self) -> tuple[tuple[Polygon, ...], ...]:
        """Outlines of each plane in the target frame."""
        if self.to_target is None:
            return self.camera_polygons
        return tuple(tuple(replace(polygon, corners_m=self.to_target.points(polygon.corners_m))
                           for polygon in of_plane) for of_plane in self.camera_polygons)

    @cached_property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """Smallest rectangle around each plane in the target frame."""
        return tuple(enclosing_rectangle(
            np.concatenate([plane.centroid_m[None], *(polygon.corners_m for polygon in polygons)]),
            plane.normal, plane.centroid_m)
            for plane, polygons in zip(self.target_detection.planes, self.polygons, strict=True))

    @cached_property
    def labels(self) -> np.ndarray:
        """Label of each pixel in the messages, (H, W) int32, 0 for none."""
        return messages.pixel_labels(self.detection)

    @property
    def points(self) -> PixelPoints:
        """Points of the clouds, in the target frame."""
        found = self.detection
        return PixelPoints(found.depth_m, found.labels, self.intrinsics, self.to_target,
                           self.settings.points_decimation)

    @cached_property
    def label_places(self) -> dict[int, LabelPlace]:
        """The widest place of each label's region, for numbers and captions."""
        return label_places(self.labels)

    @cached_property
    def overlay(self) -> np.ndarray:
        """Image with its planes, (H, W, 3) uint8."""
        return overlay(self.rgb, self.labels, places=self.label_places)


class Output(NamedTuple):
    """
    Type of a topic's messages, and the function that makes one.

    It returns the message, or its serialised form, or None if it is not available now.
    """

    msg_type: Any
    make: Callable[[ProcessedFrame], Any]


def _points(result: ProcessedFrame) -> PointCloud2:
    rgb = result.rgb
    if result.settings.points_color == 'label':
        rgb = label_image(result.labels)
    return points_to_msg(result.target_header, result.points, rgb,
                         messages.label_names(result.detection))


def _points_without_floor(result: ProcessedFrame) -> PointCloud2 | None:
    """Return the obstacles, or None while the floor or the unit is not known."""
    detection = result.detection
    if not any(detection.classes) or detection.scale_method == RELATIVE:
        return None
    # Shapes are not the floor; the last entry is for no plane.
    is_floor = np.array([kind == PlaneClass.FLOOR for kind in detection.classes]
                        + [False] * (len(detection.shapes) + 1))
    return obstacles_to_msg(result.target_header, result.points, is_floor)


def _planes(result: ProcessedFrame) -> PointCloud2:
    return planes_to_msg(result.target_header, result.target_detection.planes,
                         messages.plane_labels(result.detection), result.detection.classes,
                         result.rectangles, result.merged)


def _boundaries(result: ProcessedFrame) -> PointCloud2:
    return boundaries_to_msg(result.target_header, messages.plane_labels(result.detection),
                             result.polygons)


def _poses(result: ProcessedFrame) -> bytes:
    return messages.plane_poses(result.target_header, result.target_detection.planes)


def _markers(result: ProcessedFrame) -> bytes:
    found = result.detection
    captions = plane_captions(found, messages.plane_labels(found).tolist(), result.intrinsics,
                              result.label_places)
    markers = scene_markers(found, result.camera_polygons, captions, result.shown)
    if result.to_target is not None:
        markers = moved(markers, result.to_target)
    return serialised_markers(result.target_header, markers, result.settings.marker_lifetime)


def _labels(result: ProcessedFrame) -> Image:
    return messages.labels_to_msg(result.header, result.labels)


def _depth(result: ProcessedFrame) -> Image:
    return messages.depth_to_msg(result.header, result.detection.depth_m)


def _overlay(result: ProcessedFrame) -> Image:
    return messages.rgb_to_msg(result.header, result.overlay)


def _compressed_overlay(result: ProcessedFrame) -> CompressedImage:
    return messages.jpeg_to_msg(result.header, result.overlay)


def _shapes(result: ProcessedFrame) -> PointCloud2:
    return shapes_to_msg(result.target_header, result.target_detection)


def _camera_info(result: ProcessedFrame) -> CameraInfo:
    return camera_info_to_msg(result.header, result.intrinsics, result.distortion)


OUTPUTS: dict[str, Output] = {
    'points': Output(PointCloud2, _points),
    'points_without_floor': Output(PointCloud2, _points_without_floor),
    'planes': Output(PointCloud2, _planes),
    'boundaries': Output(PointCloud2, _boundaries),
    'plane_poses': Output(PoseArray, _poses),
    'markers': Output(MarkerArray, _markers),
    'labels': Output(Image, _labels),
    'depth': Output(Image, _depth),
    'overlay': Output(Image, _overlay),
    'overlay/compressed': Output(CompressedImage, _compressed_overlay),
    'camera_info': Output(CameraInfo, _camera_info),
    'shapes': Output(PointCloud2, _shapes),
}
