# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels of cells to labels of pixels.

If all neighbours of a cell have its label, its pixels get this label. In cells along borders each
pixel chooses among the planes nearby. If two planes intersect along their border, the side of the
intersection decides, which does not depend on noise; at a step the residual of the pixel decides.
On depth good enough to show creases a cell most of whose pixels choose another plane is that
plane's, and its neighbours choose again: borders end where the pixels want them.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.regions.adjacency import find_adjacency
from plane_detector.segmentation.search.plane_search import sees_creases

# derived: the median of 9 pixels has about 1.25 / 3 of their standard deviation.
MEDIAN_NOISE_SHARE = 0.41
# derived: a border moves by one cell a sweep, and hardly any is farther off.
SWEEPS = 16
# Tolerance of pixels over that of the cells.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
PIXEL_TOLERANCE = 1.3


def label_pixels(image: DisparityImage, cells: WeightedCells, regions: PlaneRegions, noise: Noise,
                 threshold: float) -> np.ndarray:
    """
    Label every pixel.

    Parameters
    ----------
    image : DisparityImage
    cells : WeightedCells
    regions : PlaneRegions
    noise : Noise
    threshold : float
        Inlier threshold in standard deviations.

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
    around, square = regions.labels.astype(np.int16), np.ones((3, 3), np.uint8)
    is_amid = cv2.dilate(around, square) == cv2.erode(around, square)
    is_open = ~(is_amid & (cells.is_planar.reshape(grid.shape) | (around < 0)))
    sweeps = SWEEPS if sees_creases(grid, noise, threshold) else 1
    return _label(values, image.valid, (np.ascontiguousarray(regions.labels), is_open, sweeps),
                  (np.ascontiguousarray(regions.coefficients),
                   find_intersections(cells, regions)), (grid.size_px, frame))


def find_intersections(cells: WeightedCells, regions: PlaneRegions) -> np.ndarray:
    """
    Find the pairs of touching regions whose planes intersect along their border.

    Returns
    -------
    (K, K) int8
        Entry i, j is the sign of 1/z of plane min(i, j) minus the other plane, on the side of
        min(i, j); 0 if one is in front of the other or they do not touch.

    """
    signs = np.zeros((len(regions.coefficients),) * 2, np.int8)
    adjacency = find_adjacency(cells, regions.labels)
    here, there = adjacency.sides(regions.coefficients)
    crossing = here * there < 0
    first, second = adjacency.first[crossing], adjacency.second[crossing]
    signs[first, second] = signs[second, first] = np.sign(here[crossing])
    return signs


@kernel('int32[:, ::1](float32[:, ::1], boolean[:, ::1], '
        'Tuple((int32[:, ::1], boolean[:, ::1], int64)), '
        'Tuple((float64[:, ::1], int8[:, ::1])), Tuple((int64, float64[::1])))')
def _label(disparity, valid, cells, planes, geometry):
    """Return the label of every pixel, given labels of cells and where pixels choose."""
    (labels, is_open, sweeps), size = cells, geometry[0]
    found, (rows, columns) = np.full(disparity.shape, np.int32(-1)), labels.shape
    scratch = np.zeros((4, size**2), np.float32)
    for p in range(size**2):
        scratch[0, p], scratch[1, p] = p % size, p // size
    work = np.empty(9, np.int32), np.empty((9, 3), np.float32), scratch, np.empty(size**2,
                                                                                  np.int32)
    for sweep in range(sweeps):
        chosen, is_next, is_settled = labels.copy(), np.zeros(labels.shape, np.bool_), True
        for row in range(rows):
            for column in range(columns):
                label, place = labels[row, column], (row * size, column * size)
                if is_open[row, column]:
                    count = _choose_plane(disparity, (labels, row, column), planes, geometry, work)
                    asked = work[0][:count if sweeps > 1 else 0]
                    winner = _write(found, valid, place, size, (work[3], asked))
                    if label >= 0 and winner >= 0 and winner != label:
                        chosen[row, column], is_settled = winner, False
                        is_next[max(row - 1, 0):row + 2, max(column - 1, 0):column + 2] = True
                elif sweep == 0 and label >= 0:
                    work[3][:] = label
                    _write(found, valid, place, size, (work[3], work[0][:0]))
        labels, is_open = chosen, is_next
        if is_settled:
            break
    return found


@kernel('int32(int32[:, ::1], boolean[:, ::1], UniTuple(int64, 2), int64, '
        'UniTuple(int32[::1], 2))')
def _write(found, valid, corner, size, choice):
    """Write the labels of a cell's pixels; return the one that most of them have, or -1."""
    (top, left), (chosen, near) = corner, choice
    for i in range(min(size, found.shape[0] - top)):
        for j in range(min(size, found.shape[1] - left)):
            found[top + i, left + j] = (chosen[i * size + j] if valid[top + i, left + j]
                                        else np.int32(-1))
    for label in near:
        votes = 0
        for p in range(len(chosen)):
            votes += chosen[p] == label
        if 2 * votes > len(chosen):
            return label
    return np.int32(-1)


@kernel('int64(float32[:, ::1], Tuple((int32[:, ::1], int64, int64)), '
        'Tuple((float64[:, ::1], int8[:, ::1])), Tuple((int64, float64[::1])), '
        'Tuple((int32[::1], float32[:, ::1], float32[:, ::1], int32[::1])))')
def _choose_plane(disparity, cell, planes, geometry, work):
    """Choose among the planes around a cell for each of its pixels; return their number."""
    (labels, row, column), (coefficients, signs), (size, frame) = cell, planes, geometry
    near, local, scratch, chosen = work
    count = _labels_around(labels, row, column, near)
    top, left = row * size, column * size
    for i in range(min(size, disparity.shape[0] - top)):
        for j in range(min(size, disparity.shape[1] - left)):
            scratch[2, i * size + j] = disparity[top + i, left + j]
    for k in range(count):
        a, b, c = coefficients[near[k], 0], coefficients[near[k], 1], coefficients[near[k], 2]
        local[k, 0], local[k, 1] = a / frame[0], b / frame[0]
        local[k, 2] = a * (frame[1] + left / frame[0]) + b * (frame[2] + top / frame[0]) + c
    _choose_nearest(scratch, local, near[:count], frame, chosen)
    for k in range(count):
        for m in range(count):
            if near[k] < near[m] and signs[near[k], near[m]] != 0:
                _choose_side(scratch, local, (near, k, m), (frame, signs[near[k], near[m]]),
                             chosen)
    return count


@kernel('int64(int32[:, ::1], int64, int64, int32[::1])')
def _labels_around(labels, row, column, near):
    """Write the labels of the 3 x 3 cells around one; return their number."""
    count = 0
    for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, labels.shape[1])):
            is_new = labels[r, c] >= 0
            for k in range(count):
                is_new &= near[k] != labels[r, c]
            if is_new:
                near[count] = labels[r, c]
                count += 1
    return count


@kernel('void(float32[:, ::1], float32[:, ::1], int32[::1], float64[::1], int32[::1])')
def _choose_nearest(scratch, local, near, frame, chosen):
    """Write the plane of smallest residual of each pixel, -1 where all are too far."""
    u, v, values, error = scratch[0], scratch[1], scratch[2], scratch[3]
    tolerance2 = np.float32(frame[3] * PIXEL_TOLERANCE**2)
    variance, depth_floor2 = np.float32(frame[4]), np.float32(frame[5])
    for p in range(len(chosen)):
        square = values[p] * values[p]
        error[p] = tolerance2 * (variance + depth_floor2 * square * square)
        chosen[p] = -1
    for k in range(len(near)):
        a, b, c, label = local[k, 0], local[k, 1], local[k, 2], near[k]
        for p in range(len(chosen)):
            residual = values[p] - (a * u[p] + b * v[p] + c)
            chosen[p] = label if residual * residual <= error[p] else chosen[p]
            error[p] = min(error[p], residual * residual)


@kernel('void(float32[:, ::1], float32[:, ::1], Tuple((int32[::1], int64, int64)), '
        'Tuple((float64[::1], int8)), int32[::1])')
def _choose_side(scratch, local, pair, limits, chosen):
    """Relabel the pixels close to an intersection, where residuals are alike, by their side."""
    (near, k, m), (frame, sign) = pair, limits
    u, v, values = scratch[0], scratch[1], scratch[2]
    threshold2, variance = np.float32(frame[3]), np.float32(frame[4])
    depth_floor2 = np.float32(frame[5])
    a, b, c = local[k, 0] - local[m, 0], local[k, 1] - local[m, 1], local[k, 2] - local[m, 2]
    for p in range(len(chosen)):
        square = values[p] * values[p]
        limit = threshold2 * (variance + depth_floor2 * square * square)
        difference = a * u[p] + b * v[p] + c
        if (chosen[p] == near[k] or chosen[p] == near[m]) and difference * difference < limit:
            chosen[p] = near[k] if sign * difference > 0 else near[m]
