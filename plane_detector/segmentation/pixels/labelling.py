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

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.model import WeightedCells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import squared_error
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.segmentation.search.plane_search import sees_creases

# derived: the median of 9 pixels has about 1.25 / 3 of their standard deviation.
MEDIAN_NOISE_SHARE = 0.41
# derived: a border moves by one cell per sweep, and almost none is further off.
SWEEPS = 16
# Tolerance of pixels over that of the cells.
# tuned: rooms, lived-in rooms and sensor frames of seeds below 9000: flat to 1.4 times; at 0.7
# times SC -0.004 to -0.007 below a noise of 0.001.
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
    variances = (noise.mean_sigma**2, noise.pixel_sigma**2,
                 pixel_sigma**2 + noise.disparity_floor**2, noise.depth_floor_m**2)
    sweeps = SWEEPS if sees_creases(grid, noise, threshold) else 1
    return _label((values, image.valid, grid.size_px), (graph.labels, cells.is_planar),
                  (_local_planes(graph.planes, graph.pixels, (grid.width_px, *grid.origin),
                                 variances), graph.intersections()),
                  (threshold**2, variances[0] + variances[2], variances[3]), (sweeps, grows))


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], UniTuple(float64, 3), '
        'UniTuple(float64, 4))')
def _local_planes(planes, pixels, frame, variances):
    """
    Return planes in pixels of the image, and the variance of pixels about each one, (K, 4).

    A plane whose cells fit better than the noise of the whole image says how far its border may
    lie off it; one that fits worse gets no more than that noise. The variance does not include
    the floor of the depth.
    """
    local = np.empty((len(planes), 4))
    for k in range(len(planes)):
        a, b, c = planes[k, 0], planes[k, 1], planes[k, 2]
        local[k, 0], local[k, 1] = a / frame[0], b / frame[0]
        local[k, 2] = a * frame[1] + b * frame[2] + c
        shown = squared_error(a, b, c, pixels[k]) / max(pixels[k, 0], 1.0)
        local[k, 3] = min(max(shown - variances[1], 0.0), variances[0]) + variances[2]
    return local


@kernel('int32[:, ::1](Tuple((float32[:, ::1], boolean[:, ::1], int64)), '
        'Tuple((int32[:, ::1], boolean[::1])), Tuple((float64[:, ::1], int8[:, ::1])), '
        'UniTuple(float64, 3), Tuple((int64, boolean)))')
def _label(image, cells, planes, tolerance, growth):
    """Return the label of every pixel, given labels of cells and which cells are planar."""
    (disparity, valid, size), (labels, is_planar), (sweeps, grows) = image, cells, growth
    (height, width), columns, extent = disparity.shape, labels.shape[1], (0, 0)
    found, near = np.empty(disparity.shape, np.int32), np.full(10, np.int32(-1))
    local, pixels = np.empty((9, 4), np.float32), np.empty((5, size**2), np.float32)
    chosen, offset = np.empty(size**2, np.int32), np.empty(size**2, np.uint64)
    values, is_valid, out = disparity.reshape(-1), valid.reshape(-1), found.reshape(-1)
    is_open = _open_cells(labels, is_planar)
    _fill_cells(found, valid, labels, is_open, size)
    for _ in range(sweeps):
        changed, is_next, is_changed = labels.copy(), np.zeros(labels.shape, np.bool_), False
        for cell in np.flatnonzero(is_open):
            row, column = cell // columns, cell % columns
            if not _find_labels_around(labels, row, column, near):
                continue
            top, left, label = row * size, column * size, labels[row, column]
            if extent != (min(size, height - top), min(size, width - left)):
                extent = (min(size, height - top), min(size, width - left))
                _lay_out(extent, width, offset, pixels)
                chosen = np.empty(extent[0] * extent[1], np.int32)
            first = np.uint64(top * width + left)  # unsigned: no wrap-around check
            for p in range(len(chosen)):
                pixels[2, p] = values[first + offset[p]]
            _move_planes(planes[0], near, (top, left), local)
            _choose_nearest(pixels, chosen, near, local, tolerance)
            _choose_sides(pixels, chosen, near, local, planes[1], tolerance)
            for p in range(len(chosen)):
                out[first + offset[p]] = chosen[p] if is_valid[first + offset[p]] else np.int32(-1)
            winner = _majority(chosen, near) if sweeps > 1 and (grows or label >= 0) else label
            if winner >= 0 and winner != label:
                changed[row, column], is_changed = winner, True
                for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
                    for c in range(max(column - 1, 0), min(column + 2, columns)):
                        is_next[r, c] |= label >= 0 or labels[r, c] < 0
        labels, is_open = changed, is_next
        if not is_changed:
            break
    return found


@kernel('boolean[:, ::1](int32[:, ::1], boolean[::1])')
def _open_cells(labels, is_planar):
    """Return cells with another label around them, and labelled ones that are not planar."""
    is_open = np.empty(labels.shape, np.bool_)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = labels[row, column]
            is_same = label < 0 or is_planar[row * labels.shape[1] + column]
            for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
                for c in range(max(column - 1, 0), min(column + 2, labels.shape[1])):
                    is_same &= labels[r, c] == label
            is_open[row, column] = not is_same
    return is_open


@kernel('void(UniTuple(int64, 2), int64, uint64[::1], float32[:, ::1])')
def _lay_out(extent, width, offset, pixels):
    """Write the pixels of a cell: their distance from its corner in the image, their u and v."""
    for p in range(extent[0] * extent[1]):
        v, u = p // extent[1], p % extent[1]
        offset[p], pixels[0, p], pixels[1, p] = v * width + u, u, v


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


@kernel('void(float64[:, ::1], int32[::1], UniTuple(int64, 2), float32[:, ::1])')
def _move_planes(planes, near, corner, local):
    """Write the planes in pixels from the corner of a cell."""
    for k, label in enumerate(near):
        if label < 0:
            break
        a, b = planes[label, 0], planes[label, 1]
        local[k, 0], local[k, 1], local[k, 3] = a, b, planes[label, 3]
        local[k, 2] = a * corner[1] + b * corner[0] + planes[label, 2]


@kernel('void(float32[:, ::1], int32[::1], int32[::1], float32[:, ::1], UniTuple(float64, 3))')
def _choose_nearest(pixels, chosen, near, local, tolerance):
    """Write the plane of smallest residual of each pixel, -1 where all are too far."""
    tolerance2 = np.float32(tolerance[0] * PIXEL_TOLERANCE**2)
    depth_floor2 = np.float32(tolerance[2])
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
        'UniTuple(float64, 3))')
def _choose_sides(pixels, chosen, near, local, signs, tolerance):
    """Relabel the pixels close to an intersection, where residuals are alike, by their side."""
    threshold2, variance = np.float32(tolerance[0]), np.float32(tolerance[1])
    depth_floor2, count = np.float32(tolerance[2]), 0
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
