# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Classes of planes from the direction of gravity; `plane_detector.ground` adds the ground."""

from __future__ import annotations

import math

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.planes.history import YIELDING_PROBABILITY, PlaneHistory
from plane_detector.types import Plane, PlaneClass, Planes

# Largest inclination of a plane that still counts as horizontal or vertical.
TOLERANCE_DEG = 8.0
_LEVEL_KINDS = (PlaneClass.FLOOR, PlaneClass.CEILING, PlaneClass.OTHER_HORIZONTAL,
                PlaneClass.STEP)
# A class is assigned if it is right with this probability, as for the vertical.
MIN_PROBABILITY = 0.9
# The same for planes oriented by lines of the image. Their probability also includes the case that
# a piece spans several surfaces; 0.9 would lose a third of the true walls and floors of a small
# network. chosen: a class is four times as likely right as wrong.
MIN_ORIENTED_PROBABILITY = 0.8
# Shares of vertical, horizontal and other planes among those whose normal is known to 2 degrees.
# measured: 103 planes in the sensors' depth of 16 frames of Kinect, NYU and kitchen.
UPRIGHT_SHARE, LEVEL_SHARE, OTHER_SHARE = 0.42, 0.26, 0.32
# chosen: far below what any sensor measures, to avoid division by 0.
LEAST_SIGMA_RAD = 1e-5
# Horizontal planes closer than this share of the ceiling's distance are one ceiling (noise).
SAME_LEVEL_SHARE = 0.08
# For a coarse direction of gravity: tolerance of horizontal and vertical planes about the axis
# that replaces it, and the smallest share of pixels in such planes.
FRAME_TOLERANCE_DEG = 4.0
MIN_FRAME_SHARE = 0.5


def classify_planes(planes: Planes, down: np.ndarray,
                    past: PlaneHistory | None = None) -> np.ndarray:
    """
    Distinguish walls, the ceiling and other horizontal planes.

    Parameters
    ----------
    planes : Planes
        With true angles, in any unit. One whose normal is too uncertain for its class is OTHER.
    down : (3,) floating
        Unit direction of gravity in the optical frame.
    past : PlaneHistory, optional
        Of these planes, with their inclinations. Default: each is classified by its normal.

    Returns
    -------
    (K,) uint8
        Values of PlaneClass. The ceiling is the highest horizontal plane that faces down, with all
        others at that level. Pixels decide which of the planes that face up is the floor: see
        :func:`~plane_detector.ground.ground.find_ground`.

    Examples
    --------
    >>> def plane(normal, offset_m):
    ...     return Plane(np.array(normal), offset_m, np.zeros(3), 1, 0.0, 1.0, np.zeros((4, 4)), 1)
    >>> table, ceiling, wall = plane([0, -1, 0], 0.8), plane([0, 1, 0], 1.2), plane([0, 0, -1], 3)
    >>> planes = Planes.of([table, ceiling, wall])
    >>> [PlaneClass(kind).name for kind in classify_planes(planes, np.array([0.0, 1.0, 0.0]))]
    ['OTHER_HORIZONTAL', 'CEILING', 'WALL']

    """
    facing_down = planes.normals @ down if past is None else past.cosines
    offsets, upright, level = planes.offsets_m, TOLERANCE_DEG, TOLERANCE_DEG
    if past is not None:
        upright = TOLERANCE_DEG + past.yields_deg(PlaneClass.WALL)
        level = TOLERANCE_DEG + past.yields_deg(*_LEVEL_KINDS)
    above = facing_down >= np.cos(np.radians(level))
    outermost = above & (offsets >= (1.0 - SAME_LEVEL_SHARE) * offsets[above].max(initial=0.0))
    classes = np.full(len(planes), PlaneClass.OTHER, np.uint8)
    classes[np.abs(facing_down) <= np.sin(np.radians(upright))] = PlaneClass.WALL
    classes[np.abs(facing_down) >= np.cos(np.radians(level))] = PlaneClass.OTHER_HORIZONTAL
    classes[outermost] = PlaneClass.CEILING
    classes[~are_certain(planes, down, past=past)] = PlaneClass.OTHER
    return classes


def are_certain(planes: Planes, down: np.ndarray,
                tolerance_deg: float = TOLERANCE_DEG,
                past: PlaneHistory | None = None) -> np.ndarray:
    """
    Return which planes (K,), bool, are horizontal, vertical or neither with enough probability.

    Planes oriented by lines of the image have the probability from that step. Others have an error
    according to their covariance, and the true plane is exactly vertical, exactly horizontal or of
    any direction.

    Examples
    --------
    >>> normal, covariance = np.array([0.0, -1.0, 0.0]), np.diag([0.2, 0.0, 0.2, 0.0])
    >>> poor = Plane(normal, 0.8, np.zeros(3), 1, 0.0, 1.0, covariance, 1.0)
    >>> fine = Plane(normal, 0.8, np.zeros(3), 1, 0.0, 1.0, covariance / 100, 1.0)
    >>> are_certain(Planes.of([poor, fine]), np.array([0.0, 1.0, 0.0])).tolist()
    [False, True]

    """
    known, normals, more = planes.class_certainties, planes.normals, 0.0
    if past is not None:
        normals = _inclined(normals, down, past.cosines)
        more = np.where(past.classes == PlaneClass.OTHER, 1, -1) * YIELDING_PROBABILITY * (
            past.classes != PlaneClass.UNKNOWN)
    free = _probabilities(np.ascontiguousarray(normals, float),
                          np.ascontiguousarray(planes.covariances, float),
                          np.asarray(down, float), np.radians(tolerance_deg))
    return np.where(np.isnan(known), free >= MIN_PROBABILITY + more,
                    known >= MIN_ORIENTED_PROBABILITY + more)


def _inclined(normals: np.ndarray, down: np.ndarray, cosines: np.ndarray) -> np.ndarray:
    """Return normals (K, 3) of the same azimuth with other angles to a direction."""
    level = normals - (normals @ down)[:, None] * down
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-12)
    sines = np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
    return cosines[:, None] * down + sines[:, None] * level


@kernel('float64[::1](float64[:, ::1], float64[:, :, ::1], float64[::1], float64)', is_short=True)
def _probabilities(normals, covariances, down, tolerance_rad):
    """Return the probability that planes (K,) are horizontal, vertical or neither as they seem."""
    found, axes, sigmas = np.empty(len(normals)), np.empty((3, 3)), np.empty(3)
    for k in range(len(normals)):
        normal, covariance = normals[k], covariances[k]
        cosine = normal[0] * down[0] + normal[1] * down[1] + normal[2] * down[2]
        cosine = min(max(cosine, -1.0), 1.0)
        _set_axes(normal, down, cosine, axes)
        for axis in range(3):
            variance = 0.0
            for i in range(3):
                for j in range(3):
                    variance += axes[axis, i] * covariance[i, j] * axes[axis, j]
            sigmas[axis] = np.sqrt(max(variance, LEAST_SIGMA_RAD**2))
        from_level, from_upright = math.acos(abs(cosine)), math.asin(abs(cosine))
        # Densities of the normal: of any direction on a hemisphere, on a half circle, at a point.
        free = OTHER_SHARE / (2 * np.pi)
        upright = UPRIGHT_SHARE / np.pi * _density(from_upright / sigmas[0]) / sigmas[0]
        level = (LEVEL_SHARE * _density(from_level / sigmas[1]) * _density(0.0)
                 / (sigmas[1] * sigmas[2]))
        found[k] = 1.0
        if from_upright <= tolerance_rad:
            found[k] = ((upright + free * _within(from_upright, sigmas[0], tolerance_rad))
                        / (free + upright + level))
        elif from_level <= tolerance_rad:
            seems_level = (_within(from_level, sigmas[1], tolerance_rad)
                           * _within(0.0, sigmas[2], tolerance_rad))
            found[k] = (level + free * seems_level) / (free + upright + level)
    return found


@kernel('void(float64[::1], float64[::1], float64, float64[:, ::1])')
def _set_axes(normal, down, cosine, axes):
    """Write down, the level direction that a normal tilts to (any if it does not), and across."""
    length2, least = 0.0, 0
    for i in range(3):
        axes[0, i], axes[1, i] = down[i], normal[i] - cosine * down[i]
        length2 += axes[1, i] ** 2
        least = i if abs(down[i]) < abs(down[least]) else least
    if length2 < LEAST_SIGMA_RAD**2:
        for i in range(3):
            axes[1, i] = (1.0 if i == least else 0.0) - down[least] * down[i]
        length2 = 1 - down[least] ** 2
    for i in range(3):
        axes[1, i] /= np.sqrt(length2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        axes[2, i] = axes[0, j] * axes[1, k] - axes[0, k] * axes[1, j]


@kernel('float64(float64)')
def _density(deviations):
    return np.exp(-0.5 * deviations * deviations) / np.sqrt(2 * np.pi)


@kernel('float64(float64, float64, float64)')
def _within(off_rad, sigma_rad, most_rad):
    """Return the probability that an angle is at most this large on either side."""
    scale = np.sqrt(2) * sigma_rad
    return 0.5 * (math.erf((most_rad - off_rad) / scale) + math.erf((most_rad + off_rad) / scale))


def lowest_level(planes: Planes, down: np.ndarray) -> Plane | None:
    """Return the lowest horizontal plane that faces up; None if there is none."""
    is_level = planes.normals @ down <= -np.cos(np.radians(TOLERANCE_DEG))
    return (planes[int(np.where(is_level, planes.offsets_m, -np.inf).argmax())]
            if is_level.any() else None)


def refine_gravity(planes: Planes, coarse_gravity_camera: np.ndarray,
                   tolerance_deg: float) -> np.ndarray | None:
    """
    Refine a coarse direction of gravity by planes that are perpendicular to each other.

    Parameters
    ----------
    planes : Planes
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
    if not len(planes):
        return None
    normals, pixels = planes.normals, planes.counts.astype(float)
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
