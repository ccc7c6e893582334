# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Split regions at depth steps.

A picture frame on a wall may stand out by less than the noise of a pixel or cell, so that a plane
of its own does not fit it better. But smooth noise does not jump, and pixel noise averages out
along an edge: the difference of the means on both sides of a line shows much smaller steps than
residuals do. A piece that steps cut off becomes a plane if model selection prefers two planes.
"""

from __future__ import annotations

import math

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.model import Frame, PlaneRegions, fit_regions
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.memory import Recall
from plane_detector.segmentation.regions.model_selection import prefer_two_planes

# Cells along which a step is seen: smooth noise hardly changes over so many.
# tuned: on rooms and lived-in rooms below seed 9000; flat from 2 to 4.
REACH_CELLS = 3
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
    runs, label, blocks, mean = _find_pieces(residual, owner, *_steps(residual, owner))
    is_candidate = ((blocks >= frame.min_pixels * (BLOCKS / grid.size_px) ** 2)
                    & (_offsets(label, blocks, mean)
                       > MIN_OFFSET_DEVIATIONS * frame.noise.mean_sigma))
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


def _steps(residual: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the steps at the left and the upper side of each block, and the smallest of note."""
    steps, is_sampled = _differences(residual), owner[SAMPLE] >= 0
    limits = [MIN_STEP_DEVIATIONS * SIGMA_PER_MEDIAN * median(np.abs(step[SAMPLE][is_sampled]))
              if is_sampled.any() else math.inf for step in steps]
    return *steps, np.float32(limits)


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


def _offsets(label: np.ndarray, blocks: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return how far the mean residual of each piece (n,) is from its region's largest piece's."""
    largest, order = np.zeros(label.max(initial=0) + 1, int), np.argsort(blocks, kind='stable')
    largest[label[order]] = order
    return np.abs(mean - mean[largest[label]])


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
