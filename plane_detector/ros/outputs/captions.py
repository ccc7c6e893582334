# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Captions of planes: text, size and position of those that are shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from plane_detector.geometry.label_places import LabelPlace
from plane_detector.planes.classification import PlaneClass
from plane_detector.scale.estimate import RELATIVE
from plane_detector.types import CameraIntrinsics, Detection, Plane

# The viewer's eye in config/foxglove_layout.json, above and behind the camera, and its axes right,
# down and forward. RViz looks from about there too.
_EYE = np.array([0.0, -0.503, -0.684])
_PHI = math.radians(174)
_VIEW_AXES = np.array([[1.0, 0.0, 0.0], [0.0, -math.cos(_PHI), -math.sin(_PHI)],
                       [0.0, math.sin(_PHI), -math.cos(_PHI)]])
# As a share of the distance from the eye: texts look equal near and far, and need no unit.
_HEIGHT = 0.025
# As a share of the distance from the camera.
_ARROW_LENGTH = 0.15
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
_SHORT_NAMES = {PlaneClass.UNKNOWN: '', PlaneClass.OTHER: '',
                PlaneClass.OTHER_HORIZONTAL: 'horizontal'}


class Caption(NamedTuple):
    """The text of a plane, its centre in the frame of the camera, and its height."""

    text: str
    position_m: np.ndarray
    height_m: float


def arrow_length_m(plane: Plane) -> float:
    """Return the length of the arrow along the normal."""
    return min(_ARROW_LENGTH * math.hypot(*plane.centroid_m),
               _LARGEST_ARROW * math.sqrt(plane.area_m2))


def plane_name(detection: Detection, index: int, label: int) -> str:
    """Return the label of a plane with its class, if that says more than "other"."""
    kind = PlaneClass(detection.classes[index]) if detection.classes else PlaneClass.UNKNOWN
    return f'{label} {_SHORT_NAMES.get(kind, kind.name.lower())}'.rstrip()


def plane_captions(detection: Detection, labels: Sequence[int], intrinsics: CameraIntrinsics,
                   places: Mapping[int, LabelPlace]) -> dict[int, Caption]:
    """
    Return the captions that are shown, by label.

    A caption is placed where its plane is widest in the image, in front of the plane, and faces
    the viewer. A small plane has none. If two overlap as seen from where the layout of the viewer
    looks, the one of the larger plane is kept.

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
    captions: dict[int, Caption] = {}
    boxes: list[np.ndarray] = []
    unit = '' if detection.scale_method == RELATIVE else ' m'
    for index in sorted(range(len(labels)), key=lambda k: -detection.planes[k].inlier_count):
        plane, label = detection.planes[index], labels[index]
        if plane.inlier_count < _MIN_SHARE * detection.labels.size:
            break
        text = f'{plane_name(detection, index, label)}: {plane.offset_m:.2f}{unit}'
        sight_m = _middle_m(plane, places.get(label), detection.depth_m, intrinsics) - _EYE
        height_m = min(_HEIGHT * math.hypot(*sight_m), _LARGEST_HEIGHT * math.sqrt(plane.area_m2))
        half_m = _BOX * height_m / 2 * np.array([_ADVANCE * len(text), 1.0])
        across_m, depth_m = _VIEW_AXES[:2] @ sight_m, float(_VIEW_AXES[2] @ sight_m)
        box = np.concatenate([across_m - half_m, across_m + half_m]) / depth_m
        if depth_m > 0 and not any(_overlap(box, other) for other in boxes):
            boxes.append(box)
            share = _share_before(plane, sight_m, half_m)
            captions[label] = Caption(text, _EYE + share * sight_m, share * height_m)
    return captions


def _middle_m(plane: Plane, place: LabelPlace | None, depth_m: np.ndarray,
              intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the point where a plane is widest in the image, else its centroid."""
    if place is None:
        return plane.centroid_m
    z_m = float(depth_m[place.row, place.column])
    return z_m * np.array([(place.column - intrinsics.cx) / intrinsics.fx,
                           (place.row - intrinsics.cy) / intrinsics.fy, 1.0])


def _share_before(plane: Plane, sight_m: np.ndarray, half_m: np.ndarray) -> float:
    """Return the share of the way from the eye at which a text is in front of its plane."""
    right, down = half_m[0] * _VIEW_AXES[0], half_m[1] * _VIEW_AXES[1]
    nearness = max(-float(plane.normal @ (sight_m + x * right + y * down))
                   for x in (-1, 1) for y in (-1, 1))
    to_eye_m = float(plane.normal @ _EYE) + plane.offset_m
    if nearness <= 0 or to_eye_m <= 0:  # behind the horizon of the plane, or seen from behind
        return 1.0
    return min(max(_BEFORE_PLANE * to_eye_m / nearness, _NEAREST), 1.0)


def _overlap(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether two boxes overlap: left, top, right, bottom."""
    return bool((first[:2] < second[2:]).all() and (second[:2] < first[2:]).all())
