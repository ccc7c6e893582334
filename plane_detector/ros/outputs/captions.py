# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Captions of planes: text, size, position, and whether they are shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector.geometry.label_places import LabelPlace
from plane_detector.planes.classification import PlaneClass
from plane_detector.scale.estimate import RELATIVE
from plane_detector.types import CameraIntrinsics, Detection, Plane

# Sizes as a share of the distance from the camera: they look equal near and far, and need no unit
# if the scale is not known.
_HEIGHT, _ARROW_LENGTH = 0.03, 0.15
# derived: limits, as a share of the plane's own size, that keep neighbouring captions apart.
_LARGEST_HEIGHT, _LARGEST_ARROW = 0.2, 0.5
# derived: a plane with a smaller share of the pixels has no room for a caption.
_MIN_SHARE = 0.01
# derived: the width of a monospaced character is .6 of its height, and viewers draw a box around
# the text.
_ADVANCE, _BOX = 0.6, 1.5
# derived: a text is in front of the part of the plane that it covers, but not closer than three
# quarters of the distance, so that it stays near its plane from other viewpoints.
_BEFORE_PLANE, _NEAREST = 0.98, 0.75


@dataclass(frozen=True)
class Caption:
    """
    The text of a plane.

    Attributes
    ----------
    text : str
    position_m : (3,) float64
        Its centre, in the frame of the camera.
    height_m : float
        Of its characters.
    is_shown : bool
        False if the plane is too small, or if the text would cover that of a larger plane.

    """

    text: str
    position_m: np.ndarray
    height_m: float
    is_shown: bool


def arrow_length_m(plane: Plane) -> float:
    """Return the length of the arrow along the normal."""
    return min(_ARROW_LENGTH * _distance_m(plane), _LARGEST_ARROW * math.sqrt(plane.area_m2))


def plane_captions(detection: Detection, labels: Sequence[int], intrinsics: CameraIntrinsics,
                   places: Mapping[int, LabelPlace]) -> tuple[Caption, ...]:
    """
    Return the captions of all planes.

    A caption is placed where its plane is widest in the image, in front of the plane, and faces
    the viewer. If two captions overlap as seen by the camera, the one of the larger plane is kept.

    Parameters
    ----------
    detection : Detection
        The planes, in the frame of the camera.
    labels : sequence of int
        Of the planes, as in the text.
    intrinsics : CameraIntrinsics
        Of the image.
    places : mapping of int to LabelPlace
        By label; the default is the centroid.

    """
    captions: list[Caption] = []
    boxes: list[_Box] = []
    min_pixels = _MIN_SHARE * detection.labels.size
    order = sorted(range(len(detection.planes)), key=lambda k: -detection.planes[k].inlier_count)
    for index in order:
        plane, text = detection.planes[index], f'{labels[index]}: {_description(detection, index)}'
        height = _height_m(plane) / _distance_m(plane)
        x, y = _middle(plane, places.get(labels[index]), intrinsics)
        half_width, half_height = _BOX * height / 2 * _ADVANCE * len(text), _BOX * height / 2
        box = x - half_width, y - half_height, x + half_width, y + half_height
        is_shown = plane.inlier_count >= min_pixels and not any(
            _overlap(box, other) for other in boxes)
        if is_shown:
            boxes.append(box)
        z_m = _before_m(plane, box)
        captions.append(Caption(text, z_m * np.array([x, y, 1.0]), z_m * height, is_shown))
    return tuple(captions[order.index(index)] for index in range(len(order)))


# Left, top, right, bottom as x / z and y / z.
_Box = tuple[float, float, float, float]


def _distance_m(plane: Plane) -> float:
    return math.hypot(*plane.centroid_m)


def _height_m(plane: Plane) -> float:
    return min(_HEIGHT * _distance_m(plane), _LARGEST_HEIGHT * math.sqrt(plane.area_m2))


def _middle(plane: Plane, place: LabelPlace | None,
            intrinsics: CameraIntrinsics) -> tuple[float, float]:
    """Return x / z and y / z of the position of a text."""
    if place is None:
        x_m, y_m, z_m = plane.centroid_m.tolist()
        return x_m / z_m, y_m / z_m
    return ((place.column - intrinsics.cx) / intrinsics.fx,
            (place.row - intrinsics.cy) / intrinsics.fy)


def _before_m(plane: Plane, box: _Box) -> float:
    """Return the z at which a text with this box is in front of the plane."""
    left, top, right, bottom = box
    a, b, c = plane.normal.tolist()
    nearness = [-(a * x + b * y + c) for x in (left, right) for y in (top, bottom)]
    at_middle, at_nearest = sum(nearness) / 4, max(nearness)  # 1 / z times the offset
    if at_middle <= 0:  # the centre is beyond the plane's horizon
        return float(plane.centroid_m[2])
    middle_m = plane.offset_m / at_middle
    return max(_BEFORE_PLANE * plane.offset_m / at_nearest, _NEAREST * middle_m)


def _overlap(first: _Box, second: _Box) -> bool:
    return (first[0] < second[2] and second[0] < first[2]
            and first[1] < second[3] and second[1] < first[3])


def _description(detection: Detection, index: int) -> str:
    """Return class, if known, and distance, with its unit if known."""
    kind = PlaneClass(detection.classes[index]) if detection.classes else PlaneClass.UNKNOWN
    name = '' if kind == PlaneClass.UNKNOWN else kind.name.lower().replace('_', ' ') + ' '
    unit = '' if detection.scale_method == RELATIVE else ' m'
    return f'{name}{detection.planes[index].offset_m:.2f}{unit}'
