# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
One plane or two: model selection for regions that lie within the noise of each other.

Smooth noise shifts whole regions, but it neither jumps nor bends sharply: from one cell to the
next it changes by far less than its standard deviation. Generalised least squares (Aitken 1936)
uses that: a likelihood-ratio test under correlated noise compares two planes with one plane on
the cells around the border.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import MIN_VARIANCE, WeightedCells
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import solve_least_squares
from plane_detector.segmentation.regions.region_graph import PLANE_TERMS

# Smooth noise hardly changes over so many cells: those up to this far around the smaller region
# are used, and depth steps are seen along as many.
# tuned: on rooms and lived-in rooms below seed 9000; flat from 2 to 4.
REACH_CELLS = 3
# Most cells used, nearest to the border first; the time grows with the cube.
# tuned: on rooms and lived-in rooms below seed 9000, flat from 64 to 256; with 128 hardly any
# picture frame on a wall is seen.
MAX_CELLS = 192
# Twice the gain in log-likelihood that blurred noise hardly ever reaches, times its power, 2:
# rougher noise contains more edges.
# tuned: rooms and lived-in rooms below seed 9000; flat from 0.85 times; at 0.7 times precision of
# rooms -0.02 at noise 0.01, at 1.4 times recall of lived-in rooms -0.015 at 0.004.
MIN_LOG_LIKELIHOOD_GAIN = 28.0


def prefer_two_planes(cells: WeightedCells, labels: np.ndarray, correlation: Correlation | None,
                      first: int, second: int) -> bool:
    """
    Return whether a step or a crease along the border separates two regions.

    Parameters
    ----------
    cells : WeightedCells
    labels : (R, C) int32
        Region of each cell, -1 none.
    correlation : Correlation or None
        If None, no regions are separated.
    first, second : int
        The regions.

    Returns
    -------
    bool
        False if the regions do not touch.

    """
    if correlation is None:
        return False
    cell, is_first = _cells_about(labels, cells.is_planar, (first, second))
    if min(np.count_nonzero(is_first), np.count_nonzero(~is_first)) <= PLANE_TERMS:
        return False
    gain = _gain(cells.table, cell, is_first, correlation.table)
    return bool(gain > MIN_LOG_LIKELIHOOD_GAIN / correlation.power)


def _cells_about(labels: np.ndarray, is_planar: np.ndarray,
                 pair: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells (n,) nearest to a border, and which of them are the first region's."""
    masks = [(labels == label).view(np.uint8) for label in pair]
    left, top, width, height = cv2.boundingRect(min(masks, key=cv2.countNonZero))
    box = tuple(slice(max(start - REACH_CELLS, 0), start + size + REACH_CELLS)
                for start, size in ((top, height), (left, width)))
    first, second = (mask[box] for mask in masks)
    cells = np.flatnonzero((first | second) & is_planar.reshape(labels.shape)[box])
    # The distance to their own region is 0.
    distance = np.maximum(_distance_to(first), _distance_to(second)).ravel()[cells]
    cells = cells[np.argsort(distance, kind='stable')[:MAX_CELLS]]
    numbers = np.arange(labels.size).reshape(labels.shape)
    return numbers[box].ravel()[cells], first.ravel()[cells] > 0


def _distance_to(mask: np.ndarray) -> np.ndarray:
    """Return the chessboard distance of each cell to the nearest 1 of a mask, float32."""
    return cv2.distanceTransform(mask ^ 1, cv2.DIST_C, 3)


# With MAX_CELLS it takes 0.23 ms and keeps the lock, as the node switches threads after 1 ms; with
# the usual number 0.03 ms.
@kernel('float64(float64[:, ::1], int64[::1], boolean[::1], float64[:, ::1])', is_short=True)
def _gain(table, cell, is_first, covariance):
    """Return twice the gain in log-likelihood of two planes over one."""
    products = _weighted_products(_covariance(cell, covariance), _design(table, cell, is_first))
    one = solve_least_squares(products, PLANE_TERMS, np.empty(7))
    return one - solve_least_squares(products, 2 * PLANE_TERMS, np.empty(7))


@kernel('float64[:, ::1](float64[:, ::1], int64[::1], boolean[::1])')
def _design(table, cell, is_first):
    """Return 1, x, y of all cells, the same of the first region, and d, (7, n)."""
    n, x, y, d = len(cell), 0.0, 0.0, 0.0
    for i in range(n):
        x += table[cell[i], 0] / n
        y += table[cell[i], 1] / n
        d += table[cell[i], 2] / n
    basis = np.zeros((7, n))
    for i in range(n):
        basis[0, i], basis[1, i] = 1.0, table[cell[i], 0] - x
        basis[2, i], basis[6, i] = table[cell[i], 1] - y, table[cell[i], 2] - d
        for k in range(3):
            basis[3 + k, i] = basis[k, i] if is_first[i] else 0.0
    return basis


@kernel('float32[:, ::1](int64[::1], float64[:, ::1])')
def _covariance(cell, covariance):
    """Return the lower triangle of the covariance (n, n) of cells."""
    n, columns = len(cell), covariance.shape[1]
    matrix = np.zeros((n, n), np.float32)
    row, column = cell // columns, cell % columns
    for i in range(n):
        for j in range(i + 1):
            matrix[i, j] = covariance[abs(row[i] - row[j]), abs(column[i] - column[j])]
    return matrix


@kernel('float64[:, ::1](float32[:, ::1], float64[:, ::1])')
def _weighted_products(matrix, basis):
    """
    Return basis (m, n) times the inverse of a covariance times basis, (m, m).

    By Cholesky decomposition of the lower triangle of the covariance (n, n), which is overwritten.
    """
    n, m = len(matrix), len(basis)
    white, inverse = basis.astype(np.float32), np.empty(n, np.float32)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = total * inverse[j]
            else:
                inverse[i] = np.float32(1) / np.sqrt(max(total, np.float32(MIN_VARIANCE)))
        for row in range(m):
            total = white[row, i]
            for k in range(i):
                total -= matrix[i, k] * white[row, k]
            white[row, i] = total * inverse[i]
    products = np.empty((m, m))
    for i in range(m):
        for j in range(m):
            total = np.float32(0)
            for k in range(n):
                total += white[i, k] * white[j, k]
            products[i, j] = total
    return products
