# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Split regions at depth steps.

A picture frame on a wall may stand out by less than the noise of a pixel or cell, so that a plane
of its own does not fit it better. But smooth noise does not jump, and pixel noise averages out
along an edge: the difference of the means on both sides of a line shows much smaller steps than
residuals do. Steps are linked by hysteresis (Canny 1986). A piece that they cut off becomes a
plane if model selection prefers two planes.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.labels import connected_pieces
from plane_detector.segmentation.cells.model import (
    MIN_VARIANCE,
    PlaneRegions,
    WeightedCells,
    region_moments,
)
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import fit_planes
from plane_detector.segmentation.regions.model_selection import REACH_CELLS, prefer_two_planes
from plane_detector.segmentation.regions.region_graph import MAX_DEVIATIONS

# Blocks of pixels along the side of a cell; the compared means are half a cell wide,
# REACH_CELLS long.
# tuned: on lived-in rooms below seed 9000; with 2, SC -0.012 at a noise of 0.004.
BLOCKS = 4
# Step in standard deviations of the differences in the image, all along it; somewhere it is at
# least MAX_DEVIATIONS.
# tuned: lived-in rooms below seed 9000: SC at a noise of 0.004 -0.021 at 0.7 times, -0.009 at 1.8
# times; flat to 1.2 times.
LOW_THRESHOLD = 1.7
# A piece differs from the rest of its region by this many deviations of smooth noise.
# tuned: rooms, lived-in rooms and curved scenes: without it precision of rooms -0.02 at a noise of
# 0.01, at twice the value recall of lived-in rooms -0.02 at 0.004.
MIN_OFFSET_DEVIATIONS = 0.5
# derived: every fifth block of a row or column samples all places within cells of four.
SAMPLE = np.s_[::BLOCKS + 1, ::BLOCKS + 1]


def split_at_depth_steps(image: DisparityImage, cells: WeightedCells, regions: PlaneRegions,
                         noise: Noise, correlation: Correlation | None,
                         min_pixels: float) -> PlaneRegions:
    """
    Split regions along depth steps.

    Parameters
    ----------
    image : DisparityImage
    cells : WeightedCells
    regions : PlaneRegions
    noise : Noise
    correlation : Correlation or None
        If None, nothing is split.
    min_pixels : float
        Smallest piece.

    Returns
    -------
    PlaneRegions
        The pieces follow the other regions, each with its own plane.

    """
    grid, labels = cells.grid, np.ascontiguousarray(regions.labels)
    if correlation is None or grid.size_px < BLOCKS:
        return regions
    limit = MAX_DEVIATIONS * np.hypot(noise.mean_sigma, noise.pixel_sigma)
    residual, owner = _block_residuals(image.values, image.valid, labels, regions.coefficients,
                                       grid.size_px, (grid.width_px, *grid.origin, limit))
    inside = owner[SAMPLE] >= 0
    if not inside.any():
        return regions
    _remove_steps(*_step_heights(residual, inside), owner)
    pieces, label, blocks = connected_pieces(owner)
    offset = _offsets(residual, pieces, label, blocks)
    is_large = blocks >= min_pixels * (BLOCKS / grid.size_px) ** 2
    for piece in np.argsort(-blocks, kind='stable'):
        if is_large[piece] and offset[piece] > MIN_OFFSET_DEVIATIONS * noise.mean_sigma:
            regions = _cut_off(cells, regions, pieces, piece, label[piece], correlation)
    return regions


@kernel('Tuple((float32[:, ::1], int32[:, ::1]))(float32[:, ::1], boolean[:, ::1], '
        'int32[:, ::1], float64[:, ::1], int64, UniTuple(float64, 4))')
def _block_residuals(disparity, valid, labels, planes, size, frame):
    """Return the mean residual of each block to its region's plane, and the region, -1 none."""
    (rows, columns), side, (height, width) = labels.shape, size // BLOCKS, disparity.shape
    residual = np.zeros((rows * BLOCKS, columns * BLOCKS), np.float32)
    owner = np.full(residual.shape, np.int32(-1))
    total, count = np.zeros(columns * size, np.float32), np.zeros(columns * size, np.float32)
    centre, pixel = (side - 1) / 2, 1 / frame[0]
    for i in range(rows * BLOCKS):
        top = i * size // BLOCKS
        for u in range(width):
            total[u] = count[u] = 0
        for v in range(top, min(top + side, height)):
            for u in range(width):
                total[u] += disparity[v, u]  # 0 where invalid
                count[u] += np.float32(valid[v, u])
        for column in range(columns):
            k = labels[i // BLOCKS, column]
            if k < 0:
                continue
            a, b = planes[k, 0] * pixel, planes[k, 1] * pixel
            c = planes[k, 2] + planes[k, 0] * frame[1] + planes[k, 1] * frame[2]
            for j in range(column * BLOCKS, column * BLOCKS + BLOCKS):
                left, d, n = j * size // BLOCKS, np.float32(0), np.float32(0)
                for u in range(left, left + side):
                    d += total[u]
                    n += count[u]
                if 2 * n > side * side:
                    error = d / n - (a * (left + centre) + b * (top + centre) + c)
                    residual[i, j], owner[i, j] = min(max(error, -frame[3]), frame[3]), k
    return residual, owner


def _step_heights(residual: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps (2, rows, columns) and their standard deviations (2,) in the regions."""
    steps = _differences(residual)
    return steps, np.array([SIGMA_PER_MEDIAN * median(np.abs(step[SAMPLE][inside]))
                            for step in steps])


@kernel('float32[:, :, ::1](float32[:, ::1])')
def _differences(residual):
    """
    Return the step (2, rows, columns) at each block, times the number of blocks on each side.

    The sum of the blocks from it to the right minus that of those to its left, and the same from
    it downwards. Blocks outside the image count as 0.
    """
    (rows, columns), half, reach = residual.shape, BLOCKS // 2, REACH_CELLS * BLOCKS // 2
    steps, tall = np.zeros((2, rows, columns), np.float32), np.zeros(columns, np.float32)
    across = np.zeros(columns + 2 * reach, np.float32)
    for row in range(1 - reach, rows):
        for u in range(columns if row + reach <= rows else 0):
            tall[u] += residual[row + reach - 1, u]
        for u in range(columns if row > reach else 0):
            tall[u] -= residual[row - reach - 1, u]
        for k in range(half if row >= 0 else 0):
            out, right = steps[0, row, half:columns - half + 1], tall[half + k:]
            left = tall[half - 1 - k:]
            for u in range(len(out)):
                out[u] += right[u] - left[u]
    for row in range(half, rows - half + 1):
        middle, out = across[reach:reach + columns], steps[1, row]
        for u in range(columns):
            middle[u] = 0
        for k in range(half):
            below, above = residual[row + k], residual[row - 1 - k]
            for u in range(columns):
                middle[u] += below[u] - above[u]
        for k in range(2 * reach):
            shifted = across[k:]
            for u in range(columns):
                out[u] += shifted[u]
    return steps


@kernel('void(float32[:, :, ::1], float64[::1], int32[:, ::1])')
def _remove_steps(steps, typical, owner):
    """Remove the blocks on a step by hysteresis (Canny 1986)."""
    (rows, columns), stride, count = owner.shape, owner.shape[1] + 2, 0
    # In units of the low threshold, in a grid with a margin of one block.
    strength = np.zeros((rows + 2) * stride, np.float32)
    queue, scale = np.empty(len(strength), np.int64), np.empty(2, np.float32)
    for k in range(2):
        scale[k] = 1 / max(LOW_THRESHOLD * typical[k], MIN_VARIANCE)
    for row in range(rows):
        across, down, out = steps[0, row], steps[1, row], strength[(row + 1) * stride + 1:]
        for k in range(columns):
            out[k] = max(abs(across[k]) * scale[0], abs(down[k]) * scale[1])
    for p in range(len(strength)):
        if strength[p] > np.float32(MAX_DEVIATIONS / LOW_THRESHOLD):
            queue[count], strength[p], count = p, 0, count + 1
    while count > 0:
        count -= 1
        here = queue[count]
        owner[here // stride - 1, here % stride - 1] = -1
        for middle in (here - stride, here, here + stride):
            for p in range(middle - 1, middle + 2):
                if strength[np.uint64(p)] > 1:  # unsigned: no wrap-around check
                    queue[count], strength[p], count = p, 0, count + 1


def _offsets(residual: np.ndarray, pieces: np.ndarray, label: np.ndarray,
             blocks: np.ndarray) -> np.ndarray:
    """Return how far the mean residual of each piece (n,) is from its region's largest piece's."""
    mean, order = _sums(pieces, residual, len(blocks)) / blocks, np.argsort(blocks, kind='stable')
    largest = np.zeros(label.max(initial=0) + 1, int)
    largest[label[order]] = order
    return np.abs(mean - mean[largest[label]])


@kernel('float64[::1](int32[:, ::1], float32[:, ::1], int64)')
def _sums(pieces, values, count):
    """Return the sum (n,) of the values of each piece."""
    total = np.zeros(count + 1)  # the last entry is that of blocks in no piece
    for i in range(pieces.shape[0]):
        piece, of_run = pieces[i, 0], 0.0
        for j in range(pieces.shape[1]):
            if pieces[i, j] != piece:
                total[piece] += of_run
                piece, of_run = pieces[i, j], 0.0
            of_run += values[i, j]
        total[piece] += of_run
    return total[:count].copy()


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], int64, int64, int64)', is_short=True)
def _with_piece(labels, pieces, piece, label, new):
    """Return labels, ``new`` in the cells that a piece and half the step around it half fill."""
    (rows, columns), reach, found = pieces.shape, BLOCKS // 2, labels.copy()
    filled, across = np.zeros(pieces.shape, np.bool_), np.empty(columns, np.bool_)
    for i in range(rows):
        here, is_absent = pieces[i], True
        for j in range(columns):
            is_absent &= here[j] != piece
            across[j] = False
        if is_absent:
            continue
        for j in range(columns):
            for k in range(max(j - reach, 0),
                           min(j + reach + 1, columns) if here[j] == piece else 0):
                across[k] = True
        for r in range(max(i - reach, 0), min(i + reach + 1, rows)):
            row = filled[r]
            for j in range(columns):
                row[j] |= across[j]
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            if labels[row, column] == label:
                count = 0
                for i in range(row * BLOCKS, row * BLOCKS + BLOCKS):
                    for j in range(column * BLOCKS, column * BLOCKS + BLOCKS):
                        count += filled[i, j]
                found[row, column] = new if 2 * count >= BLOCKS**2 else label
    return found


def _cut_off(cells: WeightedCells, regions: PlaneRegions, pieces: np.ndarray, piece: int,
             label: int, correlation: Correlation) -> PlaneRegions:
    """Split off the cells that a piece and half the step around it fill, if they are a plane."""
    new = len(regions.coefficients)
    labels = _with_piece(regions.labels, pieces, piece, label, new)
    if not prefer_two_planes(cells, labels, correlation, label, new):
        return regions
    fitted = fit_planes(region_moments(cells, labels, new + 1))[[label, new]]
    if not np.isfinite(fitted).all():
        return regions
    planes = np.append(regions.coefficients, fitted[1:], axis=0)
    planes[label] = fitted[0]
    return PlaneRegions(labels, planes)
