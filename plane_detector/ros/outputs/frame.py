# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the outputs of one image are made from; what several of them need is computed once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from std_msgs.msg import Header

from plane_detector.config import NodeConfig
from plane_detector.drawing import LabelPlace, label_places, overlay
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.outline import (
    Polygon,
    Rectangle,
    all_polygons,
    enclosing_rectangle,
    hulls,
    row_ends,
)
from plane_detector.ros.calibration import NO_DISTORTION, Distortion
from plane_detector.ros.outputs import messages
from plane_detector.stage_timer import StageTimer
from plane_detector.types import CameraIntrinsics, Detection


@dataclass(frozen=True)
class DetectedFrame:
    """An image and what was found in it."""

    header: Header  # of the image message
    rgb: np.ndarray  # (H, W, 3) uint8, rectified
    intrinsics: CameraIntrinsics  # of this image
    detection: Detection  # in the frame of the image
    settings: NodeConfig  # for this frame
    to_target: RigidTransform | None = None  # from the image's frame to the target; None: the same
    distortion: Distortion = NO_DISTORTION  # that the image still has
    timer: StageTimer = field(default_factory=StageTimer)  # of the stages on this frame

    @cached_property
    def target_header(self) -> Header:
        """Header of the outputs in the target frame, with the stamp of the image."""
        if self.to_target is None:
            return self.header
        return Header(stamp=self.header.stamp, frame_id=self.settings.target_frame)

    def in_target(self, points_m: np.ndarray) -> np.ndarray:
        """Return points (..., 3) of the frame of the image in the target frame."""
        return points_m if self.to_target is None else self.to_target.points(points_m)

    @cached_property
    def target_detection(self) -> Detection:
        """The detection with planes and shapes in the target frame; depth is not changed."""
        turn, found = self.to_target, self.detection
        if turn is None:
            return found
        shapes = tuple(replace(shape, position_m=turn.points(shape.position_m),
                               axis=turn.rotation @ shape.axis) for shape in found.shapes)
        return replace(found, planes=found.planes.moved(turn), shapes=shapes)

    @cached_property
    def _row_ends(self) -> np.ndarray:
        return row_ends(self.detection.labels, len(self.detection.planes))

    @cached_property
    def camera_polygons(self) -> tuple[tuple[Polygon, ...], ...]:
        """Outlines of each plane in the frame of the image."""
        found = self.detection
        return all_polygons(found.labels, self._row_ends, self.intrinsics, found.planes)

    @cached_property
    def polygons(self) -> tuple[tuple[Polygon, ...], ...]:
        """Outlines of each plane in the target frame."""
        return tuple(tuple(replace(polygon, corners_m=self.in_target(polygon.corners_m))
                           for polygon in of_plane) for of_plane in self.camera_polygons)

    @cached_property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """Smallest rectangle around the pixels of each plane in the target frame."""
        around = hulls(self._row_ends, self.intrinsics, self.detection.planes)
        return tuple(enclosing_rectangle(
            self.in_target(np.vstack([corners_m, plane.centroid_m])),
            turned.normal, turned.centroid_m)
            for plane, turned, corners_m in zip(
                self.detection.planes, self.target_detection.planes, around, strict=True))

    @cached_property
    def labels(self) -> np.ndarray:
        """Label of each pixel in the messages, (H, W) int32, 0 for none."""
        return messages.pixel_labels(self.detection)

    @cached_property
    def label_places(self) -> dict[int, LabelPlace]:
        """The widest place of each label's region, for numbers and captions."""
        return label_places(self.labels)

    @cached_property
    def overlay(self) -> np.ndarray:
        """Image with its planes, (H, W, 3) uint8."""
        return overlay(self.rgb, self.labels, places=self.label_places)
