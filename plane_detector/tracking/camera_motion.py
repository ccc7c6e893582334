# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Motion of the camera between two images, estimated from their planes.

A point moves from p to scale * R p + t, so a plane (n, d) becomes (R n, scale * d - R n . t). The
scale is needed for depth of unknown unit, which may change from image to image. Motion that the
planes do not constrain, such as a rotation about the only visible normal, is assumed to be zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.types import Planes

# chosen: a change of a millionth changes no label; a stationary camera needs two rounds.
_MOST_ROUNDS, _CONVERGED = 8, 1e-6
# Weight of the prior for no rotation; all planes together have weight 1.
_NO_TURN_WEIGHT = 0.03
# Lower bound of the standard deviation between normals, however small the covariance of the fit.
_NORMAL_SPREAD_RAD = np.radians(1.0)
_TURN_SPREAD_RAD = np.radians(2.0)
# Spread of the offsets of a rigid scene, and of the translation of the camera between two images,
# as shares of the distance to the scene.
_OFFSET_SPREAD, _STEP_SPREAD, _SCALE_SPREAD = 0.02, 0.1, 0.04
_PRIOR = np.array([_STEP_SPREAD] * 3 + [_SCALE_SPREAD]) ** -2
# In the first round, large rotations and changes of the unit are nearly as likely as none.
_FIRST_CAUTION = 0.01


@dataclass(frozen=True)
class PlaneMotion:
    """A similarity transform from the previous camera frame to the current one."""

    rotation: np.ndarray  # (3, 3) float64
    translation_m: np.ndarray  # (3,) float64, in the unit of the present image
    scale: float  # factor on lengths; 1 if the unit is known

    def move(self, planes: Planes) -> Planes:
        """Return planes of the previous camera frame in the current one."""
        return planes.moved(self, self.scale)


NO_MOTION = PlaneMotion(np.eye(3), np.zeros(3), 1.0)


def estimate_motion(before: Planes, after: Planes, pairs: tuple[np.ndarray, np.ndarray],
                    weights: np.ndarray) -> PlaneMotion:
    """
    Estimate the motion from planes visible in both images.

    1. Estimate the rotation between the normals (Horn 1987).
    2. Estimate translation and scale by least squares.

    Both are reweighted with Cauchy's function, so that a few wrong pairs have little effect. The
    ``pairs`` are the indices (N,) of planes in the previous and in the current camera frame, with
    a weight (N,) each. Without pairs the motion is zero.
    """
    old, new = pairs
    if not len(old):
        return NO_MOTION
    normals, normals_after = before.normals[old], after.normals[new]
    weights = weights / (before.normal_variances[old] + after.normal_variances[new]
                         + _NORMAL_SPREAD_RAD ** 2)
    weights /= weights.sum()
    rotation = _rotation(normals, normals_after, weights)
    off = normals @ rotation.T - normals_after
    agree = (off * off).sum(axis=1) < (2 * _TURN_SPREAD_RAD) ** 2
    if not agree.any():
        return NO_MOTION
    new = new[agree]
    translation_m, scale = _translation_and_scale(
        before.offsets_m[old[agree]], normals_after[agree], after.offsets_m[new],
        after.distances_m[new], weights[agree])
    return PlaneMotion(rotation, translation_m, scale)


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[::1])', is_short=True)
def _rotation(before, after, weights):
    """Return the rotation (3, 3) from the previous normals (N, 3) to the current ones."""
    rotation, robust, caution = np.eye(3), weights.copy(), _FIRST_CAUTION
    for _ in range(_MOST_ROUNDS):
        last = rotation
        rotation = _least_squares_rotation(
            after.T @ (robust.reshape(-1, 1) * before) + caution * _NO_TURN_WEIGHT * np.eye(3))
        if np.abs(rotation - last).max() < _CONVERGED:
            break
        error2 = ((before @ rotation.T - after) ** 2).sum(axis=1)
        robust = weights / (1 + error2 / _TURN_SPREAD_RAD**2)
        turn_rad = math.acos(min(max((np.trace(rotation) - 1) / 2, -1.0), 1.0))
        caution = 1 / (1 + (turn_rad / _TURN_SPREAD_RAD) ** 2)
    return rotation


@kernel('float64[:, ::1](float64[:, ::1])')
def _least_squares_rotation(products):
    """Return the rotation closest to sums (3, 3) of current times previous vectors (Kabsch)."""
    left, _, right = np.linalg.svd(products)
    if np.linalg.det(left) * np.linalg.det(right) < 0:
        left[:, 2] *= -1
    return left @ right


def _translation_and_scale(before_m: np.ndarray, normals: np.ndarray, after_m: np.ndarray,
                           distances_m: np.ndarray, weights: np.ndarray
                           ) -> tuple[np.ndarray, float]:
    """Solve after = scale * before - normals . t, with priors that keep t and scale - 1 small."""
    typical_m = float(weights @ distances_m / weights.sum())
    # Unknowns: t as a share of the typical distance, and scale - 1.
    system = np.column_stack([-normals * typical_m, before_m]) / distances_m[:, None]
    unknown = _solved(system, (after_m - before_m) / distances_m, weights)
    return unknown[:3] * typical_m, min(max(1.0 + float(unknown[3]), 0.01), 100.0)


@kernel('float64[::1](float64[:, ::1], float64[::1], float64[::1])', is_short=True)
def _solved(system, change, weights):
    """Return the unknowns (4,) of system @ unknown = change with few outliers."""
    unknown, robust, caution = np.zeros(4), weights.copy(), np.ones(4)
    caution[3] = _FIRST_CAUTION
    for _ in range(_MOST_ROUNDS):
        last = unknown
        weighted = (robust / _OFFSET_SPREAD**2).reshape(-1, 1) * system
        unknown = np.linalg.solve(weighted.T @ system + np.diag(caution * _PRIOR),
                                  change @ weighted)
        if np.abs(unknown - last).max() < _CONVERGED:
            break
        robust = weights / (1 + ((system @ unknown - change) / _OFFSET_SPREAD) ** 2)
        caution = 1 / (1 + unknown * unknown * _PRIOR)
    return unknown
