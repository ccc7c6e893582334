# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Classes of planes from the direction of gravity: floor, ceiling, wall, other."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from plane_detector.directions.gravity_choice import COARSE_DEG, Gravity
from plane_detector.types import Plane

# Largest inclination of a plane that still counts as horizontal or vertical.
TOLERANCE_DEG = 8.0
# Horizontal planes closer than this share of the floor's distance are one floor (noise, sills).
SAME_LEVEL_SHARE = 0.08
# For a coarse direction of gravity: tolerance of horizontal and vertical planes about the axis
# that replaces it, and the smallest share of pixels in such planes.
FRAME_TOLERANCE_DEG = 4.0
MIN_FRAME_SHARE = 0.5


class PlaneClass(IntEnum):
    """Values of the field ``class`` of ``~/planes``."""

    UNKNOWN = 0
    FLOOR = 1
    CEILING = 2
    WALL = 3
    OTHER_HORIZONTAL = 4
    OTHER = 5


def classify_planes(planes: Sequence[Plane], gravity_camera: np.ndarray | None,
                    tolerance_deg: float = TOLERANCE_DEG) -> tuple[PlaneClass, ...]:
    """
    Classify the planes of one image by gravity.

    Parameters
    ----------
    planes : sequence of Plane
        With true angles, in any unit.
    gravity_camera : (3,) floating or None
        Unit direction of gravity in the optical frame.
    tolerance_deg : float
        Largest angle to horizontal or vertical.

    Returns
    -------
    tuple of PlaneClass
        One per plane. The floor is the lowest horizontal plane that faces up, the ceiling the
        highest that faces down, with all planes at that level. All ``UNKNOWN`` without gravity.

    Examples
    --------
    >>> def plane(normal, offset_m):
    ...     return Plane(np.array(normal), offset_m, np.zeros(3), 1, 0.0, 1.0, np.eye(4), 1.0)
    >>> floor, table, wall = plane([0, -1, 0], 1.5), plane([0, -1, 0], 0.8), plane([0, 0, -1], 3.0)
    >>> [found.name for found in classify_planes([floor, table, wall], np.array([0.0, 1.0, 0.0]))]
    ['FLOOR', 'OTHER_HORIZONTAL', 'WALL']

    """
    if gravity_camera is None or not planes:
        return (PlaneClass.UNKNOWN,) * len(planes)
    facing_down = np.array([plane.normal @ gravity_camera for plane in planes])
    offsets = np.array([plane.offset_m for plane in planes])
    level = np.cos(np.radians(tolerance_deg))
    upright = np.sin(np.radians(tolerance_deg))
    classes = np.full(len(planes), PlaneClass.OTHER)
    classes[np.abs(facing_down) <= upright] = PlaneClass.WALL
    for side, extreme in ((facing_down <= -level, PlaneClass.FLOOR),
                          (facing_down >= level, PlaneClass.CEILING)):
        farthest = offsets[side].max(initial=0.0)
        outermost = offsets >= (1.0 - SAME_LEVEL_SHARE) * farthest
        classes[side] = np.where(outermost[side], extreme, PlaneClass.OTHER_HORIZONTAL)
    return tuple(PlaneClass(value) for value in classes)


def classify_by_gravity(planes: Sequence[Plane], gravity: Gravity,
                        has_true_angles: bool = True) -> tuple[PlaneClass, ...]:
    """
    Classify planes; a coarse direction of gravity is first refined by the planes.

    All are ``UNKNOWN`` if angles are not true.
    """
    down = gravity.gravity_camera if has_true_angles else None
    if down is not None and gravity.tolerance_deg > COARSE_DEG:
        down = refine_gravity(planes, down, gravity.tolerance_deg)
    return classify_planes(planes, down)


def refine_gravity(planes: Sequence[Plane], coarse_gravity_camera: np.ndarray,
                   tolerance_deg: float) -> np.ndarray | None:
    """
    Refine a coarse direction of gravity by planes that are perpendicular to each other.

    Parameters
    ----------
    planes : sequence of Plane
        With true angles.
    coarse_gravity_camera : (3,) floating
        Unit direction.
    tolerance_deg : float
        Largest error of that direction.

    Returns
    -------
    (3,) float64 or None
        Mean normal of the horizontal planes; None if there are no vertical planes, or if both
        together are not most of the image.

    """
    if not planes:
        return None
    normals = np.stack([plane.normal for plane in planes])
    pixels = np.array([plane.inlier_count for plane in planes], float)
    normals = normals * np.where(normals @ coarse_gravity_camera < 0, -1.0, 1.0)[:, None]
    near = normals @ coarse_gravity_camera >= np.cos(np.radians(tolerance_deg))
    cosine = np.abs(normals @ normals.T)
    level = cosine >= np.cos(np.radians(FRAME_TOLERANCE_DEG))
    upright = cosine <= np.sin(np.radians(FRAME_TOLERANCE_DEG))
    share = (level | upright) @ pixels / pixels.sum()
    possible = near & upright.any(1) & (share >= MIN_FRAME_SHARE)
    if not possible.any():
        return None
    best = np.where(possible, share * pixels.sum() + level @ pixels, -1.0).argmax()
    members = level[best] & near
    mean = (pixels[members, None] * normals[members]).sum(0)
    return mean / np.linalg.norm(mean)
