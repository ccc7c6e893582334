# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as markers: outline, normal and caption; markers of lost planes are deleted."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from plane_detector.drawing import label_colours
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.outline import Polygon
from plane_detector.ros.outputs.captions import Caption, arrow_length_m
from plane_detector.ros.outputs.messages import (
    FIRST_SHAPE_LABEL,
    new_like,
    plane_labels,
    points_to_msgs,
    shape_labels,
)
from plane_detector.ros.outputs.shapes import NAMESPACE as SHAPE_NAMESPACE
from plane_detector.ros.outputs.shapes import shape_markers
from plane_detector.types import Detection, Plane

_NAMESPACES = ('outline', 'normal', 'caption')
# As a share of the distance from the camera, like the sizes of captions.
_LINE_WIDTH = 0.006
_NO_POINTS = np.zeros((0, 3))
_TEMPLATE, _NO_SCALE = Marker(), Vector3()
_HERE = Pose(orientation=Quaternion(w=1.0))  # of most markers; replaced, never changed


def markers_to_msg(header: Header, detection: Detection, polygons: Sequence[Sequence[Polygon]],
                   captions: Sequence[Caption], shown: Collection[int],
                   lifetime_s: float) -> MarkerArray:
    """
    Return the markers of all planes; a marker's id is the label of its plane.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of the image.
    detection : Detection
        The planes.
    polygons : sequence of sequences of Polygon
        Of each plane; the first one is drawn.
    captions : sequence of Caption
        Of each plane.
    shown : collection of int
        Labels of the markers published before; those that are not present again are deleted.
    lifetime_s : float
        Seconds after which a marker disappears; 0: never.

    """
    labels = plane_labels(detection).tolist()
    gone = set(shown) - {*labels, *shape_labels(detection).tolist()}
    markers = [_delete(header, name, label) for label in sorted(gone)
               for name in _namespaces_of(label)]
    lifetime = Duration(seconds=lifetime_s).to_msg()
    shares = (label_colours(labels) / 255.0).tolist() if labels else []
    for plane, label, share, outlines, caption in zip(detection.planes, labels, shares, polygons,
                                                      captions, strict=True):
        colour = ColorRGBA(**dict(zip('rgb', share, strict=True)), a=1.0)
        for marker in _plane_markers(header, plane, outlines, caption):
            marker.id, marker.color, marker.lifetime = label, colour, lifetime
            markers.append(marker)
    for marker in shape_markers(header, detection):
        marker.lifetime = lifetime
        markers.append(marker)
    return MarkerArray(markers=markers)


def moved(markers: MarkerArray, to_target: RigidTransform) -> MarkerArray:
    """
    Transform markers from the camera's frame into the target frame, in place, and return them.

    The points of a marker are relative to its pose, so only poses change.
    """
    for marker in markers.markers:
        at, turn = marker.pose.position, marker.pose.orientation
        here = RigidTransform.from_quaternion((turn.x, turn.y, turn.z, turn.w),
                                              (at.x, at.y, at.z))
        there = to_target.after(here)
        marker.pose = Pose(position=_point(there.translation_m), orientation=Quaternion(
            **dict(zip('xyzw', there.quaternion.tolist(), strict=True))))
    return markers


def _plane_markers(header: Header, plane: Plane, outlines: Sequence[Polygon],
                   caption: Caption) -> Iterable[Marker]:
    line_width_m = _LINE_WIDTH * float(np.linalg.norm(plane.centroid_m))
    corners_m = outlines[0].corners_m if outlines else _NO_POINTS
    outline = _marker(header, 'outline', Marker.LINE_STRIP, corners_m)
    outline.points += outline.points[:1]  # closed
    outline.scale.x = line_width_m
    if not outlines:  # the plane is too narrow for three corners
        outline.action = Marker.DELETE
    normal = _marker(header, 'normal', Marker.ARROW, np.stack([
        plane.centroid_m, plane.centroid_m + arrow_length_m(plane) * plane.normal]))
    normal.scale.x, normal.scale.y = line_width_m, 3 * line_width_m
    text = _marker(header, 'caption', Marker.TEXT_VIEW_FACING, _NO_POINTS)
    text.text, text.scale.z = caption.text, caption.height_m
    text.pose = Pose(position=_point(caption.position_m), orientation=_HERE.orientation)
    if not caption.is_shown:  # the message keeps the text, for viewers that list it
        text.action = Marker.DELETE
    return outline, normal, text


def _marker(header: Header, name: str, kind: int, points_m: np.ndarray) -> Marker:
    marker = new_like(_TEMPLATE)
    marker.header, marker.ns, marker.type, marker.action = header, name, kind, Marker.ADD
    marker.pose, marker.scale = _HERE, new_like(_NO_SCALE)
    marker.points = points_to_msgs(points_m)
    return marker


def _namespaces_of(label: int) -> tuple[str, ...]:
    return (SHAPE_NAMESPACE,) if label > FIRST_SHAPE_LABEL else _NAMESPACES


def _delete(header: Header, name: str, label: int) -> Marker:
    marker = _marker(header, name, Marker.ARROW, _NO_POINTS)
    marker.id, marker.action = label, Marker.DELETE
    return marker


def _point(point_m: np.ndarray) -> Point:
    return points_to_msgs(point_m[None])[0]
