# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Find planes too small or narrow for whole cells: half-size cells on the unlabelled pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid, pixel_frame
from plane_detector.segmentation.cells.model import WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.curved import find_curved
from plane_detector.segmentation.regions.region_graph import BORDER_REACH_CELLS, RegionGraph
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE
from plane_detector.segmentation.search.ransac import Search, add_planes, no_planes

# derived: the minimum for a slope and its error.
MIN_CELL_SIZE_PX = 3
# derived: half of a plane's pixels may lie in cells that straddle its border.
MIN_CELL_SHARE = 0.5


def add_small_planes(image: DisparityImage, labels: np.ndarray, coarse: WeightedCells,
                     coefficients: np.ndarray, search: tuple[Search, Noise],
                     min_turn_deg: float) -> tuple[np.ndarray, np.ndarray]:
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
    search : Search, Noise
        The search that found the others, and the noise that it found.
    min_turn_deg : float
        Regions that turn by less are not curved.

    Returns
    -------
    labels : (H, W) int32
    coefficients : (K + L, 3) float64
        The new planes follow the others; some may have no pixels.

    """
    (search, noise), size = search, coarse.grid.size_px // 2
    config = search.config
    room = config.segmentation.max_planes - len(coefficients)
    if size < MIN_CELL_SIZE_PX or room < 1 or not _sees_width(coarse, noise):
        return labels, coefficients
    wanted = _large_pieces(_count_unlabelled(image.valid, labels, size), size,
                           search.min_pixels / MIN_CELL_SHARE)
    if not wanted.any():
        return labels, coefficients
    box = _box_around(wanted)
    part = np.s_[box[0].start * size:box[0].stop * size, box[1].start * size:box[1].stop * size]
    left = DisparityImage(*_cut_out(image.values[part], image.valid[part], labels[part]))
    grid = build_cell_grid(left, size, wanted[box].ravel(), pixel_frame(image.valid.shape, part))
    noise = noise.at_cell_size(coarse.grid.size_px, size)
    cells = weigh_cells(grid, noise)
    regions = add_planes(replace(search, grid=grid), cells, no_planes(grid), room)
    graph = RegionGraph.of(cells, regions)
    is_flat = np.ones(len(graph.planes), bool)
    is_flat[find_curved(graph, 0.0, min_turn_deg)] = 0
    graph = graph.only(is_flat)
    if len(graph.planes):
        labels = labels.copy()
        labels[part] = label_pixels(left, cells, graph, noise, config.ransac.inlier_threshold,
                                    (labels[part], len(coefficients)))
    return labels, np.vstack([coefficients, graph.planes])


def _sees_width(cells: WeightedCells, noise: Noise) -> bool:
    """Return whether an object as deep as a smaller cell is wide stands out from the noise."""
    width = cells.grid.size_px / 2 / (TYPICAL_FOCAL_SHARE * cells.grid.width_px)
    return noise.mean_sigma < width * cells.grid.typical_disparity


@kernel('int64[:, ::1](boolean[:, ::1], int32[:, ::1], int64)')
def _count_unlabelled(valid, labels, size):
    """Return the number of valid pixels without a label in each cell."""
    (height, width), of_columns = valid.shape, np.empty(valid.shape[1], np.int32)
    pixels = np.zeros((-(-height // size), -(-width // size)), np.int64)
    for row in range(pixels.shape[0]):
        for u in range(width):
            of_columns[u] = 0
        for v in range(row * size, min(row * size + size, height)):
            for u in range(width):
                of_columns[u] += np.int32(valid[v, u] & (labels[v, u] < 0))
        for column in range(pixels.shape[1]):
            for u in range(column * size, min(column * size + size, width)):
                pixels[row, column] += of_columns[u]
    return pixels


@kernel('Tuple((float32[:, ::1], boolean[:, ::1]))(float32[:, :], boolean[:, :], int32[:, :])')
def _cut_out(values, valid, labels):
    """Copy a part of the image, and return which of its valid pixels have no label."""
    part, left = np.empty(values.shape, np.float32), np.empty(values.shape, np.bool_)
    for v in range(values.shape[0]):
        for u in range(values.shape[1]):
            part[v, u], left[v, u] = values[v, u], valid[v, u] & (labels[v, u] < 0)
    return part, left


def _large_pieces(unlabelled: np.ndarray, size: int, min_pixels: float) -> np.ndarray:
    """Return the cells, at least half unlabelled, in connected pieces with enough pixels."""
    wanted = 2 * unlabelled >= size**2
    _, pieces = cv2.connectedComponents(wanted.astype(np.uint8), connectivity=4)
    pixels = np.bincount(pieces.ravel(), unlabelled.ravel())
    return wanted & (pixels >= min_pixels)[pieces]


def _box_around(mask: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns around the cells of a mask, with those that planes grow into."""
    sides = [np.flatnonzero(mask.any(axis)) for axis in (1, 0)]
    return tuple(slice(max(side[0] - BORDER_REACH_CELLS, 0), side[-1] + 1 + BORDER_REACH_CELLS)
                 for side in sides)
