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
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, region_moments
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import fit_planes
from plane_detector.segmentation.regions.model_selection import prefer_two_planes
from plane_detector.segmentation.regions.region_graph import MAX_DEVIATIONS

# Blocks of pixels along the side of a cell.
# derived: half a cell is two of them.
BLOCKS = 4
# The compared means cover half a cell across and three cells along the step.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
LENGTH_CELLS = 3
# Step in standard deviations of the differences in the image: all along it, and somewhere.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
LOW_THRESHOLD, HIGH_THRESHOLD = 1.7, 4.0
# A piece differs from the rest of its region by this many deviations of smooth noise.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MIN_OFFSET_DEVIATIONS = 0.5


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
    size = cells.grid.size_px
    if correlation is None or size < BLOCKS or not len(regions.coefficients):
        return regions
    residual, owner = _residual(image, cells, regions, noise)
    pieces, sums = _pieces(np.where(_steps(residual, owner >= 0), np.int32(-1), owner), residual)
    label, blocks, mean = sums[:, 0].astype(int), sums[:, 1], sums[:, 2] / sums[:, 1]
    order = np.argsort(-blocks, kind='stable')
    largest = order[np.unique(label[order], return_index=True)[1]]
    rest = dict(zip(label[largest], mean[largest], strict=True))
    split = regions
    for piece in order[blocks[order] * (size / BLOCKS) ** 2 >= min_pixels]:
        offset = abs(mean[piece] - rest[label[piece]])
        if piece not in largest and offset >= MIN_OFFSET_DEVIATIONS * noise.mean_sigma:
            split = _cut_off(cells, split, pieces, piece, label[piece], correlation)
    return split


def _residual(image: DisparityImage, cells: WeightedCells, regions: PlaneRegions,
              noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return the residual of each block to its region's plane, and the region, -1 none."""
    grid, limit = cells.grid, MAX_DEVIATIONS * np.hypot(noise.mean_sigma, noise.pixel_sigma)
    frame = np.array([grid.width_px, *grid.origin, limit])
    return _block_residuals(image.values, image.valid, np.ascontiguousarray(regions.labels),
                            regions.coefficients, grid.size_px, frame)


@kernel('Tuple((float32[:, ::1], int32[:, ::1]))(float32[:, ::1], boolean[:, ::1], '
        'int32[:, ::1], float64[:, ::1], int64, float64[::1])')
def _block_residuals(disparity, valid, labels, planes, size, frame):
    (height, width), side = disparity.shape, size // BLOCKS
    residual = np.zeros((labels.shape[0] * BLOCKS, labels.shape[1] * BLOCKS), np.float32)
    owner = np.full(residual.shape, np.int32(-1))
    column, count = np.zeros(width + size, np.float32), np.zeros(width + size, np.int32)
    for i in range(residual.shape[0]):
        top, bottom = i * size // BLOCKS, min(i * size // BLOCKS + side, height)
        column[:], count[:] = 0, 0
        for v in range(top, bottom):
            for u in range(width):
                column[u] += disparity[v, u]  # 0 where invalid
                count[u] += valid[v, u]
        for j in range(residual.shape[1]):
            label = labels[i // BLOCKS, j // BLOCKS]
            total, pixels, sum_u = 0.0, 0, 0
            for u in range(j * size // BLOCKS, j * size // BLOCKS + side):
                total += column[u]
                pixels += count[u]
                sum_u += u * count[u]
            if label >= 0 and 2 * pixels > side**2:
                a, b, c = planes[label, 0], planes[label, 1], planes[label, 2]
                x, y = sum_u / pixels / frame[0], (top + bottom - 1) / 2 / frame[0]
                error = total / pixels - (a * (frame[1] + x) + b * (frame[2] + y) + c)
                residual[i, j], owner[i, j] = min(max(error, -frame[3]), frame[3]), label
    return residual, owner


@kernel('Tuple((int32[:, ::1], float64[:, ::1]))(int32[:, ::1], float32[:, ::1])')
def _pieces(owner, residual):
    """Return the connected pieces of regions, and region, blocks, sum of residuals of each."""
    rows, columns = owner.shape
    piece, parent, count = np.full((rows, columns), np.int32(-1)), np.arange(owner.size), 0
    for i in range(rows):
        for j in range(columns):
            if owner[i, j] < 0:
                continue
            left = piece[i, j - 1] if j > 0 and owner[i, j - 1] == owner[i, j] else -1
            above = piece[i - 1, j] if i > 0 and owner[i - 1, j] == owner[i, j] else -1
            if left < 0 and above < 0:
                left, count = count, count + 1
            elif left >= 0 and above >= 0 and left != above:
                while parent[left] != left:
                    left = parent[left]
                while parent[above] != above:
                    above = parent[above]
                parent[max(left, above)] = min(left, above)
            piece[i, j] = max(left, above) if min(left, above) < 0 else min(left, above)
    number = 0
    for k in range(count):  # parents come before their children
        if parent[k] == k:
            parent[k], number = number, number + 1
        else:
            parent[k] = parent[parent[k]]
    sums = np.zeros((number, 3))
    for i in range(rows):
        for j in range(columns):
            if owner[i, j] >= 0:
                k = parent[piece[i, j]]
                piece[i, j], sums[k, 0] = k, owner[i, j]
                sums[k, 1] += 1
                sums[k, 2] += residual[i, j]
    return piece, sums


def _steps(residual: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the blocks that lie on a step."""
    across = np.repeat([-1.0, 1.0], BLOCKS // 2) / (BLOCKS // 2)
    length = LENGTH_CELLS * BLOCKS
    along = np.full(length, 1 / length)
    height, sample = np.zeros(residual.shape, np.float32), np.s_[::3, ::3]
    if not inside[sample].any():
        return np.zeros_like(inside)
    for kernel_x, kernel_y in ((across, along), (along, across)):
        step = np.abs(cv2.sepFilter2D(residual, -1, kernel_x, kernel_y))
        typical = SIGMA_PER_MEDIAN * median(step[sample][inside[sample]])
        np.maximum(height, step / max(typical, np.finfo(np.float32).tiny), out=height)
    count, components = cv2.connectedComponents((height > LOW_THRESHOLD).view(np.uint8),
                                                connectivity=8, ltype=cv2.CV_16U)
    strong = np.zeros(count, bool)
    strong[components[height > HIGH_THRESHOLD]] = True
    strong[0] = False
    return strong[components]


def _cut_off(cells: WeightedCells, regions: PlaneRegions, pieces: np.ndarray, piece: int,
             label: int, correlation: Correlation) -> PlaneRegions:
    """Split off the cells that a piece and half the step around it fill, if they are a plane."""
    new = len(regions.coefficients)
    labels = _relabelled(np.ascontiguousarray(regions.labels), pieces, (piece, label, new))
    fitted = fit_planes(region_moments(cells, labels, new + 1))[[label, new]]
    if not np.isfinite(fitted).all() or not prefer_two_planes(cells, labels, correlation, label,
                                                              new):
        return regions
    planes = np.append(regions.coefficients, fitted[1:], axis=0)
    planes[label] = fitted[0]
    return PlaneRegions(labels, planes)


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], UniTuple(int64, 3))')
def _relabelled(labels, pieces, names):
    """Return labels where cells that a piece fills at least half have a new one."""
    piece, old, new = names
    found, reach = labels.copy(), BLOCKS // 2
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            top, left, filled = row * BLOCKS, column * BLOCKS, 0
            if (labels[row, column] != old
                    or not _has(pieces, piece, (top - reach, left - reach), BLOCKS + 2 * reach)):
                continue
            for i in range(top, top + BLOCKS):
                for j in range(left, left + BLOCKS):
                    filled += _has(pieces, piece, (i - reach, j - reach), 1 + 2 * reach)
            if 2 * filled >= BLOCKS**2:
                found[row, column] = new
    return found


@kernel('boolean(int32[:, ::1], int64, UniTuple(int64, 2), int64)')
def _has(pieces, piece, corner, side):
    """Return whether a piece has a block in the square with this upper left corner."""
    for i in range(max(corner[0], 0), min(corner[0] + side, pieces.shape[0])):
        for j in range(max(corner[1], 0), min(corner[1] + side, pieces.shape[1])):
            if pieces[i, j] == piece:
                return True
    return False
