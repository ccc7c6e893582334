# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Classes of planes from the direction of gravity; `plane_detector.ground` adds the ground."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from math import erf

import numpy as np

from plane_detector.types import Plane

# Largest inclination of a plane that still counts as horizontal or vertical.
TOLERANCE_DEG = 8.0
# A class is given if it is right with this probability, as the vertical is.
MIN_PROBABILITY = 0.9
# Shares of vertical, horizontal and other planes among those whose normal is known to 2 degrees.
# measured: 103 planes in the sensors' depth of 16 frames of Kinect, NYU and kitchen.
UPRIGHT_SHARE, LEVEL_SHARE, OTHER_SHARE = 0.42, 0.26, 0.32
# derived: far below what any sensor measures, and no division by 0.
LEAST_SIGMA_RAD = 1e-5
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
        With true angles, in any unit. One whose normal is too uncertain for its class is OTHER.
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
    ...     return Plane(np.array(normal), offset_m, np.zeros(3), 1, 0.0, 1.0, np.zeros((4, 4)), 1)
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
    classes[~are_certain(planes, down, tolerance_deg)] = PlaneClass.OTHER
    return tuple(PlaneClass(value) for value in classes)


def are_certain(planes: Sequence[Plane], down: np.ndarray,
                tolerance_deg: float = TOLERANCE_DEG) -> np.ndarray:
    """
    Return which planes (K,), bool, are horizontal, vertical or neither with MIN_PROBABILITY.

    Planes that the lines of the image oriented have the probability that came with this. Others
    have an error by their covariance, and the true plane is exactly vertical, exactly horizontal
    or of any direction.

    Examples
    --------
    >>> normal, covariance = np.array([0.0, -1.0, 0.0]), np.diag([0.2, 0.0, 0.2, 0.0])
    >>> poor = Plane(normal, 0.8, np.zeros(3), 1, 0.0, 1.0, covariance, 1.0)
    >>> fine = Plane(normal, 0.8, np.zeros(3), 1, 0.0, 1.0, covariance / 100, 1.0)
    >>> are_certain([poor, fine], np.array([0.0, 1.0, 0.0])).tolist()
    [False, True]

    """
    known = np.array([plane.class_certainty for plane in planes])
    is_free, found = np.isnan(known), known.copy()
    if is_free.any():
        free = [plane for plane, is_one in zip(planes, is_free.tolist(), strict=True) if is_one]
        found[is_free] = _probabilities(np.stack([plane.normal for plane in free]),
                                        np.stack([plane.covariance[:3, :3] for plane in free]),
                                        down, np.radians(tolerance_deg))
    return found >= MIN_PROBABILITY


def _probabilities(normals: np.ndarray, covariances: np.ndarray, down: np.ndarray,
                   tolerance_rad: float) -> np.ndarray:
    """Return the probability that planes (K,) are horizontal, vertical or neither as they seem."""
    cosine = np.clip(normals @ down, -1, 1)
    # The standard deviation along down, along the tilt and level across it. A normal along down
    # tilts in any direction.
    any_tilt = np.cross(down, np.eye(3)[np.abs(down).argmin()])
    tilt = normals - cosine[:, None] * down + LEAST_SIGMA_RAD**2 * any_tilt
    tilt /= np.linalg.norm(tilt, axis=1, keepdims=True)
    axes = np.stack([np.broadcast_to(down, tilt.shape), tilt, np.cross(down, tilt)], axis=1)
    variances = ((axes @ covariances) * axes).sum(axis=2).T
    of_down, of_tilt, across = np.sqrt(np.maximum(variances, LEAST_SIGMA_RAD**2))
    from_level, from_upright = np.arccos(np.abs(cosine)), np.arcsin(np.abs(cosine))
    # Densities of the normal: of any direction on a hemisphere, on a half circle and at a point.
    likelihood = np.stack([
        np.full(len(cosine), OTHER_SHARE / (2 * np.pi)),
        UPRIGHT_SHARE / np.pi * _density(from_upright / of_down) / of_down,
        LEVEL_SHARE * _density(from_level / of_tilt) * _density(0.0) / (of_tilt * across)])
    free, upright, flat = likelihood / likelihood.sum(axis=0)
    seems_upright = _within(from_upright, of_down, tolerance_rad)
    seems_flat = (_within(from_level, of_tilt, tolerance_rad)
                  * _within(np.zeros(len(cosine)), across, tolerance_rad))
    return np.where(from_upright <= tolerance_rad, upright + free * seems_upright,
                    np.where(from_level <= tolerance_rad, flat + free * seems_flat, 1.0))


def _density(deviations: np.ndarray | float) -> np.ndarray | float:
    return np.exp(-0.5 * np.square(deviations)) / np.sqrt(2 * np.pi)


def _within(off_rad: np.ndarray, sigma_rad: np.ndarray, most_rad: float) -> np.ndarray:
    """Return the probability that angles (K,) are at most so large on either side."""
    reach = np.stack([most_rad - off_rad, most_rad + off_rad]) / (np.sqrt(2) * sigma_rad)
    return 0.5 * np.array([[erf(one) for one in side] for side in reach.tolist()]).sum(axis=0)


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
