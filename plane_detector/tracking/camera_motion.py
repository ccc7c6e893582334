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

import cv2
import numpy as np

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

    1. Estimate the rotation between the normals (Kabsch 1976).
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


def _rotation(before: np.ndarray, after: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) from the previous normals (N, 3) to the current ones."""
    rotation, prior = np.eye(3), _NO_TURN_WEIGHT * np.eye(3)
    robust, caution = weights, _FIRST_CAUTION
    for _ in range(_MOST_ROUNDS):
        # OpenCV: the overhead of numpy is several times larger for so few numbers.
        _, left, right = cv2.SVDecomp((after.T * robust) @ before + caution * prior)
        if cv2.determinant(left @ right) < 0:
            left[:, 2] *= -1
        last, rotation = rotation, left @ right
        if abs(rotation - last).max() < _CONVERGED:
            break
        error = before @ rotation.T - after
        robust = weights * _cauchy_of_square((error * error).sum(axis=1) / _TURN_SPREAD_RAD ** 2)
        turn_rad = math.acos(min(max((rotation.trace() - 1) / 2, -1.0), 1.0))
        caution = _cauchy_of_square((turn_rad / _TURN_SPREAD_RAD) ** 2)
    return rotation


def _translation_and_scale(before_m: np.ndarray, normals: np.ndarray, after_m: np.ndarray,
                           distances_m: np.ndarray, weights: np.ndarray
                           ) -> tuple[np.ndarray, float]:
    """Solve after = scale * before - normals . t, with priors that keep t and scale - 1 small."""
    typical_m = float(weights @ distances_m / weights.sum())
    # Unknowns: t as a share of the typical distance, and scale - 1.
    system = np.column_stack([-normals * typical_m, before_m]) / distances_m[:, None]
    change = (after_m - before_m) / distances_m
    robust, caution = weights, np.array([1.0, 1.0, 1.0, _FIRST_CAUTION])
    unknown = np.zeros(4)
    for _ in range(_MOST_ROUNDS):
        weighted = system.T * (robust / _OFFSET_SPREAD ** 2)
        last = unknown
        normal_equations = weighted @ system + np.diag(caution * _PRIOR)
        unknown = cv2.solve(normal_equations, (weighted @ change)[:, None])[1][:, 0]
        if abs(unknown - last).max() < _CONVERGED:
            break
        misfit = (system @ unknown - change) / _OFFSET_SPREAD
        robust = weights * _cauchy_of_square(misfit * misfit)
        caution = _cauchy_of_square(unknown * unknown * _PRIOR)
    return unknown[:3] * typical_m, min(max(1.0 + float(unknown[3]), 0.01), 100.0)


def _cauchy_of_square(squared_ratio: np.ndarray | float) -> np.ndarray | float:
    return 1.0 / (1.0 + squared_ratio)
