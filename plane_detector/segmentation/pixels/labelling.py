# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels of cells to labels of pixels.

If all neighbours of a cell have its label, its pixels get this label. In cells along borders each
pixel chooses among the planes nearby. If two planes intersect along their border, the side of the
intersection decides, which does not depend on noise; at a step the residual of the pixel decides.
On depth accurate enough to show creases, a cell is reassigned if most of its pixels choose another
plane, and its neighbours choose again, so that borders follow the pixels. A border against pixels
on no plane lies where the surface leaves the plane's own noise.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage, N
from plane_detector.segmentation.cells.model import WeightedCells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import squared_errors
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.segmentation.search.plane_search import sees_creases

# derived: the median of 9 pixels has about 1.25 / 3 of their standard deviation.
MEDIAN_NOISE_SHARE = 0.41
# derived: a border moves by one cell per sweep, and almost none is further off.
SWEEPS = 16
# Tolerance of pixels over that of the cells.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
PIXEL_TOLERANCE = 1.3


def label_pixels(image: DisparityImage, cells: WeightedCells, graph: RegionGraph, noise: Noise,
                 threshold: float, grows: bool = False) -> np.ndarray:
    """
    Label every pixel.

    Parameters
    ----------
    image : DisparityImage
    cells : WeightedCells
    graph : RegionGraph
        Of these cells, none of its regions merged.
    noise : Noise
    threshold : float
        Inlier threshold in standard deviations.
    grows : bool
        Where creases are visible, planes grow into cells without a label, from cell to cell, as
        long as most of the pixels of a cell are near the plane.

    Returns
    -------
    (H, W) int32
        Index into the planes, -1 for none and where invalid.

    """
    grid, values, pixel_sigma = cells.grid, image.values, noise.pixel_sigma
    if pixel_sigma**2 > noise.variance_floor(grid.typical_disparity):
        values, pixel_sigma = image.smoothed, MEDIAN_NOISE_SHARE * pixel_sigma
    frame = np.array([grid.width_px, *grid.origin, threshold**2,
                      noise.mean_sigma**2 + pixel_sigma**2 + noise.disparity_floor**2,
                      noise.depth_floor_m**2])
    planes = np.column_stack([graph.planes, _plane_variances(graph, noise, pixel_sigma)])
    around, square = graph.labels.astype(np.int16), np.ones((3, 3), np.uint8)
    is_amid = cv2.dilate(around, square) == cv2.erode(around, square)
    is_open = ~(is_amid & (cells.is_planar.reshape(grid.shape) | (around < 0)))
    sweeps = SWEEPS if sees_creases(grid, noise, threshold) else 1
    return _label(values, image.valid, (graph.labels, is_open, sweeps, grows),
                  (planes, graph.intersections()), (grid.size_px, frame))


def _plane_variances(graph: RegionGraph, noise: Noise, pixel_sigma: float) -> np.ndarray:
    """
    Return the variance (K,) of pixels about each plane without the floor of the depth.

    A plane whose cells fit better than the noise of the whole image says how far its border may
    lie off it; one that fits worse gets no more than that noise.
    """
    shown = squared_errors(graph.planes, graph.pixels) / np.maximum(graph.pixels[:, N], 1)
    smooth = np.clip(shown - noise.pixel_sigma**2, 0, noise.mean_sigma**2)
    return smooth + pixel_sigma**2 + noise.disparity_floor**2


@kernel('int32[:, ::1](float32[:, ::1], boolean[:, ::1], '
        'Tuple((int32[:, ::1], boolean[:, ::1], int64, boolean)), '
        'Tuple((float64[:, ::1], int8[:, ::1])), Tuple((int64, float64[::1])))')
def _label(disparity, valid, cells, planes, geometry):
    """Return the label of every pixel, given labels of cells and where pixels choose."""
    (coefficients, signs), (size, frame) = planes, geometry
    labels, is_open, sweeps, grows = cells
    found, near = np.empty(disparity.shape, np.int32), np.full(10, np.int32(-1))
    local, pixels = np.empty((9, 4), np.float32), np.zeros((5, size**2), np.float32)
    chosen, columns = np.empty(size**2, np.int32), labels.shape[1]
    for p in range(size**2):
        pixels[0, p], pixels[1, p] = p % size, p // size
    _fill_cells(found, valid, labels, is_open, size)
    for _ in range(sweeps):
        settled, is_next, is_settled = labels.copy(), np.zeros(labels.shape, np.bool_), True
        for cell in np.flatnonzero(is_open):
            row, column = cell // columns, cell % columns
            if not _find_labels_around(labels, row, column, near):
                continue
            corner, label = (row * size, column * size, size), labels[row, column]
            _load(disparity, corner, pixels)
            _move_planes(coefficients, near, corner, frame, local)
            _choose_nearest(pixels, chosen, near, local, frame)
            _choose_sides(pixels, chosen, near, local, signs, frame)
            _store(found, valid, corner, chosen)
            winner = _majority(chosen, near) if sweeps > 1 and (grows or label >= 0) else label
            if winner >= 0 and winner != label:
                settled[row, column], is_settled = winner, False
                for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
                    for c in range(max(column - 1, 0), min(column + 2, columns)):
                        is_next[r, c] |= label >= 0 or labels[r, c] < 0
        labels, is_open = settled, is_next
        if is_settled:
            break
    return found


@kernel('void(int32[:, ::1], boolean[:, ::1], int32[:, ::1], boolean[:, ::1], int64)')
def _fill_cells(found, valid, labels, is_open, size):
    """Write the labels of cells that are not open to their pixels, -1 to all others."""
    line = np.empty(labels.shape[1] * size, np.int32)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = np.int32(-1) if is_open[row, column] else labels[row, column]
            for u in range(column * size, column * size + size):
                line[u] = label
        for v in range(row * size, min(row * size + size, found.shape[0])):
            for u in range(found.shape[1]):
                found[v, u] = line[u] if valid[v, u] else np.int32(-1)


@kernel('boolean(int32[:, ::1], int64, int64, int32[::1])')
def _find_labels_around(labels, row, column, near):
    """Write the labels of the 3 x 3 cells around one, then -1; return whether there are any."""
    count, last = 0, np.int32(-1)
    for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, labels.shape[1])):
            if labels[r, c] == last or labels[r, c] < 0:
                continue
            last, is_new = labels[r, c], True
            for k in range(count):
                is_new &= near[k] != last
            if is_new:
                near[count] = last
                count += 1
    near[count] = -1
    return count > 0


@kernel('void(float32[:, ::1], UniTuple(int64, 3), float32[:, ::1])')
def _load(disparity, corner, pixels):
    """Copy the disparity of a cell to the third row of its pixels, behind their u and v."""
    top, left, size = corner
    for i in range(min(size, disparity.shape[0] - top)):
        for j in range(min(size, disparity.shape[1] - left)):
            pixels[2, i * size + j] = disparity[top + i, left + j]


@kernel('void(int32[:, ::1], boolean[:, ::1], UniTuple(int64, 3), int32[::1])')
def _store(found, valid, corner, chosen):
    """Write the labels of a cell's pixels."""
    top, left, size = corner
    for i in range(min(size, found.shape[0] - top)):
        for j in range(min(size, found.shape[1] - left)):
            found[top + i, left + j] = (chosen[i * size + j] if valid[top + i, left + j]
                                        else np.int32(-1))


@kernel('int32(int32[::1], int32[::1])')
def _majority(chosen, near):
    """Return the label that most of a cell's pixels have, or -1."""
    for label in near:
        votes = 0
        for p in range(len(chosen)):
            votes += chosen[p] == label
        if label < 0 or 2 * votes > len(chosen):
            break
    return label


@kernel('void(float64[:, ::1], int32[::1], UniTuple(int64, 3), float64[::1], float32[:, ::1])')
def _move_planes(coefficients, near, corner, frame, local):
    """Write the planes in pixels from the corner of a cell."""
    for k, label in enumerate(near):
        if label < 0:
            break
        a, b, c = coefficients[label, 0], coefficients[label, 1], coefficients[label, 2]
        local[k, 0], local[k, 1] = a / frame[0], b / frame[0]
        local[k, 2] = (a * (frame[1] + corner[1] / frame[0])
                       + b * (frame[2] + corner[0] / frame[0]) + c)
        local[k, 3] = coefficients[label, 3]


@kernel('void(float32[:, ::1], int32[::1], int32[::1], float32[:, ::1], float64[::1])')
def _choose_nearest(pixels, chosen, near, local, frame):
    """Write the plane of smallest residual of each pixel, -1 where all are too far."""
    tolerance2 = np.float32(frame[3] * PIXEL_TOLERANCE**2)
    depth_floor2 = np.float32(frame[5])
    for p in range(len(chosen)):
        square = pixels[2, p] * pixels[2, p]
        pixels[3, p], pixels[4, p] = depth_floor2 * square * square, np.float32(np.inf)
        chosen[p] = -1
    for k, label in enumerate(near):
        if label < 0:
            break
        a, b, c, variance = local[k, 0], local[k, 1], local[k, 2], local[k, 3]
        for p in range(len(chosen)):
            residual = pixels[2, p] - (a * pixels[0, p] + b * pixels[1, p] + c)
            square = residual * residual
            is_best = (square <= tolerance2 * (variance + pixels[3, p])) & (square <= pixels[4, p])
            chosen[p] = label if is_best else chosen[p]
            pixels[4, p] = square if is_best else pixels[4, p]


@kernel('void(float32[:, ::1], int32[::1], int32[::1], float32[:, ::1], int8[:, ::1], '
        'float64[::1])')
def _choose_sides(pixels, chosen, near, local, signs, frame):
    """Relabel the pixels close to an intersection, where residuals are alike, by their side."""
    threshold2, variance = np.float32(frame[3]), np.float32(frame[4])
    depth_floor2, count = np.float32(frame[5]), 0
    while near[count] >= 0:
        count += 1
    for k in range(count):
        for m in range(count):
            one, other, sign = near[k], near[m], signs[near[k], near[m]]
            if one >= other or sign == 0:
                continue
            a, b, c = (local[k, 0] - local[m, 0], local[k, 1] - local[m, 1],
                       local[k, 2] - local[m, 2])
            for p in range(len(chosen)):
                square = pixels[2, p] * pixels[2, p]
                limit = threshold2 * (variance + depth_floor2 * square * square)
                difference = a * pixels[0, p] + b * pixels[1, p] + c
                if (chosen[p] == one or chosen[p] == other) and difference * difference < limit:
                    chosen[p] = one if sign * difference > 0 else other
