# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Find planes too small or narrow for whole cells: half-size cells on the unlabelled pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage, N, build_cell_grid
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import squared_errors
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.adjacency import MAX_JOINT_VARIANCES, sum_up_regions
from plane_detector.segmentation.regions.curved import find_curved, remove_curved
from plane_detector.segmentation.search.dbscan import Neighbourhood, label_clusters
from plane_detector.segmentation.search.plane_search import (
    TYPICAL_FOCAL_SHARE,
    Search,
    find_planes,
)

# derived: three pixels are the least that a slope and its error need.
MIN_CELL_SIZE_PX = 3
# derived: half of a plane's pixels may lie in cells that straddle its border.
MIN_CELL_SHARE = 0.5
# Pieces of one plane are at most this many of the smaller cells apart.
REACH_CELLS = 3
_CROSS = Neighbourhood(np.array([[0, 0], [0, 1], [1, 0], [0, -1], [-1, 0]]), 1)


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
    min_pixels, threshold = search.min_pixels, config.ransac.inlier_threshold
    if size < MIN_CELL_SIZE_PX or room < 1 or not _sees_width(coarse, noise):
        return labels, coefficients
    left = DisparityImage(image.values, image.valid & (labels < 0))
    grid = build_cell_grid(left, size)
    kind = noise.kind(coarse.grid.typical_disparity)
    noise = noise.at_cell_size(coarse.grid.size_px, size)
    cells = _in_large_pieces(weigh_cells(grid, noise), min_pixels / MIN_CELL_SHARE)
    if grid.moments[cells.is_planar, N].sum() < min_pixels:
        return labels, coefficients
    regions = find_planes(replace(search, grid=grid), cells, noise, room)
    regions = remove_curved(cells, regions, noise.mean_sigma**2)
    new = label_pixels(image, cells, regions, noise, threshold)
    curved = np.append(np.zeros(len(regions.coefficients), bool), False)
    curved[find_curved(cells, regions, kind)] = True
    labels = np.where((labels < 0) & (new >= 0) & ~curved[new], new + len(coefficients), labels)
    coefficients = np.vstack([coefficients, regions.coefficients])
    return _joined(labels, cells, regions, coefficients), coefficients


def _sees_width(cells: WeightedCells, noise: Noise) -> bool:
    """Say whether an object as deep as a smaller cell is wide stands out from the noise."""
    width = cells.grid.size_px / 2 / (TYPICAL_FOCAL_SHARE * cells.grid.width_px)
    return noise.mean_sigma < width * cells.grid.typical_disparity


def _in_large_pieces(cells: WeightedCells, min_pixels: float) -> WeightedCells:
    """Return the cells; ``is_planar`` is kept only in connected pieces of enough pixels."""
    count = cells.grid.moments[:, N]
    filled = np.where(2 * count >= cells.grid.size_px**2, 0, -1).astype(np.int32)
    pieces, number = label_clusters(filled.reshape(cells.grid.shape), _CROSS)
    pixels = np.bincount(pieces.ravel() + 1, count, number + 1)
    pixels[0] = 0
    return replace(cells, is_planar=cells.is_planar & (pixels[pieces.ravel() + 1] >= min_pixels))


def _joined(labels: np.ndarray, cells: WeightedCells, regions: PlaneRegions,
            coefficients: np.ndarray) -> np.ndarray:
    """Merge each new plane with the coplanar planes it touches; the smallest label is kept."""
    count, new = len(coefficients), len(regions.coefficients)
    if not new:
        return labels
    sums = sum_up_regions(cells, regions)
    fits = np.array([squared_errors(coefficients, np.repeat(moments[None], count, axis=0))
                     for moments in sums.moments])
    fits = fits <= MAX_JOINT_VARIANCES * (sums.variance * sums.count)[:, None]
    touching = _touching(labels, cells.grid.size_px, count)
    target = np.arange(count + 1)
    for k in range(count - new, count):
        same = np.flatnonzero((fits[k - count + new] & touching[k]) | (np.arange(count) == k))
        if len(same) > 1:
            target[np.isin(target, target[same])] = target[same].min()
    target[-1] = -1
    return target.astype(np.int32)[labels]


@kernel('boolean[:, ::1](int32[:, ::1], int64, int64)')
def _touching(labels, size, count):
    """Say which labels lie within reach of each other, sampled at one pixel of each cell."""
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
