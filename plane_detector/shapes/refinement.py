# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes fitted to pixels by least squares, and how well they explain them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.shapes.fitting import distances_deviations, fitted, off_best_plane
from plane_detector.shapes.models import HALF_ANGLE, RADIUS, ShapeModel
from plane_detector.shapes.surface import DEVIATIONS
from plane_detector.types import Plane


@dataclass(frozen=True)
class Pixels:
    """
    Points of pixels.

    Attributes
    ----------
    points_m : (N, 3) float64
    noise_m : (N, 2) float64
        Deviation of the depth, and side of a pixel at the depth of the point.
    independent : float
        As many pixels of independent noise would be as good: noise is smooth over some of them.

    """

    points_m: np.ndarray
    noise_m: np.ndarray
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
    """
    Fit a shape to pixels by least squares, outliers cut off.

    Returns
    -------
    FittedShape or None
        None if too few pixels agree with it.

    """
    shape, information = fitted(shape, np.array(model.freedoms), pixels.points_m, pixels.noise_m)
    if not np.isfinite(shape).all():
        return None
    share = pixels.independent / len(pixels.points_m)
    cost = criterion(shape_residuals(shape, pixels), len(model.freedoms), pixels.independent)
    return FittedShape(model, shape, information * share, cost)


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
    """Return the criterion of the least-squares plane."""
    return criterion(off_best_plane(pixels.points_m, pixels.noise_m), 3, pixels.independent)
