# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells weighed by their noise, and the planes found on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.noise import CellVariances, Noise, cell_variances

# A cell whose pixels stray from its own plane more than this many variances straddles an edge.
MAX_INNER_VARIANCES = 4.0
# Cells without depth have no variance at all.
MIN_VARIANCE = 1e-30


@dataclass(frozen=True)
class CellModel:
    """
    The cells with what is known of their noise.

    Attributes
    ----------
    grid : CellGrid
    variances : CellVariances
    planar : (R * C,) bool
        The cell lies on one plane.
    quadratic : (R * C, 10) float64
        Its product with :func:`monomials` of planes is :func:`chi_squared`.

    """

    grid: CellGrid
    variances: CellVariances
    planar: np.ndarray
    quadratic: np.ndarray


@dataclass(frozen=True)
class Patches:
    """
    Planes found on the cells.

    Attributes
    ----------
    labels : (R, C) int32
        Index into ``planes``, -1 none.
    planes : (K, 3) float64
        1/z = a x + b y + c.

    """

    labels: np.ndarray
    planes: np.ndarray


def make_model(grid: CellGrid, noise: Noise) -> CellModel:
    """Weigh each cell by the noise that it is tested with."""
    variances = cell_variances(grid, noise)
    planar = grid.usable & (grid.inner_rms**2 < MAX_INNER_VARIANCES * variances.grain)
    x, y, d = grid.mean.T
    slope_x, slope_y = grid.slope.T
    w, s = (1 / np.maximum(v, MIN_VARIANCE) for v in (variances.mean, variances.slope))
    quadratic = np.array([
        w * x * x + s, 2 * w * x * y, w * y * y + s, 2 * w * x, 2 * w * y, w,
        -2 * (w * x * d + s * slope_x), -2 * (w * y * d + s * slope_y), -2 * w * d,
        w * d * d + s * (slope_x**2 + slope_y**2)]).T
    return CellModel(grid, variances, planar, quadratic)


def monomials(planes: np.ndarray) -> np.ndarray:
    """Return the products of the coefficients of planes (K, 3) that the score needs, (10, K)."""
    a, b, c = planes.T
    return np.array([a * a, a * b, b * b, a * c, b * c, c * c, a, b, c, np.ones(np.shape(a))])


def chi_squared(model: CellModel, planes: np.ndarray) -> np.ndarray:
    """
    Return how ill each plane fits each cell, (R * C, K); (R * C,) for one plane (3,).

    The squared residual of the cell's mean disparity over its variance, plus the same of its
    slope: what crosses a plane at an angle is no part of it, however near.
    """
    return model.quadratic @ monomials(planes)
