# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Least-squares fit of shapes to pixels, and its quality."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.shapes.fitting import (
    distances_deviations,
    fitted,
    plane_misfit,
    shape_misfit,
    solved,
)
from plane_detector.shapes.models import HALF_ANGLE, RADIUS, ShapeModel, surface_of
from plane_detector.shapes.surface import DEVIATIONS
from plane_detector.types import Plane

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
