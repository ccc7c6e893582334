# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as markers: outline, normal and caption; markers of lost planes are deleted."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import numpy as np
from visualization_msgs.msg import Marker

from plane_detector.drawing import label_colours
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.outline import Polygon
from plane_detector.ros.outputs.captions import Caption, arrow_length_m
from plane_detector.ros.outputs.cdr import NO_POINTS, MarkerValues
from plane_detector.ros.outputs.messages import FIRST_SHAPE_LABEL, plane_labels, shape_labels
from plane_detector.ros.outputs.shapes import NAMESPACE as SHAPE_NAMESPACE
from plane_detector.ros.outputs.shapes import shape_markers
from plane_detector.types import Detection, Plane

_NAMESPACES = ('outline', 'normal', 'caption')
# As a share of the distance from the camera, like the sizes of captions.
_LINE_WIDTH = 0.006


def scene_markers(detection: Detection, polygons: Sequence[Sequence[Polygon]],
                  captions: Sequence[Caption], shown: Collection[int]) -> list[MarkerValues]:
    """
    Return the markers of all planes and shapes; a marker's id is the label of what it shows.

    Parameters
    ----------
    detection : Detection
        The planes.
    polygons : sequence of sequences of Polygon
        Of each plane; the first one is drawn.
    captions : sequence of Caption
        Of each plane.
    shown : collection of int
        Labels of the markers published before; those that are not present again are deleted.

    """
    labels = plane_labels(detection).tolist()
    gone = set(shown) - {*labels, *shape_labels(detection).tolist()}
    markers = [MarkerValues(name, label, Marker.ARROW, Marker.DELETE) for label in sorted(gone)
               for name in _namespaces_of(label)]
    shares = (label_colours(labels) / 255.0).tolist() if labels else []
    for plane, label, share, outlines, caption in zip(detection.planes, labels, shares, polygons,
                                                      captions, strict=True):
        markers += _plane_markers(plane, label, (*share, 1.0), outlines, caption)
    return [*markers, *shape_markers(detection)]


def moved(markers: Iterable[MarkerValues], to_target: RigidTransform) -> list[MarkerValues]:
    """
    Return markers of the camera's frame in the target frame.

    The points of a marker are relative to its pose, so only poses change.
    """
    found = []
    for marker in markers:
        here = RigidTransform.from_quaternion(marker.orientation, marker.position_m)
        there = to_target.after(here)
        found.append(marker._replace(position_m=tuple(there.translation_m.tolist()),
                                     orientation=tuple(there.quaternion.tolist())))
    return found


def _plane_markers(plane: Plane, label: int, rgba: tuple[float, ...],
                   outlines: Sequence[Polygon], caption: Caption) -> tuple[MarkerValues, ...]:
    line_width_m = _LINE_WIDTH * float(np.linalg.norm(plane.centroid_m))
    # A plane that is too narrow for three corners has no outline.
    closed_m = (np.concatenate([outlines[0].corners_m, outlines[0].corners_m[:1]]) if outlines
                else NO_POINTS)
    arrow_m = np.stack([plane.centroid_m,
                        plane.centroid_m + arrow_length_m(plane) * plane.normal])
    outline = MarkerValues('outline', label, Marker.LINE_STRIP, _added(bool(outlines)), rgba,
                           (line_width_m, 0.0, 0.0), closed_m)
    normal = MarkerValues('normal', label, Marker.ARROW, Marker.ADD, rgba,
                          (line_width_m, 3 * line_width_m, 0.0), arrow_m)
    # The message keeps a text that is not shown, for viewers that list it.
    text = MarkerValues('caption', label, Marker.TEXT_VIEW_FACING, _added(caption.is_shown), rgba,
                        (0.0, 0.0, caption.height_m), text=caption.text,
                        position_m=tuple(caption.position_m.tolist()))
    return outline, normal, text


def _added(is_shown: bool) -> int:
    return Marker.ADD if is_shown else Marker.DELETE


def _namespaces_of(label: int) -> tuple[str, ...]:
    return (SHAPE_NAMESPACE,) if label > FIRST_SHAPE_LABEL else _NAMESPACES
