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

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.labels import connected_pieces
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, region_moments
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import fit_planes
from plane_detector.segmentation.regions.model_selection import prefer_two_planes
from plane_detector.segmentation.regions.region_graph import MAX_DEVIATIONS

# Blocks of pixels along the side of a cell; the compared means are half a cell wide.
# tuned: on lived-in rooms below seed 9000; with 2, SC -0.012 at a noise of 0.004.
BLOCKS = 4
# ... and three cells long.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
LENGTH_CELLS = 3
# Step in standard deviations of the differences in the image: all along it, and somewhere.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
LOW_THRESHOLD, HIGH_THRESHOLD = 1.7, 4.0
# A piece differs from the rest of its region by this many deviations of smooth noise.
# tuned: benchmark sensitivity; flat from 0 to 1.4 times; it saves time.
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
    grid = cells.grid
    if correlation is None or grid.size_px < BLOCKS:
        return regions
    limit = MAX_DEVIATIONS * np.hypot(noise.mean_sigma, noise.pixel_sigma)
    residual, owner = _block_residuals(
        image.values, image.valid, np.ascontiguousarray(regions.labels), regions.coefficients,
        grid.size_px, np.array([grid.width_px, *grid.origin, limit]))
    if not (owner[SAMPLE] >= 0).any():
        return regions
    _remove_steps(_step_heights(residual, owner[SAMPLE] >= 0), owner)
    pieces, label, blocks = connected_pieces(owner)
    offset = _offsets(residual, pieces, label, blocks)
    is_large = blocks >= min_pixels * (BLOCKS / grid.size_px) ** 2
    for piece in np.argsort(-blocks, kind='stable'):
        if is_large[piece] and offset[piece] > MIN_OFFSET_DEVIATIONS * noise.mean_sigma:
            regions = _cut_off(cells, regions, pieces, piece, label[piece], correlation)
    return regions


@kernel('Tuple((float32[:, ::1], int32[:, ::1]))(float32[:, ::1], boolean[:, ::1], '
        'int32[:, ::1], float64[:, ::1], int64, float64[::1])')
def _block_residuals(disparity, valid, labels, planes, size, frame):
    """Return the mean residual of each block to its region's plane, and the region, -1 none."""
    (height, width), side, per_px = disparity.shape, size // BLOCKS, 1 / frame[0]
    residual = np.zeros((labels.shape[0] * BLOCKS, labels.shape[1] * BLOCKS), np.float32)
    owner = np.full(residual.shape, np.int32(-1))
    total, count = np.empty(width + size, np.float32), np.empty(width + size, np.float32)
    plane, slope = np.empty(width + size, np.float32), np.empty(width + size, np.float32)
    for i in range(residual.shape[0]):
        row, top = labels[i // BLOCKS], i // BLOCKS * size
        if i % BLOCKS == 0:
            for column in range(len(row)):
                a, b, c = planes[max(row[column], 0)]
                c += a * frame[1] + b * (frame[2] + top * per_px)
                for u in range(column * size, column * size + size):
                    plane[u], slope[u] = c + a * per_px * u, b * per_px
        total[:], count[:] = 0, 0
        for v in range(i * size // BLOCKS, min(i * size // BLOCKS + side, height)):
            _add_row((disparity[v], valid[v]), (plane, slope), v - top, (total, count))
        for j in range(residual.shape[1]):
            error, pixels = np.float32(0), np.float32(0)
            for u in range(j * size // BLOCKS, j * size // BLOCKS + side):
                error += total[u]
                pixels += count[u]
            if row[j // BLOCKS] >= 0 and 2 * pixels > side**2:
                residual[i, j] = min(max(error / pixels, -frame[3]), frame[3])
                owner[i, j] = row[j // BLOCKS]
    return residual, owner


@kernel('void(Tuple((float32[::1], boolean[::1])), UniTuple(float32[::1], 2), float32, '
        'UniTuple(float32[::1], 2))')
def _add_row(pixels, planes, y, sums):
    """Add the residuals of a row of pixels, and 1 where valid, to the sums of its columns."""
    (disparity, valid), (plane, slope), (total, count) = pixels, planes, sums
    for u in range(len(disparity)):
        n = np.float32(valid[u])
        total[u] += n * (disparity[u] - plane[u] - y * slope[u])
        count[u] += n


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
    total = np.zeros(count)
    for i in range(pieces.shape[0]):
        for j in range(pieces.shape[1]):
            if pieces[i, j] >= 0:
                total[pieces[i, j]] += values[i, j]
    return total


def _step_heights(residual: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the step at each block, in standard deviations of the differences in the image."""
    across, along = BLOCKS // 2, LENGTH_CELLS * BLOCKS
    height = np.zeros(residual.shape, np.float32)
    for size, before, after, here in (
            ((across, along), np.s_[:, :-across], np.s_[:, across:], np.s_[:, 1:1 - across]),
            ((along, across), np.s_[:-across], np.s_[across:], np.s_[1:1 - across])):
        mean, step = cv2.blur(residual, size), np.zeros(residual.shape, np.float32)
        step[here] = cv2.absdiff(mean[after], mean[before])
        typical = SIGMA_PER_MEDIAN * median(step[SAMPLE][inside])
        step *= 1 / max(typical, np.finfo(np.float32).tiny)
        np.maximum(height, step, out=height)
    return height


@kernel('void(float32[:, ::1], int32[:, ::1])')
def _remove_steps(height, owner):
    """Remove the blocks on a step by hysteresis (Canny 1986); ``height`` is overwritten."""
    (rows, columns), steps, count = height.shape, np.empty(height.size, np.int64), 0
    for row in range(rows):
        for column in range(columns):
            if height[row, column] > HIGH_THRESHOLD:
                steps[count], height[row, column] = row * columns + column, 0
                count += 1
    while count > 0:
        count -= 1
        row, column = steps[count] // columns, steps[count] % columns
        owner[row, column] = -1
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                if height[r, c] > LOW_THRESHOLD:
                    steps[count], height[r, c] = r * columns + c, 0
                    count += 1


def _cut_off(cells: WeightedCells, regions: PlaneRegions, pieces: np.ndarray, piece: int,
             label: int, correlation: Correlation) -> PlaneRegions:
    """Split off the cells that a piece and half the step around it fill, if they are a plane."""
    new, around = len(regions.coefficients), np.ones((BLOCKS + 1, BLOCKS + 1), np.uint8)
    filled = cv2.dilate(cv2.compare(pieces, int(piece), cv2.CMP_EQ), around)
    filled = cv2.resize(filled, cells.grid.shape[::-1], interpolation=cv2.INTER_AREA)
    filled = filled > 126  # the mean of blocks of 0 or 255: at least half of them
    labels = np.where(filled & (regions.labels == label), np.int32(new), regions.labels)
    fitted = fit_planes(region_moments(cells, labels, new + 1))[[label, new]]
    if not np.isfinite(fitted).all() or not prefer_two_planes(cells, labels, correlation, label,
                                                              new):
        return regions
    planes = np.append(regions.coefficients, fitted[1:], axis=0)
    planes[label] = fitted[0]
    return PlaneRegions(labels, planes)
