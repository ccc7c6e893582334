# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes as vision_msgs/Detection3DArray, where that package is installed."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Vector3

from plane_detector.geometry.rigid_transform import quaternions
from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import pose_msg

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
    header = frame.target_header
    found = []
    for plane, rectangle in zip(frame.planes, frame.rectangles, strict=True):
        turn, = quaternions(rectangle.rotation[None])
        hypothesis = ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(
            class_id=PlaneClass(plane.plane_class).readable, score=float(plane.confidence)))
        hypothesis.pose.pose = pose_msg(plane.centroid_m, turn)
        found.append(Detection3D(
            header=header, id=str(plane.label), results=[hypothesis],
            bbox=BoundingBox3D(center=pose_msg(rectangle.centre_m, turn), size=Vector3(
                x=float(rectangle.width_m), y=float(rectangle.height_m), z=0.0))))
    return Detection3DArray(header=header, detections=found)
