# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes fitted to pixels by least squares, and which kind explains them best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import leastsq

from plane_detector.shapes.models import (
    HALF_ANGLE,
    RADIUS,
    ShapeModel,
    frame_of,
)
from plane_detector.shapes.surface import (
    distances_deviations,
    stepped,
    stepped_distances,
    stepped_jacobian,
    weighted_jacobian,
)
from plane_detector.shapes.surfels import DEVIATIONS
from plane_detector.types import Plane

# A shape is fitted, then its inliers are chosen anew.
_ROUNDS = 2
# Bounds of the time of a fit.
MOST_PIXELS = 500
_MOST_EVALUATIONS = 12
# derived: of a sum of 500 squares that is a twentieth of one deviation.
_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Pixels:
    """
    Points of pixels (N, 3), their rays of depth 1 and the deviation of their depth (N,).

    Attributes
    ----------
    points_m, rays : (N, 3) float64
    depth_sigma_m : (N,) float64
    pixel_m : (N,) float64
        Side of a pixel at the depth of the point.
    independent : float
        As many pixels of independent noise would be as good: noise is smooth over some of them.

    """

    points_m: np.ndarray
    rays: np.ndarray
    depth_sigma_m: np.ndarray
    pixel_m: np.ndarray
    independent: float


@dataclass(frozen=True)
class FittedShape:
    """
    A shape after least squares.

    Attributes
    ----------
    model : ShapeModel
    shape : (8,) float64
    information : (F, F) float64
        Of the model's freedoms.
    cost : float
        Bayesian information criterion on the pixels that it was chosen by; less is better.

    """

    model: ShapeModel
    shape: np.ndarray
    information: np.ndarray
    cost: float

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the model's freedoms, (F, F) float64."""
        return np.linalg.pinv(self.information)


def sigma_m(fit: FittedShape, pixels: Pixels) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the distances (N,) of points from a shape and their standard deviations (N,).

    A point moves along its ray; towards the silhouette that changes its distance less and less,
    and the side of the pixel is what remains.
    """
    return _distances(fit.shape, pixels)


def explained_share(fit: FittedShape, pixels: Pixels) -> float:
    """Return the share of the pixels that lie on a shape within the noise."""
    inside = np.abs(shape_residuals(fit, pixels)) < DEVIATIONS
    return float(inside.mean()) if len(inside) else 0.0


def shape_residuals(fit: FittedShape, pixels: Pixels) -> np.ndarray:
    """Return the distances (N,) from a shape in standard deviations."""
    distance_m, deviation_m = sigma_m(fit, pixels)
    return distance_m / deviation_m


def plane_residuals(plane: Plane, pixels: Pixels) -> np.ndarray:
    """Return the distances (N,) from a plane in standard deviations."""
    facing = np.maximum(np.abs(pixels.rays @ plane.normal), 1e-6)
    return (pixels.points_m @ plane.normal + plane.offset_m) / (facing * pixels.depth_sigma_m)


def _distances(shape: np.ndarray, pixels: Pixels) -> tuple[np.ndarray, np.ndarray]:
    return distances_deviations(shape, pixels.points_m, pixels.rays, pixels.depth_sigma_m,
                                pixels.pixel_m)


def fit_shape(model: ShapeModel, shape: np.ndarray, pixels: Pixels) -> FittedShape | None:
    """
    Fit a shape to pixels by Levenberg and Marquardt's method (scipy), outliers cut off.

    Returns
    -------
    FittedShape or None
        None if too few pixels agree with it.

    """
    for _ in range(_ROUNDS):
        distance_m, deviation_m = _distances(shape, pixels)
        inlier = np.abs(distance_m) < 2 * DEVIATIONS * deviation_m
        if inlier.sum() < 4 * len(model.freedoms):
            return None
        points_m, weight = pixels.points_m[inlier], 1 / deviation_m[inlier]
        shape = _least_squares(model, shape, points_m, weight)
        if not np.isfinite(shape).all():
            return None
    design = weighted_jacobian(shape, points_m, weight, frame_of(shape))[list(model.freedoms)]
    information = design @ design.T * pixels.independent / len(pixels.points_m)
    distance_m, deviation_m = _distances(shape, pixels)
    cost = criterion(distance_m / deviation_m, len(model.freedoms), pixels.independent)
    return FittedShape(model, shape, information, cost)


def _least_squares(model: ShapeModel, start: np.ndarray, points_m: np.ndarray,
                   weight: np.ndarray) -> np.ndarray:
    """Return the shape (8,) with the least weighted squared distances from points (N, 3)."""
    freedoms = np.array(model.freedoms)
    about = freedoms, start, frame_of(start), points_m, weight
    # Machine code without the step through Kernel, for there are many calls.
    found = leastsq(stepped_distances.compiled(), np.zeros(len(freedoms)), about,
                    stepped_jacobian.compiled(), full_output=True, col_deriv=True,
                    ftol=_TOLERANCE, xtol=_TOLERANCE, maxfev=_MOST_EVALUATIONS)
    return stepped(found[0], freedoms, start, about[2])


def fits_of(candidates: Sequence[tuple[ShapeModel, np.ndarray]],
            pixels: Pixels) -> list[FittedShape]:
    """Return the candidates, fitted to pixels; those that fit too few are left out."""
    fits = (fit_shape(model, shape, pixels) for model, shape in candidates)
    return [fit for fit in fits if fit is not None]


def is_determined(fit: FittedShape, max_radius_share: float, max_angle_rad: float) -> bool:
    """Say whether the size of a shape is known well enough for it to be one."""
    size_sigma = float(np.sqrt(fit.covariance[-1, -1]))
    if fit.shape[HALF_ANGLE]:
        return size_sigma < max_angle_rad
    return size_sigma < max_radius_share * fit.shape[RADIUS]


def criterion(residual: np.ndarray, freedoms: int, independent: float) -> float:
    """
    Return the Bayesian information criterion of residuals (N,) in standard deviations.

    They stand for so many independent ones. A residual counts for no more than an outlier.
    """
    truncated = float(np.minimum(residual**2, DEVIATIONS**2).mean())
    return truncated * independent + freedoms * float(np.log(independent + 1))


def plane_cost(pixels: Pixels) -> float:
    """Return the criterion of the least-squares plane, fitted in 1/z, where it is affine."""
    disparity = 1 / pixels.points_m[:, 2]
    sigma = pixels.depth_sigma_m * disparity**2
    weighted = pixels.rays / np.square(sigma)[:, None]
    coefficients = np.linalg.pinv(pixels.rays.T @ weighted) @ (weighted.T @ disparity)
    return criterion((pixels.rays @ coefficients - disparity) / sigma, 3,
                     pixels.independent)
