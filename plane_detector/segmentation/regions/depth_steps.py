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
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, dilated, median
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, region_moments
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import fit_planes
from plane_detector.segmentation.regions.model_selection import prefer_two_planes
from plane_detector.segmentation.search.dbscan import Neighbourhood, label_clusters

# Blocks of pixels along the side of a cell.
# derived: half a cell is two of them.
BLOCKS = 4
# The compared means cover half a cell across and three cells along the step.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
LENGTH_CELLS = 3
# Step in standard deviations of the differences in the image: all along it, and somewhere.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
LOW_THRESHOLD, HIGH_THRESHOLD = 1.7, 4.0
# A piece differs from its surroundings by this many deviations, at the step and overall.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MIN_OFFSET = 0.5
# Residuals are clipped at this many deviations, so that outliers do not hide the steps.
MAX_RESIDUAL = 6.0
_CROSS = Neighbourhood(np.array([[0, 0], [0, 1], [1, 0], [0, -1], [-1, 0]]), 1)


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
    limit = MAX_RESIDUAL * np.hypot(noise.mean_sigma, noise.pixel_sigma)
    residual = _residual(image, cells, regions, limit)
    inside = ~np.isnan(residual)
    residual = np.where(inside, residual, np.float32(0))
    labels = regions.labels.repeat(BLOCKS, axis=0).repeat(BLOCKS, axis=1)
    free = np.where(inside & ~_steps(residual, inside), labels, -1)
    pieces, count = label_clusters(free, _CROSS)
    owners = np.where(inside, labels, -1)
    area = np.bincount(pieces.ravel() + 1, minlength=count + 1)[1:]
    owner = np.zeros(count + 1, int)
    owner[pieces] = labels
    large = np.flatnonzero(area * (size / BLOCKS) ** 2 >= min_pixels)
    large = large[np.argsort(-area[large], kind='stable')]
    mean = np.bincount(pieces.ravel() + 1, residual.ravel(), count + 1)[1:] / area
    split = regions
    for rank, piece in enumerate(large):
        larger = large[:rank][owner[large[:rank]] == owner[piece]]
        min_offset = MIN_OFFSET * noise.mean_sigma
        if not len(larger) or abs(mean[piece] - mean[larger[0]]) < min_offset:
            continue
        if _stands_out(pieces == piece, residual, owners, mean[larger[0]], min_offset):
            split = _cut_off(cells, split, pieces == piece, owner[piece], correlation)
    return split


def _residual(image: DisparityImage, cells: WeightedCells, regions: PlaneRegions,
              limit: float) -> np.ndarray:
    """Return the residual of each block to its region's plane, NaN where there is none."""
    grid = cells.grid
    frame = np.array([grid.width_px, *grid.origin, limit])
    return _block_residuals(image.values, image.valid, np.ascontiguousarray(regions.labels),
                            regions.coefficients, grid.size_px, frame)


@kernel('float32[:, ::1](float32[:, ::1], boolean[:, ::1], int32[:, ::1], float64[:, ::1], int64, '
        'float64[::1])')
def _block_residuals(disparity, valid, labels, planes, size, frame):
    rows, columns = labels.shape
    residual = np.full((rows * BLOCKS, columns * BLOCKS), np.float32(np.nan))
    for i in range(rows * BLOCKS):
        for j in range(columns * BLOCKS):
            label = labels[i // BLOCKS, j // BLOCKS]
            if label < 0:
                continue
            top, bottom = i * size // BLOCKS, (i + 1) * size // BLOCKS
            left, right = j * size // BLOCKS, (j + 1) * size // BLOCKS
            total, count = 0.0, 0
            for v in range(top, min(bottom, disparity.shape[0])):
                for u in range(left, min(right, disparity.shape[1])):
                    if valid[v, u]:
                        total += (disparity[v, u] - planes[label, 0] * (frame[1] + u / frame[0])
                                  - planes[label, 1] * (frame[2] + v / frame[0]))
                        count += 1
            if 2 * count > (bottom - top) * (right - left):
                residual[i, j] = min(max(total / count - planes[label, 2], -frame[3]), frame[3])
    return residual


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


def _stands_out(is_piece: np.ndarray, residual: np.ndarray, labels: np.ndarray, rest_mean: float,
                min_offset: float) -> bool:
    """Say whether a piece is offset from its region's rest, with the same sign at the step."""
    rows, columns = (np.flatnonzero(is_piece.any(axis=axis)) for axis in (1, 0))
    box = tuple(slice(max(side[0] - 2 * BLOCKS, 0), side[-1] + 2 * BLOCKS + 1)
                for side in (rows, columns))
    piece, values = is_piece[box], residual[box]
    region = labels[box] == labels[rows[0]][is_piece[rows[0]]][0]
    beyond = dilated(piece, BLOCKS)
    outer = dilated(beyond, BLOCKS) & ~beyond & region
    inner = piece & dilated(region & ~piece, BLOCKS + BLOCKS // 2)
    if not outer.any() or not inner.any():
        return False
    offsets = np.array([values[inner].mean() - values[outer].mean(),
                        values[piece].mean() - rest_mean])
    return bool((offsets >= min_offset).all() or (offsets <= -min_offset).all())


def _cut_off(cells: WeightedCells, regions: PlaneRegions, piece: np.ndarray, label: int,
             correlation: Correlation) -> PlaneRegions:
    """Split off the cells that a piece and half the step around it fill, if they are a plane."""
    (rows, columns), new = regions.labels.shape, len(regions.coefficients)
    filled = dilated(piece, BLOCKS // 2).reshape(rows, BLOCKS, columns, BLOCKS).sum(axis=(1, 3))
    labels = np.where((2 * filled >= BLOCKS**2) & (regions.labels == label), new,
                      regions.labels).astype(np.int32)
    fitted = fit_planes(region_moments(cells, labels, new + 1))[[label, new]]
    if not np.isfinite(fitted).all() or not prefer_two_planes(cells, labels, correlation, label,
                                                              new):
        return regions
    planes = np.append(regions.coefficients, fitted[1:], axis=0)
    planes[label] = fitted[0]
    return PlaneRegions(labels, planes)
