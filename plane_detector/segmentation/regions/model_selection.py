# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
One plane or two: model selection for regions that lie within the noise of each other.

Smooth noise shifts whole regions, but it neither jumps nor bends sharply: from one cell to the
next it changes by far less than its standard deviation. Generalised least squares (Aitken 1936)
exploits this: a likelihood-ratio test under correlated noise compares two planes with one plane on
the cells around the border.

It decides on pairs of regions, and on pieces that depth steps cut off a region. A picture frame on
a wall may stand out by less than the noise of a pixel or cell, so that a plane of its own does not
fit it better. But smooth noise does not jump, and pixel noise averages out along an edge: the
difference of the means on both sides of a line shows much smaller steps than residuals do.
"""

from __future__ import annotations

import math

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.grid import solve_least_squares
from plane_detector.segmentation.cells.model import (
    MEAN_D,
    MEAN_WEIGHT,
    MEAN_X,
    MEAN_Y,
    MIN_VARIANCE,
    Frame,
    PlaneRegions,
    WeightedCells,
    fit_regions,
)
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.memory import Decision, Recall
from plane_detector.segmentation.regions.region_graph import PLANE_TERMS

# Smooth noise hardly changes over this many cells: cells up to this far around the smaller region
# are used, and depth steps are compared over this length.
# tuned: on rooms and lived-in rooms below seed 9000; flat from 2 to 4.
REACH_CELLS = 3
# Most cells used, nearest to the border first; the time grows with the cube.
# tuned: on rooms and lived-in rooms below seed 9000, flat from 64 to 256; with 128 hardly any
# picture frame on a wall is seen.
MAX_CELLS = 192
# A test ends when this many cells next to the border reach twice the limit.
# chosen: a quarter, which costs a tenth; more cells hardly ever halve a gain.
NEAREST_CELLS = MAX_CELLS // 4
# Twice the gain in log-likelihood that blurred noise hardly ever reaches, times its power, 2:
# rougher noise contains more edges.
# tuned: rooms and lived-in rooms below seed 9000; flat from 0.85 times; at 0.7 times precision of
# rooms -0.02 at noise 0.01, at 1.4 times recall of lived-in rooms -0.015 at 0.004.
MIN_LOG_LIKELIHOOD_GAIN = 28.0
# Blocks of pixels along the side of a cell; the compared means are half a cell wide,
# REACH_CELLS long.
# tuned: on lived-in rooms below seed 9000; with 2, SC -0.012 at a noise of 0.004.
BLOCKS = 4
# Smallest step, in standard deviations of the differences in the image.
# tuned: rooms and lived-in rooms below seed 9000; not flat: SC of lived-in rooms at a noise of
# 0.004 -0.027 at 0.7 times, of both at 0.01 -0.005 from 1.2 times on.
MIN_STEP_DEVIATIONS = 1.7
# A piece differs from the rest of its region by this many deviations of smooth noise.
# tuned: rooms, lived-in rooms and curved scenes; flat from 0.35; without it precision of rooms
# -0.03 at a noise of 0.01, at 0.7 recall of both -0.01.
MIN_OFFSET_DEVIATIONS = 0.5
# derived: every fifth block of a row or column samples all places within cells of four.
SAMPLE = np.s_[::BLOCKS + 1, ::BLOCKS + 1]
# Column of the piece in a run of blocks.
PIECE = 3


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
    row, column = np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(n):
        row[i], column[i] = cell[i] // columns, cell[i] % columns
    by_place, width = covariance.reshape(-1), np.int32(covariance.shape[1])
    for i in range(n):
        out, r, c = work[i], row[i], column[i]
        for j in range(i, n):  # unsigned: no wrap-around check
            out[j] = by_place[np.uint32(abs(r - row[j]) * width + abs(c - column[j]))]
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


def split_at_depth_steps(frame: Frame, regions: PlaneRegions,
                         correlation: Correlation | None,
                         recall: Recall | None = None) -> PlaneRegions:
    """
    Split regions along depth steps; without a correlation of the noise, nothing is split.

    The pieces follow the other regions, each with its own plane.
    """
    image, cells = frame.image, frame.cells
    grid = cells.grid
    if correlation is None or grid.size_px < BLOCKS:
        return regions
    residual, owner = _block_residuals(image.values, image.valid, regions.labels,
                                       grid.planes_in_pixels(regions.coefficients), grid.size_px)
    steps, is_sampled = _differences(residual), owner[SAMPLE] >= 0
    limits = [MIN_STEP_DEVIATIONS * SIGMA_PER_MEDIAN * median(np.abs(step[SAMPLE][is_sampled]))
              if is_sampled.any() else math.inf for step in steps]
    runs, label, blocks, mean = _find_pieces(residual, owner, *steps, np.float32(limits))
    # How far each is from the largest piece of its region.
    largest, order = np.zeros(label.max(initial=0) + 1, int), np.argsort(blocks, kind='stable')
    largest[label[order]] = order
    offsets = np.abs(mean - mean[largest[label]])
    is_candidate = ((blocks >= frame.min_pixels * (BLOCKS / grid.size_px) ** 2)
                    & (offsets > MIN_OFFSET_DEVIATIONS * frame.noise.mean_sigma))
    candidates = np.flatnonzero(is_candidate)
    for k in candidates[np.argsort(-blocks[candidates], kind='stable')]:
        new = len(regions.coefficients)
        labels = _with_piece(regions.labels, runs, k, (label[k], new))
        if prefer_two_planes(cells, labels, correlation, label[k], new, recall):
            regions = fit_regions(cells, labels, new + 1)
    return regions


@kernel('Tuple((float32[:, ::1], int32[:, ::1]))(float32[:, ::1], boolean[:, ::1], '
        'int32[:, ::1], float64[:, ::1], int64)')
def _block_residuals(disparity, valid, labels, planes, size):
    """
    Return the mean residual of each block to its region's plane, and the region, -1 none.

    The last blocks before another region belong to none, so that no two regions touch.
    """
    (rows, columns), side, (height, width) = labels.shape, size // BLOCKS, disparity.shape
    residual = np.zeros((rows * BLOCKS, columns * BLOCKS), np.float32)
    owner = np.full(residual.shape, np.int32(-1))
    total, count = np.zeros(columns * size, np.float32), np.zeros(columns * size, np.uint8)
    d, n = np.empty(len(total), np.float32), np.empty(len(total), np.uint16)
    begin = np.empty(max(rows, columns) * BLOCKS, np.int64)
    for i in range(len(begin)):
        begin[i] = i * size // BLOCKS
    whole, per, middle = side * side, 1 / (side * side), (side - 1) / 2
    for i in range(rows * BLOCKS):
        top, row = begin[i], i // BLOCKS
        for u in range(width):
            total[u] = count[u] = 0
        for v in range(top, min(top + side, height)):
            for u in range(width):
                total[u] += disparity[v, u]  # 0 where invalid
                count[u] += np.uint8(valid[v, u])
        for u in range(len(d)):
            d[u], n[u] = total[u], count[u]
        for step in range(1, side):
            for u in range(len(d) - step):
                d[u] += total[u + step]
                n[u] += count[u + step]
        below = labels[min(row + int(i % BLOCKS == BLOCKS - 1), rows - 1)]
        for column in range(columns):
            k, first, filled = labels[row, column], column * BLOCKS, 0
            if k < 0:
                continue
            a, b, c = planes[k, 0], planes[k, 1], planes[k, 2]
            name = k if below[column] == k else np.int32(-1)
            for j in range(first, first + BLOCKS):
                left = np.uint64(begin[j])  # unsigned: no wrap-around check
                residual[i, j] = d[left] * per - (a * (begin[j] + middle) + b * (top + middle) + c)
                owner[i, j] = name
                filled += n[left]
            for j in range(first, first + BLOCKS if filled < BLOCKS * whole else first):
                residual[i, j], pixels = 0, np.int64(n[begin[j]])
                if 2 * pixels > whole:
                    x, y = _centroid(valid, top, begin[j], side)
                    residual[i, j] = d[begin[j]] / pixels - (a * x + b * y + c)
                else:
                    owner[i, j] = -1
            if labels[row, min(column + 1, columns - 1)] != k:
                owner[i, first + BLOCKS - 1] = -1
    return residual, owner


@kernel('UniTuple(float64, 2)(boolean[:, ::1], int64, int64, int64)')
def _centroid(valid, top, left, side):
    """Return the mean column and row of the valid pixels of a block."""
    count, x, y = 0, 0, 0
    for v in range(top, min(top + side, valid.shape[0])):
        for u in range(left, min(left + side, valid.shape[1])):
            count += valid[v, u]
            x += valid[v, u] * u
            y += valid[v, u] * v
    return x / count, y / count


@kernel('UniTuple(float32[:, ::1], 2)(float32[:, ::1])')
def _differences(residual):
    """
    Return the sum of the blocks to the right of a line minus those to the left; below and above.

    Half a cell on either side, as long as REACH_CELLS; the border goes on. A third of the time of
    OpenCV. The sums are written out for BLOCKS of 4 and REACH_CELLS of 3.
    """
    (rows, columns), reach = residual.shape, REACH_CELLS * BLOCKS // 2
    across, down = np.empty_like(residual), np.empty_like(residual)
    tall, flat = np.zeros(columns + 2 * reach), np.zeros(columns + 2 * reach, np.float32)
    four = np.empty(columns + 2 * reach - BLOCKS, np.float32)
    for v in range(-2 * reach, rows):
        new, old = residual[min(max(v + reach - 1, 0), rows - 1)], residual[max(v - reach - 1, 0)]
        is_full = np.float32(v >= 0)
        for u in range(columns):
            tall[u + reach] += new[u] - old[u] * is_full
        if v < 0:
            continue
        here, below = residual[v], residual[min(v + 1, rows - 1)]
        over, above = residual[max(v - 1, 0)], residual[max(v - 2, 0)]
        for u in range(columns):
            flat[u + reach] = here[u] + below[u] - over[u] - above[u]
        for u in range(reach):
            tall[u], tall[u + columns + reach] = tall[reach], tall[columns + reach - 1]
            flat[u], flat[u + columns + reach] = flat[reach], flat[columns + reach - 1]
        for u in range(columns):
            across[v, u] = (tall[u + reach] + tall[u + reach + 1] - tall[u + reach - 1]
                            - tall[u + reach - 2])
        for u in range(columns + 8):
            four[u] = flat[u] + flat[u + 1] + flat[u + 2] + flat[u + 3]
        for u in range(columns):
            down[v, u] = four[u] + four[u + 4] + four[u + 8]
    return across, down


@kernel('Tuple((int32[:, ::1], int64[::1], int64[::1], float64[::1]))(float32[:, ::1], '
        'int32[:, ::1], float32[:, ::1], float32[:, ::1], float32[::1])')
def _find_pieces(residual, owner, across, down, limits):
    """
    Return the runs of connected blocks, and the region, blocks and mean residual of each piece.

    Blocks of no region or on a step are in no piece. A run (row, first column, one behind the
    last, piece) is in one row; pieces are numbered in the order of their first runs. One pass over
    the blocks: OpenCV, and the sums, took twice the time.
    """
    (rows, columns), count, above = owner.shape, 0, 0
    runs = np.empty((rows * ((columns + 1) // 2), 4), np.int32)
    total, is_inside = np.empty(len(runs)), np.empty(columns, np.bool_)
    for row in range(rows):
        for u in range(columns):
            is_inside[u] = ((owner[row, u] >= 0) & (abs(across[row, u]) <= limits[0])
                            & (abs(down[row, u]) <= limits[1]))
        begin, column = count, 0
        while column < columns:
            if not is_inside[column]:
                column += 1
                continue
            first, of_run = column, 0.0
            while column < columns and is_inside[column]:
                of_run += residual[row, column]
                column += 1
            runs[count, 0], runs[count, 1], runs[count, 2] = row, first, column
            runs[count, PIECE], total[count] = count, of_run
            while above < begin and runs[above, 2] <= first:
                above += 1
            touching = above
            while touching < begin and runs[touching, 1] < column:
                one, other = _first_run(runs, touching), _first_run(runs, count)
                runs[max(one, other), PIECE] = min(one, other)
                touching += 1
            count += 1
        above = begin
    n = 0
    label, blocks, mean = np.empty(count, np.int64), np.zeros(count, np.int64), np.zeros(count)
    for run in range(count):
        piece = runs[runs[run, PIECE], PIECE]  # of an earlier run: the number of its piece
        if runs[run, PIECE] == run:
            piece, label[n] = n, owner[runs[run, 0], runs[run, 1]]
            n += 1
        runs[run, PIECE] = piece
        blocks[piece] += runs[run, 2] - runs[run, 1]
        mean[piece] += total[run]
    for piece in range(n):
        mean[piece] /= blocks[piece]
    return runs[:count].copy(), label[:n].copy(), blocks[:n].copy(), mean[:n].copy()


@kernel('int64(int32[:, ::1], int64)')
def _first_run(runs, run):
    """Return the first run of a piece, and shorten the way there."""
    while runs[run, PIECE] != run:
        runs[run, PIECE] = runs[runs[run, PIECE], PIECE]
        run = runs[run, PIECE]
    return run


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], int64, UniTuple(int64, 2))', is_short=True)
def _with_piece(labels, runs, piece, names):
    """Return labels, the second name in cells that a piece and half the step around half fill."""
    found, (rows, columns), reach = labels.copy(), labels.shape, BLOCKS // 2
    is_filled = np.zeros((rows * BLOCKS, columns * BLOCKS), np.bool_)
    count = np.zeros(labels.shape, np.int32)
    for run in range(len(runs)):
        if runs[run, PIECE] != piece:
            continue
        row, first, end = runs[run, 0], runs[run, 1], runs[run, 2]
        for v in range(max(row - reach, 0), min(row + reach + 1, len(is_filled))):
            for u in range(max(first - reach, 0), min(end + reach, columns * BLOCKS)):
                count[v // BLOCKS, u // BLOCKS] += not is_filled[v, u]
                is_filled[v, u] = True
    for row in range(rows):
        for column in range(columns):
            if labels[row, column] == names[0] and 2 * count[row, column] >= BLOCKS**2:
                found[row, column] = names[1]
    return found
