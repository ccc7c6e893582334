# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares of shapes and planes on points with noise along their rays, and their comparison.

Rays along the silhouette are tangent to the shape, whatever the noise of the depth. Each is
represented by its point closest to the surface. The distance is minimal there, so its derivatives
are the same as for a fixed point.

References
----------
D. Marquardt: An Algorithm for Least-Squares Estimation of Nonlinear Parameters, 1963.

"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.shapes.surface import (
    DEVIATIONS,
    FREEDOMS,
    HALF_ANGLE,
    RADIUS,
    TINY,
    about_axis,
    distance_deviation,
    frame_of,
    moved,
    nearest_on_ray,
    surface_of,
    turn_of,
)
from plane_detector.types import Plane, ShapeType

# Number of times that a shape is fitted and its inliers selected.
_ROUNDS = 2
_MOST_STEPS = 12
# chosen: for a sum of 500 squares, a twentieth of one standard deviation.
_TOLERANCE = 1e-4
# after: Marquardt 1963, ten times more damping after a bad step, ten times less after a good one.
_FIRST_DAMPING, _DAMPING_STEP = 1e-3, 10.0
# The silhouette is searched for within three deviations of the fit to the depth, but at most this
# far away.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 to 1.4 times.
_MOST_SLACK_PX = 12.0
# chosen: the smallest shape, a thousandth of 640 x 480 pixels, has twice as many around it.
# Sensors that measure nothing next to an edge provide only a few rays, at arbitrary positions.
_MIN_RAYS = 30
# A shape is rejected if its size is less certain than this, by the covariance of the fit.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 to 1.4 times.
_MAX_RADIUS_ERROR_SHARE, _MAX_ANGLE_ERROR_RAD = 0.25, np.radians(12.0)


@dataclass(frozen=True)
class Pixels:
    """Points of pixels, and the equivalent number of pixels with independent noise."""

    points_m: np.ndarray  # (N, 3) float64
    noise_m: np.ndarray  # (N, 2) float64: deviation of the depth, side of a pixel at this depth
    independent: float  # less than N if the noise is smooth


@dataclass(frozen=True)
class Silhouette:
    """Rays between a surface and a background far behind it."""

    rays: np.ndarray  # (M, 4) float64: x, y at depth 1, depth of the nearer pixel, its deviation
    pixel: float  # side of a pixel at depth 1


NO_SILHOUETTE = Silhouette(np.zeros((0, 4)), 0.0)


@dataclass(frozen=True)
class FittedShape:
    """A shape after least squares."""

    type: ShapeType
    shape: np.ndarray  # (8,) float64
    information: np.ndarray  # (F, F) float64, of the parameters in the order of `FREEDOMS`
    cost: float  # Bayesian information criterion on the pixels used for the choice

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the fitted parameters, (F, F) float64."""
        return np.linalg.pinv(self.information)

    @cached_property
    def size_sigma(self) -> float:
        """Standard deviation of the radius, metres, or of the half angle, radians."""
        try:
            variance = np.linalg.inv(self.information)[-1, -1]
        except np.linalg.LinAlgError:
            return np.inf
        return float(np.sqrt(variance)) if variance > 0 else np.inf

    @property
    def is_determined(self) -> bool:
        """Whether the size is certain enough."""
        if self.shape[HALF_ANGLE]:
            return self.size_sigma < _MAX_ANGLE_ERROR_RAD
        return self.size_sigma < _MAX_RADIUS_ERROR_SHARE * self.shape[RADIUS]


def fit_shape(kind: ShapeType, start: np.ndarray, pixels: Pixels,
              silhouette: Silhouette = NO_SILHOUETTE, slack_px: float = 0.0) -> FittedShape | None:
    """
    Fit a shape to pixels and rays by least squares without outliers; None if too few agree.

    ``slack_px`` is the largest error of the rays at the start.
    """
    shape, freedoms = start, FREEDOMS[kind]
    share = math.sqrt(pixels.independent / len(pixels.points_m))
    for _ in range(_ROUNDS):
        distance_m, deviation_m = distances_deviations(shape, pixels.points_m, pixels.noise_m)
        agree = np.abs(distance_m) < 2 * DEVIATIONS * deviation_m
        if agree.sum() < 4 * len(freedoms):
            return None
        of_rays = weights_of_rays(shape, silhouette.rays, silhouette.pixel, slack_px)
        weight = np.concatenate((share / deviation_m[agree], of_rays[of_rays > 0]))
        shape, information = least_squares(shape, freedoms, pixels.points_m[agree],
                                           silhouette.rays[of_rays > 0], weight)
        slack_px = DEVIATIONS
    cost = criterion(shape_misfit(shape, pixels), len(freedoms), pixels.independent)
    return FittedShape(kind, shape, information, cost)


def fit_silhouette(alone: FittedShape, pixels: Pixels, silhouette: Silhouette) -> FittedShape:
    """Return a shape fitted to its pixels and, if visible, to its silhouette as well."""
    if len(silhouette.rays) < _MIN_RAYS:
        return alone
    lever_m = 1.0
    if not alone.shape[RADIUS]:
        lever_m = float(surface_of(alone.shape, pixels.points_m).along_m.mean())
    uncertain_px = alone.size_sigma * lever_m / float(pixels.noise_m[:, 1].mean())
    slack_px = min(DEVIATIONS * (1 + uncertain_px), _MOST_SLACK_PX)
    both = fit_shape(alone.type, alone.shape, pixels, silhouette, slack_px)
    # A silhouette that contradicts the depth by three deviations belongs to something else.
    return both if both and both.cost < alone.cost + DEVIATIONS**2 else alone


def shape_residuals(shape: np.ndarray, pixels: Pixels) -> np.ndarray:
    """Return the distances (N,) from a shape (8,) in standard deviations."""
    distance_m, deviation_m = distances_deviations(shape, pixels.points_m, pixels.noise_m)
    return distance_m / deviation_m


def plane_residuals(plane: Plane, pixels: Pixels) -> np.ndarray:
    """Return the distances (N,) from a plane in standard deviations."""
    along_normal_m = pixels.points_m @ plane.normal
    facing = np.maximum(np.abs(along_normal_m) / pixels.points_m[:, 2], 1e-6)
    return (along_normal_m + plane.offset_m) / (facing * pixels.noise_m[:, 0])


def limited_square(residual: np.ndarray) -> float:
    """Return the mean squared residual, each limited to that of an outlier; 0 for none."""
    return float(np.minimum(residual**2, DEVIATIONS**2).sum() / max(len(residual), 1))


def shape_misfit(shape: np.ndarray, pixels: Pixels) -> float:
    """Return the misfit of a shape (8,)."""
    return limited_square(shape_residuals(shape, pixels))


def plane_misfit(pixels: Pixels) -> float:
    """Return the misfit of the best plane, fitted to 1/z."""
    z = pixels.points_m[:, 2]
    weight = z**2 / pixels.noise_m[:, 0]
    system = pixels.points_m * (weight / z)[:, None]
    square = system.T @ system
    square += 1e-12 * np.trace(square) * np.eye(3) + 1e-300  # few points determine no plane
    plane = np.linalg.solve(square, system.T @ (weight / z))
    return limited_square(system @ plane - weight / z)


def criterion(misfit: float, freedoms: int, independent: float) -> float:
    """Return the Bayesian information criterion of a misfit, for independent pixels."""
    return misfit * independent + freedoms * math.log(independent + 1)


def explained_share(fit: FittedShape, pixels: Pixels) -> float:
    """Return the share of the pixels that lie on a shape within the noise."""
    inside = np.abs(shape_residuals(fit.shape, pixels)) < DEVIATIONS
    return float(inside.mean()) if len(inside) else 0.0


@kernel('Tuple((float64[::1], float64[::1]))(float64[::1], float64[:, ::1], float64[:, ::1])')
def distances_deviations(shape, points, noise):
    """Return distances (N,) of points (N, 3) from a shape and their deviations (N,)."""
    turn = turn_of(shape)
    distance, deviation = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        distance[i], deviation[i] = distance_deviation(
            shape, turn, (points[i, 0], points[i, 1], points[i, 2]), (noise[i, 0], noise[i, 1]))
    return distance, deviation


@kernel('float64[::1](float64[::1], float64[:, ::1], float64, float64)')
def weights_of_rays(shape, rays, pixel, slack_px):
    """
    Return the weights of rays (M, 4) on a shape, 1 / side of a pixel.

    The weight is 0 if a ray is farther off than the slack, or its pixel is behind the silhouette.
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
        'float64[:, ::1], float64[::1])')
def linearized(shape, freedoms, points, rays, weight):
    """
    Return the weighted distances of points (N, 3) and rays (M, 4), and their derivatives.

    Distances are (N + M,), derivatives (F, N + M) by the steps of :func:`moved`.
    """
    cosine, sine = turn_of(shape)
    frame, row, count = frame_of(shape), np.empty(7), len(points)
    distance, slope = np.empty(len(weight)), np.empty((len(freedoms), len(weight)))
    for i in range(len(weight)):
        if i < count:
            p_x, p_y, p_z = points[i, 0], points[i, 1], points[i, 2]
        else:
            ray = rays[i - count]
            p_z = nearest_on_ray(shape, (cosine, sine), ray[0], ray[1])
            p_x, p_y = ray[0] * p_z, ray[1] * p_z
        along, away, x, y, z = about_axis(shape, p_x, p_y, p_z)
        distance[i] = (away * cosine - along * sine - shape[6]) * weight[i]
        n_x, n_y = cosine * x - sine * shape[3], cosine * y - sine * shape[4]
        n_z = cosine * z - sine * shape[5]
        # Rotating the axis changes both the position along it and the distance from it.
        lever = along * cosine + away * sine
        for k in range(3):
            row[k] = -(n_x * frame[k, 0] + n_y * frame[k, 1] + n_z * frame[k, 2])
        for k in range(2):
            row[3 + k] = -lever * (x * frame[k, 0] + y * frame[k, 1] + z * frame[k, 2])
        row[5] = -1.0
        row[6] = -(away * sine + along * cosine)
        for k in range(len(freedoms)):
            slope[k, i] = row[freedoms[k]] * weight[i]
    return distance, slope


@kernel('Tuple((float64[::1], float64[:, ::1]))(float64[::1], int64[::1], float64[:, ::1], '
        'float64[:, ::1], float64[::1])')
def least_squares(shape, freedoms, points, rays, weight):
    """
    Return the least-squares shape (8,) and its information (F, F), by Levenberg and Marquardt.

    Scipy's version gives the same shapes in three times the time, mostly overhead of the calls for
    a few hundred points.
    """
    damping, (distance, slope) = _FIRST_DAMPING, linearized(shape, freedoms, points, rays, weight)
    before = (distance * distance).sum()
    for _ in range(_MOST_STEPS):
        square, steps = slope @ slope.T, np.zeros(7)
        least = TINY * np.trace(square)  # otherwise parameters without any effect have no solution
        for k in range(len(freedoms)):
            square[k, k] += damping * square[k, k] + least
        way = np.linalg.solve(square, slope @ distance)
        for k in range(len(freedoms)):
            steps[freedoms[k]] = -way[k]
        other = moved(shape, steps, frame_of(shape))
        distance_then, slope_then = linearized(other, freedoms, points, rays, weight)
        after = (distance_then * distance_then).sum()
        if not after < before:  # also if it is NaN
            damping *= _DAMPING_STEP
            continue
        shape, distance, slope, damping = other, distance_then, slope_then, damping / _DAMPING_STEP
        gain, before = before - after, after
        if gain < _TOLERANCE * before:
            break
    return shape, slope @ slope.T
