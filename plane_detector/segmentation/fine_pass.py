# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Find planes too small or narrow for whole cells: half-size cells on the unlabelled pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.labels import connected_pieces
from plane_detector.segmentation.cells.model import WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import squared_errors
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.curved import find_curved
from plane_detector.segmentation.regions.merging import MAX_JOINT_VARIANCES
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE
from plane_detector.segmentation.search.ransac import Search, add_planes, no_planes

# derived: the minimum for a slope and its error.
MIN_CELL_SIZE_PX = 3
# derived: half of a plane's pixels may lie in cells that straddle its border.
MIN_CELL_SHARE = 0.5
# Pieces of one plane are at most this many of the smaller cells apart.
# tuned: rooms, lived-in rooms and real frames; flat from 2 to 4.
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
    room = config.segmentation.max_planes - len(coefficients)
    if size < MIN_CELL_SIZE_PX or room < 1 or not _sees_width(coarse, noise):
        return labels, coefficients
    left = DisparityImage(image.values, image.valid & (labels < 0))
    wanted = _large_pieces(left.valid, size, search.min_pixels / MIN_CELL_SHARE)
    if not wanted.any():
        return labels, coefficients
    grid = build_cell_grid(left, size, wanted)
    noise = noise.at_cell_size(coarse.grid.size_px, size)
    cells = weigh_cells(grid, noise)
    regions = add_planes(replace(search, grid=grid), cells, no_planes(grid), room)
    graph = RegionGraph.of(cells, regions)
    if not len(graph.planes):
        return labels, coefficients
    target = _targets(labels, grid, graph, coefficients)
    is_exact = noise.is_exact(coarse.grid.typical_disparity)
    target[find_curved(graph, 0.0, 0.0 if is_exact else config.segmentation.flatness_angle)] = -1
    new = label_pixels(image, cells, graph, noise, config.ransac.inlier_threshold)
    return _overlaid(labels, new, target), np.vstack([coefficients, graph.planes])


def _sees_width(cells: WeightedCells, noise: Noise) -> bool:
    """Return whether an object as deep as a smaller cell is wide stands out from the noise."""
    width = cells.grid.size_px / 2 / (TYPICAL_FOCAL_SHARE * cells.grid.width_px)
    return noise.mean_sigma < width * cells.grid.typical_disparity


def _large_pieces(left: np.ndarray, size: int, min_pixels: float) -> np.ndarray:
    """Return the cells in connected pieces with enough pixels; cells are at least half full."""
    pixels = _count_pixels(left, size)
    pieces, label, _ = connected_pieces(np.where(2 * pixels >= size**2, np.int32(0),
                                                 np.int32(-1)))
    # The last entry is that of cells in no piece.
    total = np.bincount(pieces.ravel() + 1, pixels.ravel(), len(label) + 1)
    is_large = np.append(total[1:] >= min_pixels, False)
    return is_large[pieces].ravel()


@kernel('int64[:, ::1](boolean[:, ::1], int64)')
def _count_pixels(left, size):
    """Return the number of pixels in each cell."""
    height, width = left.shape
    rows, columns = -(-height // size), -(-width // size)
    pixels, of_columns = np.zeros((rows, columns), np.int64), np.empty(width, np.int32)
    for row in range(rows):
        of_columns[:] = 0
        for v in range(row * size, min(row * size + size, height)):
            for u in range(width):
                of_columns[u] += np.int32(left[v, u])
        for column in range(columns):
            for u in range(column * size, min(column * size + size, width)):
                pixels[row, column] += of_columns[u]
    return pixels


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], int32[::1])')
def _overlaid(labels, new, target):
    """Return labels in which a pixel without one and of new label k has label target[k]."""
    result, index = np.empty_like(labels), np.full(len(target) + 1, np.int32(-1))
    for k in range(len(target)):
        index[k + 1] = target[k]
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            other = index[np.uint32(new[v, u] + 1)]  # unsigned: no wrap-around check
            result[v, u] = labels[v, u] if labels[v, u] >= 0 else other
    return result


def _targets(labels: np.ndarray, grid: CellGrid, graph: RegionGraph,
             coefficients: np.ndarray) -> np.ndarray:
    """Return the label (L,) of each new plane: that of a coplanar one it touches, or its own."""
    planes, first = np.vstack([coefficients, graph.planes]), len(coefficients)
    rows, columns = (np.minimum(np.arange(count) * grid.size_px + grid.size_px // 2, side - 1)
                     for count, side in zip(grid.shape, labels.shape, strict=True))
    around = np.where(graph.labels < 0, labels[rows[:, None], columns],
                      graph.labels + np.int32(first))
    touching = _touching(around, len(planes))
    target = np.arange(len(planes), dtype=np.int32)
    for k, sums in enumerate(graph.sums, first):
        error = squared_errors(planes, np.repeat(sums[None, :10], len(planes), axis=0))
        fits = touching[k] & (error <= MAX_JOINT_VARIANCES * sums[10])
        same = target[np.append(np.flatnonzero(fits), k)]
        target[(target[:, None] == same).any(axis=1)] = same.min()
    return target[first:]


@kernel('boolean[:, ::1](int32[:, ::1], int64)')
def _touching(labels, count):
    """Return which labels of cells lie within reach of each other."""
    touching = np.zeros((count, count), np.bool_)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            one = labels[row, column]
            for reach in range(1, REACH_CELLS + 1 if one >= 0 else 0):
                for r, c in ((row + reach, column), (row, column + reach)):
                    if r < labels.shape[0] and c < labels.shape[1] and labels[r, c] >= 0:
                        touching[one, labels[r, c]] = touching[labels[r, c], one] = True
    return touching
