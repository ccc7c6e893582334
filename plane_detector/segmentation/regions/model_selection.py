# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
One plane or two: whether a step or a crease runs along the border of two regions.

Two tests of the cells at the border:

- A step. Two parallel planes are fitted to the cells, and the step between them is compared with
  its error (Wald 1943). What counts as error is how much windows of cells on one side differ: it
  is seen at this border, and contains what a sensor's noise is there, bends and ripples included.
  Depth in terraces has steps between windows that do not differ at all, so that the second test
  must speak for two planes too, if not as clearly.
- A crease. Smooth noise shifts whole regions, but it does not bend sharply: from one cell to the
  next it changes by far less than its standard deviation. Generalised least squares (Aitken 1936)
  uses that: a likelihood-ratio test under correlated noise compares two planes with one. It is
  enough by itself.
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

# Cells up to this far from the other region are used.
# tuned: scores steps and measured, seeds 200 to 211; flat from 5 to 7.
BORDER_CELLS = 5
# Most cells used for a crease, nearest to the border first; the time grows with the cube.
# tuned: as above; flat from 96, lived-in rooms at noise 0.01 -.026 SC at 64; long creases need
# more.
MAX_CELLS = 192
# Twice the gain in log-likelihood that errors of sensors hardly ever reach, times the power of
# blurred noise, 2: rougher noise contains more edges.
# tuned: as above; at 28, 45, 70 and 112 SC of sensors .973, .975, .980 and .980, of rooms at noise
# 0.01 .915, .913, .908 and .906, of lived-in rooms at .004 .707, .699, .698 and .694.
MIN_LOG_LIKELIHOOD_GAIN = 45.0
# The square of a step over its standard error that surfaces of sensors hardly ever reach.
# tuned: as above; flat from 110 to 160; NYU -.012 SC at 80.
MIN_STEP = 110.0
# A step counts from this share of the least gain on: depth in terraces has steps with no error.
# tuned: terraces of the sensor cases, seeds 300 to 311: of 12 largest surfaces none is in pieces,
# without it two; steps on real surfaces have .3 to 8, but two of .05 and .1.
MIN_GAIN_SHARE = 0.2
# A window is 3 x 3 cells, and at least two thirds of them are of its region.
# chosen: errors of sensors are shared by about so many pixels, 24 along a side.
WINDOW_CELLS, MIN_WINDOW_CELLS = 9, 6


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
    evidence = evidence_of_two(np.ascontiguousarray(labels), cells.table, cells.is_planar,
                               correlation.of_neighbours, (first, second),
                               (MIN_LOG_LIKELIHOOD_GAIN / correlation.power,
                                cells.least_variance))
    if recall is None:
        return evidence > 1
    return recall.is_two(Decision.GAIN, evidence, labels, (first, second))


@kernel('float64(int32[:, ::1], float64[:, ::1], boolean[::1], float64[:, ::1], '
        'UniTuple(int64, 2), UniTuple(float64, 2))', is_short=True)
def evidence_of_two(labels, table, is_planar, covariance, pair, limits):
    """
    Return the evidence for a step or a crease over its limit, whichever is more.

    ``limits`` are that of the gain, and the variance of the cell that varies least: what others
    vary more, as steep ones do, is independent of their neighbours.
    """
    (cell, is_first), columns, of_first = _cells_about(labels, is_planar, pair), labels.shape[1], 0
    for i in range(len(cell)):
        of_first += is_first[i]
    if min(of_first, len(cell) - of_first) <= PLANE_TERMS:
        return 0.0
    step = squared_step(table, columns, cell, is_first) / MIN_STEP
    products = _weighted_products(_system(table, covariance, columns, cell[:MAX_CELLS],
                                          is_first[:MAX_CELLS], limits[1]))
    gain = (solve_least_squares(products, PLANE_TERMS, np.empty(7))
            - solve_least_squares(products, 2 * PLANE_TERMS, np.empty(7)))
    gain /= limits[0]
    return max(step, gain) if gain > MIN_GAIN_SHARE else gain


@kernel('Tuple((int64[::1], boolean[::1]))(int32[:, ::1], boolean[::1], UniTuple(int64, 2))')
def _cells_about(labels, is_planar, pair):
    """Return the cells (n,) about a border, nearest first, and which are the first region's."""
    columns, (top, bottom, left, right) = labels.shape[1], _box_of_smaller(labels, pair)
    near = labels[top:bottom, left:right]
    to_first, to_second = _distance(near, pair[0]), _distance(near, pair[1])
    distance, count = np.zeros(near.shape, np.int64), np.zeros(BORDER_CELLS + 1, np.int64)
    for row in range(near.shape[0]):
        for column in range(near.shape[1]):
            if not is_planar[(top + row) * columns + left + column]:
                continue
            if near[row, column] == pair[0]:
                distance[row, column] = to_second[row + 1, column + 1]
            elif near[row, column] == pair[1]:
                distance[row, column] = to_first[row + 1, column + 1]
            if 0 < distance[row, column] <= BORDER_CELLS:
                count[distance[row, column]] += 1
    cell, is_first, n = np.empty(count.sum(), np.int64), np.zeros(count.sum(), np.bool_), 0
    for apart in range(1, BORDER_CELLS + 1):
        for row in range(near.shape[0] if count[apart] > 0 else 0):
            for column in range(near.shape[1]):
                if distance[row, column] == apart:
                    cell[n] = (top + row) * columns + left + column
                    is_first[n] = near[row, column] == pair[0]
                    n += 1
    return cell, is_first


@kernel('float64(float64[:, ::1], int64, int64[::1], boolean[::1])')
def squared_step(table, columns, cell, is_first):
    """Return the square of the step between two parallel planes over that of its error."""
    n, x, y, d = len(cell), 0.0, 0.0, 0.0
    for i in range(n):
        x += table[cell[i], MEAN_X] / n
        y += table[cell[i], MEAN_Y] / n
        d += table[cell[i], MEAN_D] / n
    products, model = np.zeros((5, 5)), np.empty(5)
    terms, at = np.ones((n, 5)), np.full(len(table), -1)
    for i in range(n):
        terms[i, 1], terms[i, 2] = table[cell[i], MEAN_X] - x, table[cell[i], MEAN_Y] - y
        terms[i, 3], terms[i, 4] = np.float64(is_first[i]), table[cell[i], MEAN_D] - d
        at[cell[i]] = i
        for row in range(5):
            for column in range(5):
                products[row, column] += terms[i, row] * terms[i, column]
    # What the plane does not explain of the step: the inverse of the variance of its estimate.
    known = solve_least_squares(products[:4, :4].copy(), PLANE_TERMS, np.empty(4))
    variance = solve_least_squares(products, PLANE_TERMS + 1, model) / n
    residual = np.empty(n)
    for i in range(n):
        residual[i] = terms[i, 4]
        for k in range(4):
            residual[i] -= model[k] * terms[i, k]
    square, windows = np.zeros(2), np.zeros(2)
    for i in range(n):
        row, column, total, count = cell[i] // columns, cell[i] % columns, 0.0, 0
        for r in range(max(row - 1, 0), min(row + 2, len(table) // columns)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                j = at[r * columns + c]
                if j >= 0 and is_first[j] == is_first[i]:
                    total += residual[j]
                    count += 1
        if count >= MIN_WINDOW_CELLS:
            square[int(is_first[i])] += (total / count) ** 2
            windows[int(is_first[i])] += 1
    spread, sides = 0.0, 0
    for side in range(2):
        if windows[side] > 2:
            spread += WINDOW_CELLS * square[side] / windows[side]
            sides += 1
    # A cell has the variance that it brings to the mean of a window, at least its own.
    variance = max(spread / sides if sides else PLANE_TERMS * variance, variance)
    return model[PLANE_TERMS] ** 2 * known / max(variance, MIN_VARIANCE)


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
                    boxes[k, 0] = min(boxes[k, 0], max(row - BORDER_CELLS, 0))
                    boxes[k, 1] = max(boxes[k, 1], min(row + BORDER_CELLS + 1, rows))
                    boxes[k, 2] = min(boxes[k, 2], max(column - BORDER_CELLS, 0))
                    boxes[k, 3] = max(boxes[k, 3], min(column + BORDER_CELLS + 1, columns))
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
