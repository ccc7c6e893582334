# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Find planes too small or narrow for whole cells: half-size cells on the unlabelled pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import squared_errors
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.curved import find_curved, remove_curved
from plane_detector.segmentation.regions.merging import MAX_JOINT_VARIANCES
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE
from plane_detector.segmentation.search.ransac import Search, add_planes, no_planes

# derived: the minimum for a slope and its error.
MIN_CELL_SIZE_PX = 3
# derived: half of a plane's pixels may lie in cells that straddle its border.
MIN_CELL_SHARE = 0.5
# Pieces of one plane are at most this many of the smaller cells apart.
# tuned: on lived-in rooms below seed 9000; compiled in, so its range was not swept.
REACH_CELLS = 3


def add_small_planes(image: DisparityImage, labels: np.ndarray, coarse: WeightedCells,
                     coefficients: np.ndarray, noise: Noise,
                     search: Search) -> tuple[np.ndarray, np.ndarray]:
    """
    Find more planes among the pixels without a label.

    Parameters
    ----------
    image : DisparityImage
    labels : (H, W) int32
    coarse : WeightedCells
        The cells that the other planes were found with.
    coefficients : (K, 3) float64
        The other planes.
    noise : Noise
    search : Search
        The search that found the others.

    Returns
    -------
    labels : (H, W) int32
        A new plane that continues another one gets the label of that one.
    coefficients : (K + L, 3) float64
        The new planes follow the others; some may have no pixels.

    """
    config, size = search.config, coarse.grid.size_px // 2
    room, count = config.segmentation.max_planes - len(coefficients), len(coefficients)
    min_pixels, threshold = search.min_pixels, config.ransac.inlier_threshold
    if size < MIN_CELL_SIZE_PX or room < 1 or not _sees_width(coarse, noise):
        return labels, coefficients
    left = DisparityImage(image.values, image.valid & (labels < 0))
    wanted = _large_pieces(left.valid, size, min_pixels / MIN_CELL_SHARE)
    if not wanted.any():
        return labels, coefficients
    grid = build_cell_grid(left, size, wanted)
    kind = noise.kind(coarse.grid.typical_disparity)
    noise = noise.at_cell_size(coarse.grid.size_px, size)
    cells = weigh_cells(grid, noise)
    regions = add_planes(replace(search, grid=grid), cells, no_planes(grid), room)
    regions = remove_curved(cells, regions, noise.mean_sigma**2)
    if not len(regions.coefficients):
        return labels, coefficients
    new = np.where(left.valid, label_pixels(image, cells, regions, noise, threshold), -1)
    target = np.arange(-1, len(regions.coefficients), dtype=np.int32) + count
    target[1 + find_curved(cells, RegionGraph.of(cells, regions), kind)] = target[0] = -1
    labels = _overlaid(labels, new, target)
    coefficients = np.vstack([coefficients, regions.coefficients])
    target = _merged(labels, cells, regions, coefficients)
    if (target[1:] != np.arange(len(coefficients))).any():
        labels = _overlaid(labels, labels, target)
    return labels, coefficients


def _sees_width(cells: WeightedCells, noise: Noise) -> bool:
    """Return whether an object as deep as a smaller cell is wide stands out from the noise."""
    width = cells.grid.size_px / 2 / (TYPICAL_FOCAL_SHARE * cells.grid.width_px)
    return noise.mean_sigma < width * cells.grid.typical_disparity


@kernel('boolean[::1](boolean[:, ::1], int64, float64)')
def _large_pieces(left, size, min_pixels):
    """Return the cells in connected pieces with enough pixels; cells are at least half full."""
    rows, columns = -(-left.shape[0] // size), -(-left.shape[1] // size)
    pixels = np.zeros(rows * columns, np.int64)
    for v in range(left.shape[0]):
        row, first = left[v], v // size * columns
        for column in range(columns):
            for u in range(column * size, min(column * size + size, len(row))):
                pixels[first + column] += row[u]
    is_open, is_wanted = 2 * pixels >= size**2, np.zeros(rows * columns, np.bool_)
    queue = np.empty(rows * columns, np.int64)
    for seed in range(rows * columns):
        if not is_open[seed]:
            continue
        queue[0], is_open[seed] = seed, False
        head, tail, total = 0, 1, 0
        while head < tail:
            i = queue[head]
            head += 1
            total += pixels[i]
            for j in (i - columns, i - 1, i + 1, i + columns):
                if (0 <= j < rows * columns and is_open[j]
                        and (abs(j - i) > 1 or j // columns == i // columns)):
                    queue[tail], is_open[j] = j, False
                    tail += 1
        is_wanted[queue[:tail]] = total >= min_pixels
    return is_wanted


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], int32[::1])')
def _overlaid(labels, new, target):
    """Return labels in which pixels of new label k >= 0 have label target[1 + k], if >= 0."""
    result = labels.copy()
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if new[v, u] >= 0 and target[1 + new[v, u]] >= 0:
                result[v, u] = target[1 + new[v, u]]
    return result


def _merged(labels: np.ndarray, cells: WeightedCells, regions: PlaneRegions,
            coefficients: np.ndarray) -> np.ndarray:
    """
    Merge each new plane with the coplanar planes it touches; the smallest label is kept.

    Returns
    -------
    (1 + K + L,) int32
        New label of the labels from -1 on.

    """
    count, new = len(coefficients), len(regions.coefficients)
    sums = RegionGraph.of(cells, regions).sums
    fits = np.array([squared_errors(coefficients, np.repeat(moments[None], count, axis=0))
                     for moments in sums[:, :10]])
    fits = fits <= MAX_JOINT_VARIANCES * sums[:, 10:11]
    touching = _touching(labels, cells.grid.size_px, count)
    target = np.arange(-1, count, dtype=np.int32)
    for k in range(count - new, count):
        same = np.flatnonzero((fits[k - count + new] & touching[k]) | (np.arange(count) == k))
        if len(same) > 1:
            target[np.isin(target, target[1 + same])] = target[1 + same].min()
    return target


@kernel('boolean[:, ::1](int32[:, ::1], int64, int64)')
def _touching(labels, size, count):
    """Return which labels lie within reach of each other, sampled at one pixel of each cell."""
    touching = np.zeros((count, count), np.bool_)
    for v in range(size // 2, labels.shape[0], size):
        for u in range(size // 2, labels.shape[1], size):
            one = labels[v, u]
            if one < 0:
                continue
            for reach in range(1, REACH_CELLS + 1):
                if u + reach * size < labels.shape[1] and labels[v, u + reach * size] >= 0:
                    other = labels[v, u + reach * size]
                    touching[one, other] = touching[other, one] = True
                if v + reach * size < labels.shape[0] and labels[v + reach * size, u] >= 0:
                    other = labels[v + reach * size, u]
                    touching[one, other] = touching[other, one] = True
    return touching
