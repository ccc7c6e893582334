# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as markers: outline, normal and caption of each; those of planes gone are deleted."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from geometry_msgs.msg import Point, Quaternion
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from plane_detector.drawing import label_colours
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.classification import PlaneClass
from plane_detector.planes.outline import plane_outline
from plane_detector.ros.outputs.messages import FIRST_SHAPE_LABEL, plane_labels, shape_labels
from plane_detector.ros.outputs.shapes import NAMESPACE as SHAPE_NAMESPACE
from plane_detector.ros.outputs.shapes import shape_markers
from plane_detector.scale.estimate import RELATIVE
from plane_detector.types import CameraIntrinsics, Detection, Plane

_NAMESPACES = ('outline', 'normal', 'caption')
# Sizes as a share of the distance from the camera: they look alike near and far, and need no
# unit where the scale is not known.
_LINE_WIDTH, _ARROW_LENGTH, _TEXT_HEIGHT, _TEXT_LIFT = 0.006, 0.15, 0.03, 0.02
# derived: and no larger than this share of the plane's own side, so that neighbours stay apart.
_LARGEST_ARROW, _LARGEST_TEXT = 0.5, 0.2
# derived: a plane of a smaller share of the pixels has no room for a caption.
_CAPTION_MIN_SHARE = 0.01


def markers_to_msg(header: Header, detection: Detection, intrinsics: CameraIntrinsics,
                   shown: Collection[int], lifetime_s: float) -> MarkerArray:
    """
    Return the markers of all planes; a marker's id is the label of its plane.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of the image.
    detection : Detection
        The planes.
    intrinsics : CameraIntrinsics
        Of the image.
    shown : collection of int
        Labels of the markers published before; those that are not here again are deleted.
    lifetime_s : float
        Seconds after which a marker vanishes by itself, 0 for never.

    """
    labels = plane_labels(detection)
    gone = set(shown) - {*labels.tolist(), *shape_labels(detection).tolist()}
    markers = [_delete(header, name, label) for label in sorted(gone)
               for name in _namespaces_of(label)]
    lifetime = Duration(seconds=lifetime_s).to_msg()
    shares = (label_colours(labels) / 255.0).tolist()
    for index, (plane, label, share) in enumerate(zip(detection.planes, labels, shares,
                                                      strict=True)):
        corners_m = plane_outline(detection.labels == index, detection.depth_m, intrinsics, plane)
        caption = f'{label}: {_description(detection, index)}'
        colour = ColorRGBA(**dict(zip('rgb', share, strict=True)), a=1.0)
        outline, normal, text = _plane_markers(header, plane, corners_m, caption)
        if plane.inlier_count < _CAPTION_MIN_SHARE * detection.labels.size:
            text = _delete(header, 'caption', label)
        for marker in (outline, normal, text):
            marker.id, marker.color, marker.lifetime = int(label), colour, lifetime
            markers.append(marker)
    for marker in shape_markers(header, detection):
        marker.lifetime = lifetime
        markers.append(marker)
    return MarkerArray(markers=markers)


def moved(markers: MarkerArray, to_target: RigidTransform) -> MarkerArray:
    """
    Put markers of the camera's frame into the target frame; they are changed and returned.

    The points of a marker are relative to its pose, so that only poses change.
    """
    for marker in markers.markers:
        at, turn = marker.pose.position, marker.pose.orientation
        here = RigidTransform.from_quaternion((turn.x, turn.y, turn.z, turn.w),
                                              (at.x, at.y, at.z))
        there = to_target.after(here)
        marker.pose.position = _point(there.translation_m)
        marker.pose.orientation = Quaternion(
            **dict(zip('xyzw', there.quaternion.tolist(), strict=True)))
    return markers


def _plane_markers(header: Header, plane: Plane, corners_m: np.ndarray,
                   caption: str) -> Iterable[Marker]:
    distance, side = float(np.linalg.norm(plane.centroid_m)), float(np.sqrt(plane.area_m2))
    length = min(_ARROW_LENGTH * distance, _LARGEST_ARROW * side)
    outline = _marker(header, 'outline', Marker.LINE_STRIP, [*corners_m, corners_m[0]])
    outline.scale.x = _LINE_WIDTH * distance
    normal = _marker(header, 'normal', Marker.ARROW,
                     [plane.centroid_m, plane.centroid_m + length * plane.normal])
    normal.scale.x, normal.scale.y = _LINE_WIDTH * distance, 3 * _LINE_WIDTH * distance
    text = _marker(header, 'caption', Marker.TEXT_VIEW_FACING, [])
    text.text, text.scale.z = caption, min(_TEXT_HEIGHT * distance, _LARGEST_TEXT * side)
    text.pose.position = _point(plane.centroid_m + _TEXT_LIFT * distance * plane.normal)
    return outline, normal, text


def _description(detection: Detection, index: int) -> str:
    """Class, where it is known, and distance; without a unit where that is not known."""
    kind = PlaneClass(detection.classes[index]) if detection.classes else PlaneClass.UNKNOWN
    name = '' if kind == PlaneClass.UNKNOWN else kind.name.lower().replace('_', ' ') + ' '
    unit = '' if detection.scale_method == RELATIVE else ' m'
    return f'{name}{detection.planes[index].offset_m:.2f}{unit}'


def _marker(header: Header, name: str, kind: int, points_m: Iterable[np.ndarray]) -> Marker:
    marker = Marker(header=header, ns=name, type=kind, action=Marker.ADD,
                    points=[_point(point_m) for point_m in points_m])
    marker.pose.orientation.w = 1.0
    return marker


def _namespaces_of(label: int) -> tuple[str, ...]:
    return (SHAPE_NAMESPACE,) if label > FIRST_SHAPE_LABEL else _NAMESPACES


def _delete(header: Header, name: str, label: int) -> Marker:
    marker = Marker(header=header, ns=name, id=int(label), action=Marker.DELETE)
    marker.pose.orientation.w = 1.0
    return marker


def _point(point_m: np.ndarray) -> Point:
    x, y, z = point_m.tolist()
    return Point(x=x, y=y, z=z)
