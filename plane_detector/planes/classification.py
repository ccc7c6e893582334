# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Classes of planes from the direction of gravity; `plane_detector.ground` adds the ground."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from plane_detector.types import Plane

# Largest inclination of a plane that still counts as horizontal or vertical.
TOLERANCE_DEG = 8.0
# Horizontal planes closer than this share of the ceiling's distance are one ceiling (noise).
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
    RAMP = 6
    STEP = 7


def classify_planes(planes: Sequence[Plane], down: np.ndarray,
                    tolerance_deg: float = TOLERANCE_DEG) -> tuple[PlaneClass, ...]:
    """
    Tell walls, the ceiling and other horizontal planes apart.

    Parameters
    ----------
    planes : sequence of Plane
        With true angles, in any unit.
    down : (3,) floating
        Unit direction of gravity in the optical frame.
    tolerance_deg : float
        Largest angle to horizontal or vertical.

    Returns
    -------
    tuple of PlaneClass
        One per plane. The ceiling is the highest horizontal plane that faces down, with all planes
        at that level. Which of those that face up is the floor, the pixels tell: see
        :func:`~plane_detector.ground.ground.find_ground`.

    Examples
    --------
    >>> def plane(normal, offset_m):
    ...     return Plane(np.array(normal), offset_m, np.zeros(3), 1, 0.0, 1.0, np.eye(4), 1.0)
    >>> table, ceiling, wall = plane([0, -1, 0], 0.8), plane([0, 1, 0], 1.2), plane([0, 0, -1], 3)
    >>> [kind.name for kind in classify_planes([table, ceiling, wall], np.array([0.0, 1.0, 0.0]))]
    ['OTHER_HORIZONTAL', 'CEILING', 'WALL']

    """
    facing_down = np.array([plane.normal @ down for plane in planes])
    offsets = np.array([plane.offset_m for plane in planes])
    upright, level = np.sin(np.radians(tolerance_deg)), np.cos(np.radians(tolerance_deg))
    above = facing_down >= level
    outermost = above & (offsets >= (1.0 - SAME_LEVEL_SHARE) * offsets[above].max(initial=0.0))
    classes = np.full(len(planes), PlaneClass.OTHER)
    classes[np.abs(facing_down) <= upright] = PlaneClass.WALL
    classes[np.abs(facing_down) >= level] = PlaneClass.OTHER_HORIZONTAL
    classes[outermost] = PlaneClass.CEILING
    return tuple(PlaneClass(value) for value in classes)


def lowest_level(planes: Sequence[Plane], down: np.ndarray) -> Plane | None:
    """Return the lowest horizontal plane that faces up; None if there is none."""
    level = [plane for plane in planes
             if plane.normal @ down <= -np.cos(np.radians(TOLERANCE_DEG))]
    return max(level, key=lambda plane: plane.offset_m, default=None)


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
