# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Find planes too small or narrow for whole cells: half-size cells on the unlabelled pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import (
    DisparityImage,
    N,
    X,
    Y,
    build_cell_grid,
    pixel_frame,
)
from plane_detector.segmentation.cells.model import Frame, at_borders
from plane_detector.segmentation.pixels.labelling import label_more_pixels, pixel_tolerance
from plane_detector.segmentation.regions.curved import find_curved
from plane_detector.segmentation.regions.region_graph import BORDER_REACH_CELLS, RegionGraph
from plane_detector.segmentation.search.ransac import add_planes, no_planes

# derived: the minimum for a slope and its error.
MIN_CELL_SIZE_PX = 3
# chosen: half of a plane's pixels may lie in cells that straddle its border.
MIN_CELL_SHARE = 0.5


def add_small_planes(frame: Frame, labels: np.ndarray, known: RegionGraph,
                     min_turn_deg: float) -> np.ndarray:
    """
    Find more planes among the pixels without a label.

    Parameters
    ----------
    frame : Frame
    labels : (H, W) int32
        Pixels of new planes are overwritten.
    known : RegionGraph
        Of the K planes that the labels are indices of.
    min_turn_deg : float
        Regions whose normals turn by less are not curved.

    Returns
    -------
    (K + L, 3) float64
        The new planes follow the others; some may have no pixels.

    """
    size, valid = frame.grid.size_px // 2, frame.image.valid
    room = frame.config.segmentation.max_planes - len(known.planes)
    if size < MIN_CELL_SIZE_PX or room < 1 or not _sees_width(frame):
        return known.planes
    unlabelled = _count_unlabelled(valid, labels, size)
    half = cv2.inRange(unlabelled, -(-size**2 // 2), size**2)
    wanted = _in_large_pieces(*cv2.connectedComponents(half, connectivity=4), unlabelled,
                              frame.min_pixels / MIN_CELL_SHARE)
    if not wanted.any():
        return known.planes
    # Whole rows, including those that planes grow into: slices of these are not copies.
    filled = np.flatnonzero(wanted.any(axis=1))
    rows = slice(max(filled[0] - BORDER_REACH_CELLS, 0), filled[-1] + 1 + BORDER_REACH_CELLS)
    part = slice(rows.start * size, rows.stop * size)
    left = _unlabelled_part(frame, labels, part, wanted[rows])
    graph = RegionGraph.of(left.cells, add_planes(left, no_planes(left.grid), room))
    is_flat = np.ones(len(graph.planes), bool)
    is_flat[find_curved(graph, 0.0, min_turn_deg, left.noise.bending)] = False
    graph = graph.only(is_flat)
    planes = np.concatenate([known.planes, graph.planes])
    if len(graph.planes):
        found = labels[part]
        label_more_pixels(left, graph, found, len(known.planes))
        model = (left.image.values, left.grid.planes_in_pixels(planes),
                 _sides_of_intersections(graph, known))
        borders = np.flatnonzero(at_borders(graph.labels))
        _take_back(found, borders, size, model, pixel_tolerance(left), frame.grid.size_px)
    return planes


def _sides_of_intersections(new: RegionGraph, known: RegionGraph) -> np.ndarray:
    """
    Return the sign of 1/z of each new plane minus each known one, on the new one's side, (L, K).

    It is 0 if their intersection does not lie between the centroids of the two regions.
    """
    apart = new.planes[:, None] - known.planes
    here = np.einsum('lkt,lt->lk', apart, new.pixels[:, [X, Y, N]])
    there = np.einsum('lkt,kt->lk', apart, known.pixels[:, [X, Y, N]])
    return np.where(here * there < 0, np.sign(here), 0).astype(np.int8)


@kernel('void(int32[:, ::1], int64[::1], int64, Tuple((float32[:, ::1], float64[:, ::1], '
        'int8[:, ::1])), UniTuple(float64, 3), int64)')
def _take_back(labels, cells, size, model, tolerance, reach):
    """
    Give the new planes the pixels at their borders for which the known planes had no rival.

    Next to the intersection line of two planes, each pixel belongs to the plane of its side,
    whatever its noise; elsewhere to the nearer plane. The planes grow from the given cells, by at
    most ``reach`` pixels.
    """
    (height, width), (disparity, planes, sides) = labels.shape, model
    of_noise, of_depth, of_slope = tolerance
    known, columns = sides.shape[1], -(-width // size)
    queue, first, last = np.empty((labels.size, 3), np.int64), 0, 0
    for cell in cells:
        top, left = cell // columns * size, cell % columns * size
        for v in range(top, min(top + size, height)):
            for u in range(left, min(left + size, width)):
                if labels[v, u] >= known:
                    queue[last, 0], queue[last, 1], queue[last, 2] = v, u, 0
                    last += 1
    while first < last and queue[first, 2] < reach:
        v, u, steps = queue[first, 0], queue[first, 1], queue[first, 2]
        first += 1
        k = labels[v, u]
        for row, column in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
            if row < 0 or column < 0 or row == height or column == width:
                continue
            j, d = labels[row, column], disparity[row, column]
            if j < 0 or j >= known:
                continue
            own = planes[k, 0] * column + planes[k, 1] * row + planes[k, 2]
            other = planes[j, 0] * column + planes[j, 1] * row + planes[j, 2]
            square, side = of_noise + of_depth * d**4, sides[k - known, j]
            is_close = side != 0 and (own - other) ** 2 < square
            is_own = side * (own - other) > 0 if is_close else abs(own - d) < abs(other - d)
            square += of_slope * (planes[k, 0] ** 2 + planes[k, 1] ** 2)
            if is_own and (own - d) ** 2 <= square:
                labels[row, column] = k
                queue[last, 0], queue[last, 1], queue[last, 2] = row, column, steps + 1
                last += 1


def _unlabelled_part(frame: Frame, labels: np.ndarray, part: slice, wanted: np.ndarray) -> Frame:
    """Return the unlabelled pixels of some rows of the image, in small cells where wanted."""
    image, size = frame.image, frame.grid.size_px // 2
    left = DisparityImage(image.values[part], image.valid[part] & (labels[part] < 0))
    grid = build_cell_grid(left, size, wanted.ravel(), pixel_frame(image.valid.shape, part.start),
                           frame.grid.lens)
    noise = frame.noise.at_cell_size(frame.grid.size_px, size)
    return replace(frame, image=left, grid=grid, noise=noise)


def _sees_width(frame: Frame) -> bool:
    """Return whether an object as deep as a smaller cell is wide stands out from the noise."""
    grid = frame.grid
    width = grid.size_px / 2 / (grid.lens[0] * grid.width_px)
    return frame.noise.mean_sigma < width * grid.typical_disparity


@kernel('int32[:, ::1](boolean[:, ::1], int32[:, ::1], int64)')
def _count_unlabelled(valid, labels, size):
    """Return the number of valid pixels without a label in each cell."""
    (height, width), of_columns = valid.shape, np.empty(valid.shape[1], np.int32)
    pixels = np.zeros((-(-height // size), -(-width // size)), np.int32)
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


@kernel('boolean[:, ::1](int64, int32[:, ::1], int32[:, ::1], float64)', is_short=True)
def _in_large_pieces(count, pieces, pixels, min_pixels):
    """Return which cells are in pieces, but for the first, with enough pixels."""
    total, is_wanted = np.zeros(count, np.int64), np.empty(pieces.shape, np.bool_)
    for row in range(pieces.shape[0]):
        for column in range(pieces.shape[1]):
            total[pieces[row, column]] += pixels[row, column]
    total[0] = -1
    for row in range(pieces.shape[0]):
        for column in range(pieces.shape[1]):
            is_wanted[row, column] = total[pieces[row, column]] >= min_pixels
    return is_wanted

