# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled least squares: shapes and planes fitted to points with noise along their rays.

Rays along the silhouette touch the shape, whatever the noise of the depth. Each is represented by
its point closest to the surface. The distance is minimal there, so its derivatives are the same as
for any other point.

A test verifies that scipy's Levenberg-Marquardt gives the same shapes; it is slower, because most
of its time is the overhead of calls for a few hundred points.

References
----------
D. Marquardt: An Algorithm for Least-Squares Estimation of Nonlinear Parameters, 1963.

"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.models import HALF_ANGLE, RADIUS, ShapeModel, surface_of
from plane_detector.shapes.surface import (
    DEVIATIONS,
    about_axis,
    distance_deviation,
    frame_of,
    moved,
    nearest_on_ray,
    turn_of,
)
from plane_detector.types import Plane

# Number of times that a shape is fitted and its inliers selected.
_ROUNDS = 2
_MOST_STEPS = 12
# derived: for a sum of 500 squares, a twentieth of one standard deviation.
_TOLERANCE = 1e-4
# after: Marquardt 1963, ten times more damping after a bad step, ten times less after a good one.
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
    """Return the solution (F,) of a positive definite system by Cholesky's method, or NaN."""
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
    """Return the distance of a point (3,); write its derivatives for ``moved`` (7,)."""
    cosine, sine = turn
    along, away, x, y, z = about_axis(shape, point[0], point[1], point[2])
    n_x, n_y = cosine * x - sine * shape[3], cosine * y - sine * shape[4]
    n_z = cosine * z - sine * shape[5]
    # Rotating the axis changes both the position along it and the distance from it.
    lever = along * cosine + away * sine
    for k in range(3):
        result[k] = -(n_x * frame[k, 0] + n_y * frame[k, 1] + n_z * frame[k, 2])
    for k in range(2):
        result[3 + k] = -lever * (x * frame[k, 0] + y * frame[k, 1] + z * frame[k, 2])
    result[5] = -1.0
    result[6] = -(away * sine + along * cosine)
    return away * cosine - along * sine - shape[6]


@kernel('float64[:, ::1](float64[::1], float64[:, ::1], float64[:, ::1])')
def touching(shape, points, rays):
    """Return the points (N, 3) and the points of rays (M, 4) closest to a shape, (N + M, 3)."""
    turn, result = turn_of(shape), np.empty((len(points) + len(rays), 3))
    result[:len(points)] = points
    for i in range(len(rays)):
        z = nearest_on_ray(shape, turn, rays[i, 0], rays[i, 1])
        result[len(points) + i] = np.array([rays[i, 0] * z, rays[i, 1] * z, z])
    return result


@kernel('Tuple((float64[:, ::1], float64[::1]))(float64[::1], int64[::1], float64[:, ::1], '
        'float64[::1])')
def normal_equations(shape, freedoms, points, weight):
    """Return J'J (F, F) and J'r (F,) of the weighted distances r of points (N, 3)."""
    turn, count, frame = turn_of(shape), len(freedoms), frame_of(shape)
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


@kernel('float64[::1](float64[::1], int64[::1], float64[:, ::1], float64[:, ::1], float64[::1])')
def least_squares(shape, freedoms, points, rays, weight):
    """
    Return the least-squares shape (8,) by the method of Levenberg and Marquardt.

    The residuals are the weighted distances of points (N, 3) and touching rays (M, 4).
    """
    damping, places = _FIRST_DAMPING, touching(shape, points, rays)
    before = weighted_square(shape, places, weight)
    matrix, vector = normal_equations(shape, freedoms, places, weight)
    for _ in range(_MOST_STEPS):
        damped, steps = matrix.copy(), np.zeros(7)
        for k in range(len(freedoms)):
            damped[k, k] *= 1 + damping
        way = solved(damped, vector)
        for k in range(len(freedoms)):
            steps[freedoms[k]] = -way[k]
        other = moved(shape, steps, frame_of(shape))
        places = touching(other, points, rays)
        after = weighted_square(other, places, weight)
        if not after < before:  # also if it is NaN
            damping *= _DAMPING_STEP
            continue
        shape, damping = other, damping / _DAMPING_STEP
        if before - after < _TOLERANCE * before:
            break
        before = after
        matrix, vector = normal_equations(shape, freedoms, places, weight)
    return shape


@kernel('float64[::1](float64[::1], float64[:, ::1], float64, float64)')
def weights_of_rays(shape, rays, pixel, slack_px):
    """
    Return the weights of rays (M, 4) on a shape, 1 / side of a pixel.

    The weight is 0 if a ray is further off than the slack, or its pixel is behind the silhouette.
    """
    turn, weight = turn_of(shape), np.zeros(len(rays))
    for i in range(len(rays)):
        z = nearest_on_ray(shape, turn, rays[i, 0], rays[i, 1])
        along, away, _, _, _ = about_axis(shape, rays[i, 0] * z, rays[i, 1] * z, z)
        distance = away * turn[0] - along * turn[1] - shape[6]
        if (z > 0 and along * turn[1] >= 0 and abs(distance) < slack_px * pixel * z
                and abs(rays[i, 2] - z) < DEVIATIONS * rays[i, 3] + away):
            weight[i] = 1 / (pixel * z)
    return weight


@kernel('Tuple((float64[::1], float64[:, ::1]))(float64[::1], int64[::1], float64[:, ::1], '
        'float64[:, ::1], float64[:, ::1], UniTuple(float64, 3))')
def fitted(shape, freedoms, points, noise, rays, trust):
    """
    Return a shape (8,), fitted to points and rays, and its information (F, F).

    Parameters
    ----------
    shape : (8,) float64
    freedoms : (F,) int64
    points : (N, 3) float64
        Outliers are rejected. If too few points agree, the shape is NaN.
    noise : (N, 2) float64
        Standard deviation of the depth, and side of the pixel at that depth.
    rays : (M, 4) float64
        Along the silhouette: x and y at depth 1, depth and deviation of the adjacent pixel.
    trust : (float, float, float)
        Share of independent points, side of a pixel at depth 1, and largest initial error of the
        rays in pixels.

    """
    weight, slack_px = np.empty(0), trust[2]
    for _ in range(_ROUNDS):
        distance, deviation = distances_deviations(shape, points, noise)
        agree = np.abs(distance) < 2 * DEVIATIONS * deviation
        if agree.sum() < 4 * len(freedoms):
            return np.full(8, np.nan), np.zeros((1, 1))
        weight = np.concatenate((np.where(agree, np.sqrt(trust[0]) / deviation, 0.0),
                                 weights_of_rays(shape, rays, trust[1], slack_px)))
        shape = least_squares(shape, freedoms, points, rays, weight)
        slack_px = DEVIATIONS
    return shape, normal_equations(shape, freedoms, touching(shape, points, rays), weight)[0]


@kernel('float64(float64[::1], float64[:, ::1], float64[:, ::1])')
def shape_misfit(shape, points, noise):
    """Return the mean squared distance of points in deviations, each limited to 9."""
    turn, total = turn_of(shape), 0.0
    for i in range(len(points)):
        distance, deviation = distance_deviation(
            shape, turn, (points[i, 0], points[i, 1], points[i, 2]), (noise[i, 0], noise[i, 1]))
        total += min((distance / deviation) ** 2, DEVIATIONS**2)
    return total / max(len(points), 1)


@kernel('float64(float64[:, ::1], float64[:, ::1])')
def plane_misfit(points, noise):
    """Return the same for the best plane of points (N, 3), fitted to 1/z."""
    matrix, vector, ray, total = np.zeros((3, 3)), np.zeros(3), np.ones(3), 0.0
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
        off = (value - 1 / points[i, 2]) * points[i, 2] ** 2 / noise[i, 0]
        total += min(off * off, DEVIATIONS**2)
    return total / max(len(points), 1)


# The silhouette is searched for within three deviations of the fit to the depth, but at most this
# far away.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 to 1.4 times.
_MOST_SLACK_PX = 12.0
# derived: the smallest shape, a thousandth of 640 x 480 pixels, has twice as many around it.
# Sensors that measure nothing next to an edge give only a few rays, at arbitrary positions.
_MIN_RAYS = 30
_NO_RAYS = np.zeros((0, 4))


@dataclass(frozen=True)
class Pixels:
    """
    Points of pixels.

    Attributes
    ----------
    points_m : (N, 3) float64
    noise_m : (N, 2) float64
        Standard deviation of the depth, and side of a pixel at the depth of the point.
    independent : float
        Equivalent number of pixels with independent noise, which is less if the noise is smooth.

    """

    points_m: np.ndarray
    noise_m: np.ndarray
    independent: float


@dataclass(frozen=True)
class Silhouette:
    """
    Rays between a surface and a background far behind it.

    Attributes
    ----------
    rays : (M, 4) float64
        x and y at depth 1, depth of the nearer pixel and its deviation.
    pixel : float
        Side of a pixel at depth 1.

    """

    rays: np.ndarray
    pixel: float


@dataclass(frozen=True)
class FittedShape:
    """
    A shape after least squares.

    Attributes
    ----------
    model : ShapeModel
    shape : (8,) float64
    information : (F, F) float64
        Of the fitted parameters.
    cost : float
        Bayesian information criterion on the pixels used for the choice; lower is better.

    """

    model: ShapeModel
    shape: np.ndarray
    information: np.ndarray
    cost: float

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the fitted parameters, (F, F) float64."""
        return np.linalg.pinv(self.information)


def explained_share(fit: FittedShape, pixels: Pixels) -> float:
    """Return the share of the pixels that lie on a shape within the noise."""
    inside = np.abs(shape_residuals(fit.shape, pixels)) < DEVIATIONS
    return float(inside.mean()) if len(inside) else 0.0


def shape_residuals(shape: np.ndarray, pixels: Pixels) -> np.ndarray:
    """Return the distances (N,) from a shape (8,) in standard deviations."""
    distance_m, deviation_m = distances_deviations(shape, pixels.points_m, pixels.noise_m)
    return distance_m / deviation_m


def plane_residuals(plane: Plane, pixels: Pixels) -> np.ndarray:
    """Return the distances (N,) from a plane in standard deviations."""
    along_normal_m = pixels.points_m @ plane.normal
    facing = np.maximum(np.abs(along_normal_m) / pixels.points_m[:, 2], 1e-6)
    return (along_normal_m + plane.offset_m) / (facing * pixels.noise_m[:, 0])


def fit_shape(model: ShapeModel, shape: np.ndarray, pixels: Pixels) -> FittedShape | None:
    """Fit a shape to pixels by least squares without outliers; None if too few pixels agree."""
    return _fit(model, shape, pixels, Silhouette(_NO_RAYS, 0.0), 0.0)


def fit_silhouette(alone: FittedShape, pixels: Pixels, silhouette: Silhouette) -> FittedShape:
    """Return a shape fitted to its pixels and, if visible, to its silhouette as well."""
    if len(silhouette.rays) < _MIN_RAYS:
        return alone
    lever_m = 1.0
    if not alone.shape[RADIUS]:
        lever_m = float(surface_of(alone.shape, pixels.points_m).along_m.mean())
    uncertain_px = size_sigma(alone) * lever_m / float(pixels.noise_m[:, 1].mean())
    slack_px = min(DEVIATIONS * (1 + uncertain_px), _MOST_SLACK_PX)
    both = _fit(alone.model, alone.shape, pixels, silhouette, slack_px)
    # A silhouette that contradicts the depth by three deviations belongs to something else.
    return both if both and both.cost < alone.cost + DEVIATIONS**2 else alone


def _fit(model: ShapeModel, start: np.ndarray, pixels: Pixels,
         silhouette: Silhouette, slack_px: float) -> FittedShape | None:
    freedoms, share = np.array(model.freedoms), pixels.independent / len(pixels.points_m)
    shape, information = fitted(start, freedoms, pixels.points_m, pixels.noise_m,
                                silhouette.rays, (share, silhouette.pixel, slack_px))
    if not np.isfinite(shape).all():
        return None
    misfit = shape_misfit(shape, pixels.points_m, pixels.noise_m)
    cost = criterion(misfit, len(freedoms), pixels.independent)
    return FittedShape(model, shape, information, cost)


def is_determined(fit: FittedShape, max_radius_share: float, max_angle_rad: float) -> bool:
    """Return whether the size of a shape is certain enough."""
    if fit.shape[HALF_ANGLE]:
        return size_sigma(fit) < max_angle_rad
    return size_sigma(fit) < max_radius_share * fit.shape[RADIUS]


def size_sigma(fit: FittedShape) -> float:
    """Return the standard deviation of the radius, metres, or of the half angle, radians."""
    last = np.eye(len(fit.information))[-1]
    variance = solved(fit.information, last)[-1]
    return float(np.sqrt(variance)) if np.isfinite(variance) else np.inf


def criterion(misfit: float, freedoms: int, independent: float) -> float:
    """Return the Bayesian information criterion of a misfit, for independent pixels."""
    return misfit * independent + freedoms * math.log(independent + 1)


def plane_cost(pixels: Pixels) -> float:
    """Return the criterion of the least-squares plane."""
    return criterion(plane_misfit(pixels.points_m, pixels.noise_m), 3, pixels.independent)


def is_flat(pixels: Pixels) -> bool:
    """Return whether the residuals of the least-squares plane are within the noise."""
    return plane_misfit(pixels.points_m, pixels.noise_m) <= 1.0
