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
# derived: each sweep squares what is left; twice as many as reach the rounding of float64 from 1.
_MOST_SWEEPS, _TINY = 10, 1e-15
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
    rotation, last, robust, caution = np.eye(3), np.empty((3, 3)), weights.copy(), _FIRST_CAUTION
    products = np.empty((3, 3))
    for _ in range(_MOST_ROUNDS):
        for i in range(3):
            for j in range(3):
                products[i, j] = caution * _NO_TURN_WEIGHT if i == j else 0.0
                for k in range(len(before)):
                    products[i, j] += robust[k] * before[k, i] * after[k, j]
                last[i, j] = rotation[i, j]
        _set_rotation(products, rotation)
        change = 0.0
        for i in range(3):
            for j in range(3):
                change = max(change, abs(rotation[i, j] - last[i, j]))
        if change < _CONVERGED:
            break
        for k in range(len(before)):
            error2 = 0.0
            for i in range(3):
                error = -after[k, i]
                for j in range(3):
                    error += rotation[i, j] * before[k, j]
                error2 += error * error
            robust[k] = weights[k] / (1 + error2 / _TURN_SPREAD_RAD**2)
        cosine = (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1) / 2
        turn_rad = math.acos(min(max(cosine, -1.0), 1.0))
        caution = 1 / (1 + (turn_rad / _TURN_SPREAD_RAD) ** 2)
    return rotation


@kernel('void(float64[:, ::1], float64[:, ::1])')
def _set_rotation(m, rotation):
    """
    Write the rotation of least squares by the sums m (3, 3) of previous times current vectors.

    It is the quaternion that is the eigenvector of the largest eigenvalue of a matrix (Horn 1987),
    found by rotations of two axes (Jacobi 1846).
    """
    a, axes = np.empty((4, 4)), np.eye(4)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        a[i + 1, i + 1] = m[i, i] - m[j, j] - m[k, k]
        a[0, i + 1] = a[i + 1, 0] = m[j, k] - m[k, j]
        a[j + 1, k + 1] = a[k + 1, j + 1] = m[j, k] + m[k, j]
    a[0, 0] = m[0, 0] + m[1, 1] + m[2, 2]
    for _ in range(_MOST_SWEEPS):
        rest = 0.0
        for p in range(4):
            for q in range(p + 1, 4):
                rest = max(rest, abs(a[p, q]))
                if a[p, q] == 0:
                    continue
                half = (a[q, q] - a[p, p]) / (2 * a[p, q])
                t = 1 / (abs(half) + math.sqrt(half * half + 1))
                t = t if half >= 0 else -t
                c = 1 / math.sqrt(t * t + 1)
                s = t * c
                for k in range(4):
                    a[k, p], a[k, q] = c * a[k, p] - s * a[k, q], s * a[k, p] + c * a[k, q]
                for k in range(4):
                    a[p, k], a[q, k] = c * a[p, k] - s * a[q, k], s * a[p, k] + c * a[q, k]
                    axes[k, p], axes[k, q] = (c * axes[k, p] - s * axes[k, q],
                                              s * axes[k, p] + c * axes[k, q])
        if rest <= _TINY * abs(a[0, 0]):
            break
    best = 0
    for k in range(1, 4):
        best = k if a[k, k] > a[best, best] else best
    w, x, y, z = axes[0, best], axes[1, best], axes[2, best], axes[3, best]
    rotation[0, 0], rotation[1, 1] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z)
    rotation[0, 1], rotation[1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    rotation[0, 2], rotation[2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    rotation[1, 2], rotation[2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    rotation[2, 2] = 1 - 2 * (x * x + y * y)


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
    unknown, last, robust = np.zeros(4), np.empty(4), weights.copy()
    caution, work = np.ones(4), np.empty((4, 5))
    caution[3] = _FIRST_CAUTION
    for _ in range(_MOST_ROUNDS):
        for i in range(4):
            last[i] = unknown[i]
            for j in range(5):
                work[i, j] = caution[i] * _PRIOR[i] if i == j else 0.0
                for k in range(len(system)):
                    work[i, j] += (robust[k] / _OFFSET_SPREAD**2 * system[k, i]
                                   * (system[k, j] if j < 4 else change[k]))
        for p in range(4):  # elimination; the prior keeps the pivots above 0
            for i in range(4):
                factor = work[i, p] / work[p, p] if i != p else 0.0
                for j in range(p, 5):
                    work[i, j] -= factor * work[p, j]
        moved = 0.0
        for i in range(4):
            unknown[i] = work[i, 4] / work[i, i]
            moved = max(moved, abs(unknown[i] - last[i]))
            caution[i] = 1 / (1 + unknown[i] * unknown[i] * _PRIOR[i])
        if moved < _CONVERGED:
            break
        for k in range(len(system)):
            misfit = -change[k]
            for i in range(4):
                misfit += system[k, i] * unknown[i]
            robust[k] = weights[k] / (1 + (misfit / _OFFSET_SPREAD) ** 2)
    return unknown
