# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells weighted by their noise, and the planes found on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid, N
from plane_detector.segmentation.cells.noise import CellVariances, Noise, cell_variances
from plane_detector.segmentation.cells.plane_fit import fit_planes

# A cell whose pixels deviate from its own plane by more than two sigma straddles an edge.
# tuned: benchmark sensitivity; flat to 1.4 times; at 0.7 times recall -0.011.
MAX_INNER_VARIANCES = 4.0
# Cells without depth have no variance at all.
MIN_VARIANCE = 1e-30


@dataclass(frozen=True)
class WeightedCells:
    """
    The cells and their noise.

    Attributes
    ----------
    grid : CellGrid
    variances : CellVariances
    is_planar : (R * C,) bool
        The cell lies on one plane.
    table : (R * C, 7) float64
        Mean x, y and d, slope along x and y, inverse variances of mean and slope: what
        :func:`chi_squared` needs.

    """

    grid: CellGrid
    variances: CellVariances
    is_planar: np.ndarray
    table: np.ndarray


@dataclass(frozen=True)
class PlaneRegions:
    """
    Planes found on the cells.

    Attributes
    ----------
    labels : (R, C) int32
        Index into ``coefficients``, -1 none.
    coefficients : (K, 3) float64
        1/z = a x + b y + c.

    """

    labels: np.ndarray
    coefficients: np.ndarray


def weigh_cells(grid: CellGrid, noise: Noise) -> WeightedCells:
    """Weigh each cell by the noise that it is tested with."""
    variances = cell_variances(grid, noise)
    is_planar = grid.usable & (grid.inner_rms**2 < MAX_INNER_VARIANCES * variances.pixel)
    weights = [1 / np.maximum(v, MIN_VARIANCE) for v in (variances.mean, variances.slope)]
    table = np.column_stack([grid.mean, grid.slope, *weights])
    return WeightedCells(grid, variances, is_planar, table)


@kernel('float64(float64[:, ::1], int64, float64, float64, float64)')
def chi_squared(table, i, a, b, c):
    """
    Return the chi-squared misfit of cell i to the plane d = a x + b y + c.

    The squared residual of the cell's mean disparity over its variance, plus the same of its
    slope: a cell that crosses the plane at an angle does not fit it, however near it is.
    """
    residual = table[i, 2] - (a * table[i, 0] + b * table[i, 1] + c)
    tilt_x, tilt_y = table[i, 3] - a, table[i, 4] - b
    return (residual * residual * table[i, 5]
            + (tilt_x * tilt_x + tilt_y * tilt_y) * table[i, 6])


def region_moments(cells: WeightedCells, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the moments (K, 10) of the pixels of each region's planar cells."""
    return add_up(cells.grid.moments, np.ascontiguousarray(labels).reshape(-1), cells.is_planar,
                  count)


@kernel('float64[:, ::1](float64[:, ::1], int32[::1], boolean[::1], int64)')
def add_up(values, labels, is_used, count):
    """Add up the rows of values (n, m) of each label among the used ones, (count, m)."""
    total = np.zeros((count, values.shape[1]))
    for i in range(len(labels)):
        if is_used[i] and labels[i] >= 0:
            for k in range(values.shape[1]):
                total[labels[i], k] += values[i, k]
    return total


def fit_regions(cells: WeightedCells, labels: np.ndarray, count: int,
                min_pixels: float = 1.0) -> PlaneRegions:
    """Fit planes to labels (R, C) int32; drop labels with too few planar pixels or on a line."""
    moments = region_moments(cells, labels, count)
    planes = fit_planes(moments)
    kept = np.flatnonzero((moments[:, N] >= max(min_pixels, 1)) & np.isfinite(planes[:, 0]))
    index = np.full(count + 1, -1, np.int32)
    index[kept] = np.arange(len(kept))
    return PlaneRegions(index[labels], planes[kept])


@kernel('boolean(float64[:, ::1], int64)')
def has_no_depth(table, i):
    """Say whether no pixel of cell i is valid."""
    return table[i, 0] == 0 and table[i, 1] == 0 and table[i, 2] == 0
