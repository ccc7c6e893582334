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

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.model import (
    MEAN_D,
    MEAN_WEIGHT,
    MEAN_X,
    MEAN_Y,
    MIN_VARIANCE,
    WeightedCells,
)
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import solve_least_squares
from plane_detector.segmentation.memory import Decision, Recall
from plane_detector.segmentation.regions.region_graph import PLANE_TERMS

# Smooth noise hardly changes over so many cells: those up to this far around the smaller region
# are used, and depth steps are seen along as many.
# tuned: on rooms and lived-in rooms below seed 9000; flat from 2 to 4.
REACH_CELLS = 3
# Most cells used, nearest to the border first; the time grows with the cube.
# tuned: on rooms and lived-in rooms below seed 9000, flat from 64 to 256; with 128 hardly any
# picture frame on a wall is seen.
MAX_CELLS = 192
# Twice the limit, reached by so many cells next to the border, ends a test.
# chosen: a quarter, which costs a tenth; more cells hardly ever halve a gain.
NEAREST_CELLS = MAX_CELLS // 4
# Twice the gain in log-likelihood that blurred noise hardly ever reaches, times its power, 2:
# rougher noise contains more edges.
# tuned: rooms and lived-in rooms below seed 9000; flat from 0.85 times; at 0.7 times precision of
# rooms -0.02 at noise 0.01, at 1.4 times recall of lived-in rooms -0.015 at 0.004.
MIN_LOG_LIKELIHOOD_GAIN = 28.0


def prefer_two_planes(cells: WeightedCells, labels: np.ndarray, correlation: Correlation | None,
                      first: int, second: int, recall: Recall | None = None) -> bool:
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
    recall : Recall, optional
        Of the image before.

    Returns
    -------
    bool
        False if the regions do not touch.

    """
    if correlation is None:
        return False
    limit = MIN_LOG_LIKELIHOOD_GAIN / correlation.power
    gain = log_likelihood_gain(np.ascontiguousarray(labels), cells.table, cells.is_planar,
                               correlation.of_neighbours, (first, second),
                               (2 * limit, cells.least_variance))
    if recall is None:
        return gain > limit
    return recall.is_two(Decision.GAIN, gain / limit, labels, (first, second))


# With MAX_CELLS it takes 0.2 ms and keeps the lock, as the node switches threads after 1 ms; with
# the usual number 0.03 ms.
@kernel('float64(int32[:, ::1], float64[:, ::1], boolean[::1], float64[:, ::1], '
        'UniTuple(int64, 2), UniTuple(float64, 2))', is_short=True)
def log_likelihood_gain(labels, table, is_planar, covariance, pair, limits):
    """
    Return twice the gain of two planes over one, of fewer cells if these show enough.

    ``limits`` are what is enough, and the variance of the cell that varies least: what others vary
    more, as steep ones do, is independent of their neighbours.
    """
    (cell, is_first), columns, gain = _cells_about(labels, is_planar, pair), labels.shape[1], 0.0
    for most in (NEAREST_CELLS, MAX_CELLS):
        if gain < limits[0] and (most == NEAREST_CELLS or len(cell) > NEAREST_CELLS):
            gain = _gain(table, covariance, columns, cell[:most], is_first[:most], limits[1])
    return gain


@kernel('float64(float64[:, ::1], float64[:, ::1], int64, int64[::1], boolean[::1], float64)')
def _gain(table, covariance, columns, cell, is_first, least):
    """Return twice the gain of two planes over one; 0 if either has too few cells for a fit."""
    of_first = 0
    for i in range(len(cell)):
        of_first += is_first[i]
    if min(of_first, len(cell) - of_first) <= PLANE_TERMS:
        return 0.0
    products = _weighted_products(_system(table, covariance, columns, cell, is_first,
                                          least))
    one = solve_least_squares(products, PLANE_TERMS, np.empty(7))
    return one - solve_least_squares(products, 2 * PLANE_TERMS, np.empty(7))


@kernel('Tuple((int64[::1], boolean[::1]))(int32[:, ::1], boolean[::1], UniTuple(int64, 2))')
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
                distance[row, column] = to_second[row + 1, column + 1]
            elif near[row, column] == pair[1]:
                distance[row, column] = to_first[row + 1, column + 1]
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


@kernel('UniTuple(int64, 4)(int32[:, ::1], UniTuple(int64, 2))')
def _box_of_smaller(labels, pair):
    """Return the rows and columns of cells within reach of the smaller one of two regions."""
    (rows, columns), sizes = labels.shape, np.zeros(2, np.int64)
    boxes = np.zeros((2, 4), np.int64)
    for k in range(2):
        boxes[k, 0], boxes[k, 2] = rows, columns
    for row in range(rows):
        for column in range(columns):
            for k in range(2):
                if labels[row, column] == pair[k]:
                    sizes[k] += 1
                    boxes[k, 0] = min(boxes[k, 0], max(row - REACH_CELLS, 0))
                    boxes[k, 1] = max(boxes[k, 1], min(row + REACH_CELLS + 1, rows))
                    boxes[k, 2] = min(boxes[k, 2], max(column - REACH_CELLS, 0))
                    boxes[k, 3] = max(boxes[k, 3], min(column + REACH_CELLS + 1, columns))
    k = int(sizes[1] <= sizes[0])
    return boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]


@kernel('int32[:, ::1](int32[:, :], int64)')
def _distance(labels, label):
    """Return the chessboard distance of each cell to the nearest one with a label, with a rim."""
    (rows, columns), far = labels.shape, np.int32(labels.shape[0] + labels.shape[1])
    distance, one = np.full((rows + 2, columns + 2), far), np.int32(1)
    for row in range(1, rows + 1):
        above, here = distance[row - 1], distance[row]
        for c in range(1, columns + 1):
            nearest = min(min(above[c - 1], above[c]), above[c + 1]) + one
            here[c] = np.int32(0) if labels[row - 1, c - 1] == label else min(nearest, far)
        for c in range(1, columns + 1):
            here[c] = min(here[c], here[c - 1] + one)
    for row in range(rows, 0, -1):
        below, here = distance[row + 1], distance[row]
        for c in range(1, columns + 1):
            nearest = min(min(below[c - 1], below[c]), below[c + 1]) + one
            here[c] = min(here[c], nearest)
        for c in range(columns, 0, -1):
            here[c] = min(here[c], here[c + 1] + one)
    return distance


@kernel('float32[:, ::1](float64[:, ::1], float64[:, ::1], int64, int64[::1], boolean[::1], '
        'float64)')
def _system(table, covariance, columns, cell, is_first, least):
    """
    Return the upper triangle of the covariance (n, n) of cells, and seven columns behind it.

    These are 1, x, y of all cells, the same of the first region, and d.
    """
    n, x, y, d = len(cell), 0.0, 0.0, 0.0
    for i in range(n):
        x += table[cell[i], MEAN_X] / n
        y += table[cell[i], MEAN_Y] / n
        d += table[cell[i], MEAN_D] / n
    work = np.zeros((n, n + 7), np.float32)
    row, column = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        row[i], column[i] = cell[i] // columns, cell[i] % columns
    for i in range(n):
        for j in range(i, n):
            work[i, j] = covariance[abs(row[i] - row[j]), abs(column[i] - column[j])]
        work[i, i] += 1 / table[cell[i], MEAN_WEIGHT] - least
        work[i, n], work[i, n + 1] = 1.0, table[cell[i], MEAN_X] - x
        work[i, n + 2], work[i, n + 6] = table[cell[i], MEAN_Y] - y, table[cell[i], MEAN_D] - d
        for k in range(n, n + 3 if is_first[i] else n):
            work[i, k + 3] = work[i, k]
    return work


@kernel('float64[:, ::1](float32[:, ::1])')
def _weighted_products(work):
    """
    Return the products (m, m) of the last m columns, weighted by the inverse of the covariance.

    By elimination of the upper triangle of the covariance (n, n) in the first n columns, which is
    overwritten; four rows at once, since the time is that of reading and writing the others.
    """
    n, m = len(work), work.shape[1] - len(work)
    inverse, products = np.empty(n, np.float32), np.zeros((m, m))
    for first in range(0, n, 4):
        last = min(first + 4, n)
        for k in range(first, last):
            row = work[k, k:]
            for p in range(first, k):
                above = work[p, k:]
                factor = above[0] * inverse[p]
                for j in range(len(row)):
                    row[j] -= factor * above[j]
            inverse[k] = np.float32(1) / max(row[0], np.float32(MIN_VARIANCE))
        for i in range(last, n):
            row, one, two = work[i, i:], work[first, i:], work[first + 1, i:]
            three, four = work[first + 2, i:], work[first + 3, i:]
            a, b = one[0] * inverse[first], two[0] * inverse[first + 1]
            c, d = three[0] * inverse[first + 2], four[0] * inverse[first + 3]
            for j in range(len(row)):
                row[j] -= a * one[j] + b * two[j] + c * three[j] + d * four[j]
    for k in range(n):
        for i in range(m):
            for j in range(m):
                products[i, j] += np.float64(work[k, n + i]) * work[k, n + j] * inverse[k]
    return products
