# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The data from which the outputs of one image are made; shared data is computed only once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from std_msgs.msg import Header

from plane_detector.config import Config, NodeConfig
from plane_detector.drawing import LabelPlace, colours_by_label, label_places, overlay
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.plane_map import MapSnapshot
from plane_detector.planes.outline import PlacedDetection
from plane_detector.planes.plane_table import PLANE_DTYPE
from plane_detector.ros.calibration import NO_DISTORTION, Distortion
from plane_detector.ros.outputs import messages
from plane_detector.segmentation.cells.model import rename_labels
from plane_detector.stage_timer import StageTimer


@dataclass(frozen=True)
class MapView:
    """The map after an image."""

    header: Header  # stamp of the image, target frame
    snapshot: MapSnapshot
    # Labels that have disappeared since the last view, and the planes that they are part of now.
    subsumed: Mapping[int, int] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class DetectedFrame(PlacedDetection):
    """What was found in an image, with everything else that the messages need."""

    header: Header  # of the image message
    rgb: np.ndarray  # (H, W, 3) uint8, rectified
    settings: NodeConfig  # for this frame
    config: Config = field(default_factory=Config)  # of its detection
    to_base: RigidTransform | None = None  # into ``base_frame``; None if none is named
    pose_problem: str = ''  # why the pose in ``target_frame`` is unknown; empty if it is known
    distortion: Distortion = NO_DISTORTION  # that the image still has
    timer: StageTimer = field(default_factory=StageTimer)  # of the stages on this frame

    @cached_property
    def target_header(self) -> Header:
        """Header of the outputs in the target frame, with the stamp of the image."""
        if self.pose is None:
            return self.header
        return Header(stamp=self.header.stamp, frame_id=self.settings.target_frame)

    @cached_property
    def labels(self) -> np.ndarray:
        """Label of each pixel in the messages, (H, W) int32, 0 for none."""
        found = self.detection
        labels = rename_labels(found.labels, found.planes.labels, 0)
        if found.shapes:
            is_shape = found.shape_labels >= 0
            labels[is_shape] = messages.shape_labels(found)[found.shape_labels[is_shape]]
        return labels

    @cached_property
    def plane_table(self) -> np.ndarray:
        """The rows of ``~/planes``, (K,), which the JSON has too."""
        table = np.zeros(len(self.planes), PLANE_DTYPE)
        self.planes.write_to(table)
        self.rectangles.write_to(table)
        return table

    @cached_property
    def label_places(self) -> dict[int, LabelPlace]:
        """The widest place of the region of each label, for numbers and captions."""
        return label_places(self.labels)

    @cached_property
    def colours(self) -> np.ndarray:
        """Colour of each label, (N, 3) uint8; that of a plane shows its class."""
        planes, shapes = self.detection.planes, messages.shape_labels(self.detection)
        last = max(planes.labels.max(initial=0), shapes.max(initial=0))
        return colours_by_label(planes.labels, planes.classes, int(last))

    @cached_property
    def overlay(self) -> np.ndarray:
        """Image with its planes, (H, W, 3) uint8."""
        return overlay(self.rgb, self.labels, self.colours, self.label_places)
