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
    pair = np.array([first, second])
    cell, is_first = _cells_about(np.ascontiguousarray(labels), cells.is_planar, pair)
    if min(np.count_nonzero(is_first), np.count_nonzero(~is_first)) <= PLANE_TERMS:
        return False
    gain = _gain(cells.table, cell, is_first, correlation.of_neighbours)
    return bool(gain > MIN_LOG_LIKELIHOOD_GAIN / correlation.power)


@kernel('Tuple((int64[::1], boolean[::1]))(int32[:, ::1], boolean[::1], int64[::1])',
        is_short=True)
def _cells_about(labels, is_planar, pair):
    """Return the cells (n,) nearest to a border, and which of them are the first region's."""
    columns, (top, bottom, left, right) = labels.shape[1], _box_of_smaller(labels, pair)
    near = labels[top:bottom, left:right]
    to_first, to_second = _distance(near, pair[0]), _distance(near, pair[1])
    # Counting sort by distance.
    distance = np.zeros(near.shape, np.int64)
    start = np.zeros(near.shape[0] + near.shape[1] + 2, np.int64)
    for row in range(near.shape[0]):
        for column in range(near.shape[1]):
            if not is_planar[(top + row) * columns + left + column]:
                continue
            if near[row, column] == pair[0]:
                distance[row, column] = to_second[row, column]
            elif near[row, column] == pair[1]:
                distance[row, column] = to_first[row, column]
            if distance[row, column] > 0:
                start[distance[row, column] + 1] += 1
    for k in range(1, len(start)):
        start[k] += start[k - 1]
    n = min(start[-1], MAX_CELLS)
    cell, is_first = np.empty(n, np.int64), np.zeros(n, np.bool_)
    for row in range(near.shape[0]):
        for column in range(near.shape[1]):
            apart = distance[row, column]
            if apart > 0 and start[apart] < n:
                cell[start[apart]] = (top + row) * columns + left + column
                is_first[start[apart]] = near[row, column] == pair[0]
            start[apart] += apart > 0
    return cell, is_first


@kernel('UniTuple(int64, 4)(int32[:, ::1], int64[::1])')
def _box_of_smaller(labels, pair):
    """Return the rows and columns of cells within reach of the smaller one of two regions."""
    (rows, columns), sizes = labels.shape, np.zeros(2, np.int64)
    boxes = np.array([[rows, 0, columns, 0], [rows, 0, columns, 0]])
    for row in range(rows):
        for column in range(columns):
            for k in range(2):
                if labels[row, column] == pair[k]:
                    sizes[k] += 1
                    boxes[k, 0] = min(boxes[k, 0], max(row - REACH_CELLS, 0))
                    boxes[k, 1] = max(boxes[k, 1], min(row + REACH_CELLS + 1, rows))
                    boxes[k, 2] = min(boxes[k, 2], max(column - REACH_CELLS, 0))
                    boxes[k, 3] = max(boxes[k, 3], min(column + REACH_CELLS + 1, columns))
    box = boxes[int(sizes[1] <= sizes[0])]
    return box[0], box[1], box[2], box[3]


@kernel('int64[:, ::1](int32[:, :], int64)')
def _distance(labels, label):
    """Return the chessboard distance (R, C) of each cell to the nearest cell with a label."""
    rows, columns = labels.shape
    distance = np.full((rows, columns), rows + columns)
    for turn in range(2):
        for i in range(labels.size):
            at = i if turn == 0 else labels.size - 1 - i
            row, column, towards = at // columns, at % columns, 2 * turn - 1
            shortest = 0 if labels[row, column] == label else distance[row, column]
            if 0 <= row + towards < rows:
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    shortest = min(shortest, distance[row + towards, c] + 1)
            if 0 <= column + towards < columns:
                shortest = min(shortest, distance[row, column + towards] + 1)
            distance[row, column] = shortest
    return distance


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
