# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled least squares: shapes and planes fitted to points with noise along their rays.

scipy's Levenberg-Marquardt gives the same shapes, which a test verifies, but most of its time goes
into calls for a few hundred points.

References
----------
D. Marquardt: An Algorithm for Least-Squares Estimation of Nonlinear Parameters, 1963.

"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.surface import (
    DEVIATIONS,
    about_axis,
    distance_deviation,
    frame_of,
    moved,
    turn_of,
)

# A shape is fitted, then its inliers are chosen anew.
_ROUNDS = 2
_MOST_STEPS = 12
# derived: of a sum of 500 squares that is a twentieth of one deviation.
_TOLERANCE = 1e-4
# after: Marquardt 1963, who damps ten times more after a bad step, ten times less after a good.
_FIRST_DAMPING, _DAMPING_STEP = 1e-3, 10.0


@kernel('Tuple((float64[::1], float64[::1]))(float64[::1], float64[:, ::1], float64[:, ::1])')
def distances_deviations(shape, points, noise):
    """Return distances (N,) of points (N, 3) from a shape and their deviations (N,)."""
    turn = turn_of(shape)
    distance, deviation = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        distance[i], deviation[i] = distance_deviation(
            shape, turn, (points[i, 0], points[i, 1], points[i, 2]), (noise[i, 0], noise[i, 1]))
    return distance, deviation


@kernel('float64[::1](float64[:, ::1], float64[::1])')
def solved(matrix, vector):
    """Return the solution (F,) of a positive definite system by Cholesky's method, else NaN."""
    count = len(vector)
    lower, result = np.zeros((count, count)), vector.copy()
    for i in range(count):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = rest / lower[j, j]
            elif rest > 0:
                lower[i, i] = np.sqrt(rest)
            else:
                return np.full(count, np.nan)
    for i in range(count):
        for k in range(i):
            result[i] -= lower[i, k] * result[k]
        result[i] /= lower[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            result[i] -= lower[k, i] * result[k]
        result[i] /= lower[i, i]
    return result


@kernel('float64(float64[::1], UniTuple(float64, 2), float64[:, ::1], float64[::1], '
        'float64[::1])')
def gradient(shape, turn, frame, point, result):
    """Return the distance of a point (3,); give its derivatives with respect to ``moved`` (7,)."""
    cosine, sine = turn
    along, away, x, y, z = about_axis(shape, point[0], point[1], point[2])
    n_x, n_y = cosine * x - sine * shape[3], cosine * y - sine * shape[4]
    n_z = cosine * z - sine * shape[5]
    # Turning the axis changes both the way along it and the distance from it.
    lever = along * cosine + away * sine
    for k in range(3):
        result[k] = -(n_x * frame[k, 0] + n_y * frame[k, 1] + n_z * frame[k, 2])
    for k in range(2):
        result[3 + k] = -lever * (x * frame[k, 0] + y * frame[k, 1] + z * frame[k, 2])
    result[5] = -1.0
    result[6] = -(away * sine + along * cosine)
    return away * cosine - along * sine - shape[6]


@kernel('Tuple((float64[:, ::1], float64[::1]))(float64[::1], int64[::1], float64[:, ::1], '
        'float64[::1], float64[:, ::1])')
def normal_equations(shape, freedoms, points, weight, frame):
    """Return J'J (F, F) and J'r (F,) of the weighted distances r of points (N, 3)."""
    turn, count = turn_of(shape), len(freedoms)
    matrix, vector, slope = np.zeros((count, count)), np.zeros(count), np.empty(7)
    for i in range(len(points)):
        if weight[i] == 0:
            continue
        distance = gradient(shape, turn, frame, points[i], slope)
        square = weight[i] * weight[i]
        for j in range(count):
            weighted = slope[freedoms[j]] * square
            vector[j] += weighted * distance
            for k in range(j + 1):
                matrix[j, k] += weighted * slope[freedoms[k]]
    for j in range(count):
        for k in range(j):
            matrix[k, j] = matrix[j, k]
    return matrix, vector


@kernel('float64(float64[::1], float64[:, ::1], float64[::1])')
def weighted_square(shape, points, weight):
    """Return the sum of the squared weighted distances of points (N, 3) from a shape."""
    cosine, sine = turn_of(shape)
    total = 0.0
    for i in range(len(points)):
        along, away, _, _, _ = about_axis(shape, points[i, 0], points[i, 1], points[i, 2])
        total += ((away * cosine - along * sine - shape[6]) * weight[i]) ** 2
    return total


@kernel('float64[::1](float64[::1], int64[::1], float64[:, ::1], float64[::1])')
def least_squares(shape, freedoms, points, weight):
    """Return the shape (8,) of least weighted squares, by Levenberg and Marquardt's method."""
    damping, before = _FIRST_DAMPING, weighted_square(shape, points, weight)
    frame = frame_of(shape)
    matrix, vector = normal_equations(shape, freedoms, points, weight, frame)
    for _ in range(_MOST_STEPS):
        damped, steps = matrix.copy(), np.zeros(7)
        for k in range(len(freedoms)):
            damped[k, k] *= 1 + damping
        way = solved(damped, vector)
        for k in range(len(freedoms)):
            steps[freedoms[k]] = -way[k]
        other = moved(shape, steps, frame)
        after = weighted_square(other, points, weight)
        if not after < before:  # NaN is no improvement either
            damping *= _DAMPING_STEP
            continue
        shape, damping = other, damping / _DAMPING_STEP
        if before - after < _TOLERANCE * before:
            break
        before, frame = after, frame_of(shape)
        matrix, vector = normal_equations(shape, freedoms, points, weight, frame)
    return shape


@kernel('Tuple((float64[::1], float64[:, ::1]))(float64[::1], int64[::1], float64[:, ::1], '
        'float64[:, ::1])')
def fitted(shape, freedoms, points, noise):
    """
    Return a shape (8,), fitted to points (N, 3), and its information (F, F); outliers cut off.

    NaN if too few points agree with it.
    """
    weight = np.empty(0)
    for _ in range(_ROUNDS):
        distance, deviation = distances_deviations(shape, points, noise)
        weight = np.where(np.abs(distance) < 2 * DEVIATIONS * deviation, 1 / deviation, 0.0)
        if (weight > 0).sum() < 4 * len(freedoms):
            return np.full(8, np.nan), np.zeros((1, 1))
        shape = least_squares(shape, freedoms, points, weight)
    return shape, normal_equations(shape, freedoms, points, weight, frame_of(shape))[0]


@kernel('float64[::1](float64[:, ::1], float64[:, ::1])')
def off_best_plane(points, noise):
    """Return how many deviations (N,) points lie off their plane, fitted in 1/z, where affine."""
    matrix, vector, ray = np.zeros((3, 3)), np.zeros(3), np.ones(3)
    result = np.empty(len(points))
    for i in range(len(points)):
        ray[0], ray[1] = points[i, 0] / points[i, 2], points[i, 1] / points[i, 2]
        weight = (points[i, 2] ** 2 / noise[i, 0]) ** 2
        for j in range(3):
            vector[j] += weight * ray[j] / points[i, 2]
            for k in range(3):
                matrix[j, k] += weight * ray[j] * ray[k]
    plane = solved(matrix, vector)
    for i in range(len(points)):
        value = (points[i, 0] * plane[0] + points[i, 1] * plane[1]) / points[i, 2] + plane[2]
        result[i] = (value - 1 / points[i, 2]) * points[i, 2] ** 2 / noise[i, 0]
    return result
