# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes as vision_msgs/Detection3DArray, where that package is installed."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Vector3

from plane_detector.geometry.rigid_transform import quaternions
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import pose_msgs

try:
    from vision_msgs.msg import (
        BoundingBox3D,
        Detection3D,
        Detection3DArray,
        ObjectHypothesis,
        ObjectHypothesisWithPose,
    )
except ImportError:
    Detection3DArray: Any = None


def detections_to_msg(frame: DetectedFrame) -> Any:
    """
    Return one detection per plane: its class, its rectangle as a flat box, its label as id.

    The z axis of the box is the normal. The score is the confidence of the plane.
    """
    header, planes, rectangles = frame.target_header, frame.planes, frame.rectangles
    turns, found = quaternions(rectangles.rotations), []
    for plane, rectangle, place, middle in zip(
            planes, rectangles, pose_msgs(planes.centroids_m, turns),
            pose_msgs(rectangles.centres_m, turns), strict=True):
        hypothesis = ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(
            class_id=plane.plane_class.readable, score=plane.confidence))
        hypothesis.pose.pose = place
        found.append(Detection3D(
            header=header, id=str(plane.label), results=[hypothesis],
            bbox=BoundingBox3D(center=middle, size=Vector3(
                x=rectangle.width_m, y=rectangle.height_m, z=0.0))))
    return Detection3DArray(header=header, detections=found)
