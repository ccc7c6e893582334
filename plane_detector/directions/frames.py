# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of three perpendicular directions, scored by and fitted to line segments."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.line_segments import LineSegments

# Tolerances for a segment to point to a direction, at first and after the fit.
# tuned: evaluation.benchmark.orientation directions, flat from 2 to 4 and from 1.5 to 2.5.
SEARCH_TOLERANCE_DEG, FIT_TOLERANCE_DEG = 3.0, 2.0
SEARCH_ROUNDS, FIT_ROUNDS = 2, 6


@dataclass(frozen=True)
class FrameFit:
    """Directions fitted to their segments."""

    axes: np.ndarray  # (3, 3) float64: rows: unit directions in the camera frame
    # (3, 3) float64: of a small rotation of all axes, in the camera frame, rad^2
    covariance: np.ndarray


def misalignment(segments: LineSegments, directions: np.ndarray) -> np.ndarray:
    """
    Return the sine of the angle (N, ...) between segments and the images of directions (..., 3).

    At the midpoint (x, y, 1) the image of direction d is parallel to (dx - x dz, dy - y dz).
    """
    sine = _sines(segments.normals, segments.midpoints,
                  np.ascontiguousarray(directions.reshape(-1, 3)))
    return sine.reshape(len(segments), *directions.shape[:-1])


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, ::1])', is_short=True)
def _sines(normals, midpoints, directions):
    sines = np.empty((len(normals), len(directions)))
    for i in range(len(normals)):
        for j in range(len(directions)):
            sines[i, j] = _sine(normals[i], midpoints[i], directions[j])
    return sines


@kernel('float64(float64[::1], float64[::1], float64[::1])')
def _sine(normal, midpoint, direction):
    x = direction[0] - midpoint[0] * direction[2]
    y = direction[1] - midpoint[1] * direction[2]
    cross = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    return cross / np.sqrt(x * x + y * y + 1e-12)


def fit_frame(segments: LineSegments, axes: np.ndarray, used: tuple[int, ...] = (0, 1, 2)
              ) -> FrameFit:
    """
    Rotate axes so that their segments point to them, by reweighted least squares (Tukey).

    Parameters
    ----------
    segments : LineSegments
    axes : (3, 3) float64
    used : tuple of int
        The axes that segments may point to; the others are rotated with them.

    """
    axes = np.array(axes, float)
    sums = _fit(segments.normals, segments.midpoints, segments.lengths, axes,
                np.array([k in used for k in range(3)]))
    weight, weight_square, squares = sums[4].tolist()
    independent = weight**2 / max(weight_square, 1e-12)
    # Covariance of weighted means: moment^-1 times the variance over the independent segments.
    variance = squares / max(independent - len(used), 1.0)
    return FrameFit(axes, cv2.invert(sums[:3])[1] * variance)


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], '
        'boolean[::1])', is_short=True)
def _fit(normals, midpoints, lengths, axes, is_used):
    """Rotate the axes to their segments; return the sums of the last normal equations."""
    sums = np.zeros((5, 3))
    for k in range(SEARCH_ROUNDS + FIT_ROUNDS):
        tolerance_deg = SEARCH_TOLERANCE_DEG if k < SEARCH_ROUNDS else FIT_TOLERANCE_DEG
        _normal_equations(normals, midpoints, lengths, axes, is_used,
                          np.sin(np.radians(tolerance_deg)), sums)
        turn_by_solution(axes, sums[:3], -sums[3])
    return sums


@kernel('void(float64[:, ::1], float64[:, ::1], float64[::1])', is_short=True)
def turn_by_solution(rows, m, right):
    """Rotate rows (N, 3) by the rotation vector x of m x = right, with a symmetric m (3, 3)."""
    inverse = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            p, q, r, s = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            inverse[i, j] = m[p, r] * m[q, s] - m[p, s] * m[q, r]
    determinant = m[0, 0] * inverse[0, 0] + m[0, 1] * inverse[0, 1] + m[0, 2] * inverse[0, 2]
    turn = np.zeros(3)
    for i in range(3):
        for j in range(3):
            turn[i] += inverse[i, j] * right[j] / determinant
    angle = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    if angle == 0:
        return
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = turn[0] / angle, turn[1] / angle, turn[2] / angle
    for i in range(len(rows)):
        a, b, d = rows[i, 0], rows[i, 1], rows[i, 2]
        along = (1 - c) * (x * a + y * b + z * d)
        rows[i, 0] = c * a + s * (y * d - z * b) + along * x
        rows[i, 1] = c * b + s * (z * a - x * d) + along * y
        rows[i, 2] = c * d + s * (x * b - y * a) + along * z


@kernel('void(float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], '
        'boolean[::1], float64, float64[:, ::1])')
def _normal_equations(normals, midpoints, lengths, directions, is_used, widest, sums):
    """
    Write moment (3, 3), gradient (3,) and (sum w, sum w^2, sum w s^2) of the misalignments s.

    Each segment contributes to the direction closest to it, weighted by its length and Tukey's
    weight; the derivative with respect to a small rotation is d x n over the length of the
    direction's image. The moment is invertible even if no segment sees an axis.
    """
    sums[:], jacobian = 0.0, np.zeros(3)
    for i in range(len(lengths)):
        nearest, sine = 0, np.inf
        for j in range(len(directions)):
            if not is_used[j]:
                continue
            candidate = _sine(normals[i], midpoints[i], directions[j])
            if abs(candidate) < abs(sine):
                nearest, sine = j, candidate
        inside = 1.0 - (sine / widest) ** 2
        if inside <= 0:
            continue
        weight, n, d = lengths[i] * inside * inside, normals[i], directions[nearest]
        length = np.hypot(d[0] - midpoints[i, 0] * d[2], d[1] - midpoints[i, 1] * d[2]) + 1e-12
        jacobian[0] = (d[1] * n[2] - d[2] * n[1]) / length
        jacobian[1] = (d[2] * n[0] - d[0] * n[2]) / length
        jacobian[2] = (d[0] * n[1] - d[1] * n[0]) / length
        for a in range(3):
            for b in range(3):
                sums[a, b] += weight * jacobian[a] * jacobian[b]
            sums[3, a] += weight * sine * jacobian[a]
        sums[4, 0] += weight
        sums[4, 1] += weight * weight
        sums[4, 2] += weight * sine * sine
    for a in range(3):
        sums[a, a] += 1e-6 * sums[4, 0] + 1e-12
