# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels of cells to labels of pixels.

If all neighbours of a cell have its label, its pixels get this label. In cells along borders each
pixel chooses among the planes nearby. If two planes intersect along their border, the side of the
intersection decides, which does not depend on noise; at a step the residual of the pixel decides.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.regions.adjacency import find_adjacency

# Pixel noise above this many times the floor is smoothed before pixels are labelled.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
SMOOTHED_GRAIN = 2.0
# derived: the median of 9 pixels has about 1.25 / 3 of their standard deviation.
MEDIAN_NOISE_SHARE = 0.41
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
    if pixel_sigma > SMOOTHED_GRAIN * np.sqrt(noise.variance_floor(grid.typical_disparity)):
        values, pixel_sigma = image.smoothed, MEDIAN_NOISE_SHARE * pixel_sigma
    frame = np.array([grid.width_px, *grid.origin, threshold**2,
                      noise.mean_sigma**2 + pixel_sigma**2 + noise.disparity_floor**2,
                      noise.depth_floor_m**2])
    around, square = regions.labels.astype(np.int16), np.ones((3, 3), np.uint8)
    is_same = (cv2.dilate(around, square) == cv2.erode(around, square))
    return _label(values, image.valid, np.ascontiguousarray(regions.labels),
                  (is_same, is_same & cells.is_planar.reshape(grid.shape)),
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


@kernel('int32[:, ::1](float32[:, ::1], boolean[:, ::1], int32[:, ::1], '
        'UniTuple(boolean[:, ::1], 2), Tuple((float64[:, ::1], int8[:, ::1])), '
        'Tuple((int64, float64[::1])))')
def _label(disparity, valid, cell_labels, inner, planes, geometry):
    """Return the label of every pixel."""
    (is_same, is_inside), (coefficients, signs), (size, frame) = inner, planes, geometry
    (height, width), (rows, columns) = disparity.shape, cell_labels.shape
    labels = np.full((height, width), np.int32(-1))
    near, local, place = np.empty(9, np.int32), np.empty((9, 3), np.float32), np.arange(size**2)
    u, v = (place % size).astype(np.float32), (place // size).astype(np.float32)
    values, error, chosen = np.zeros_like(u), np.empty_like(u), np.empty(size**2, np.int32)
    for row in range(rows):
        for column in range(columns):
            label = cell_labels[row, column]
            if is_same[row, column] and label < 0:
                continue
            top, left = row * size, column * size
            high, wide = min(size, height - top), min(size, width - left)
            if is_inside[row, column]:
                chosen[:] = label
            else:
                count = _labels_around(cell_labels, row, column, near)
                for i in range(high):
                    for j in range(wide):
                        values[i * size + j] = disparity[top + i, left + j]
                _at_corner(coefficients, near[:count], frame, (top, left), local)
                _choose(values, (u, v), (local, near, count), frame, (error, chosen))
                for k in range(count):
                    for m in range(count):
                        if near[k] < near[m] and signs[near[k], near[m]] != 0:
                            _choose_side(values, (u, v), (local, near, k, m),
                                         (frame, signs[near[k], near[m]]), chosen)
            for i in range(high):
                for j in range(wide):
                    labels[top + i, left + j] = (chosen[i * size + j] if valid[top + i, left + j]
                                                 else np.int32(-1))
    return labels


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


@kernel('void(float64[:, ::1], int32[::1], float64[::1], UniTuple(int64, 2), float32[:, ::1])')
def _at_corner(coefficients, near, frame, corner, local):
    """Write the planes as affine functions of column and row relative to a corner."""
    width, x, y = frame[0], frame[1] + corner[1] / frame[0], frame[2] + corner[0] / frame[0]
    for k in range(len(near)):
        a, b, c = coefficients[near[k], 0], coefficients[near[k], 1], coefficients[near[k], 2]
        local[k, 0], local[k, 1], local[k, 2] = a / width, b / width, a * x + b * y + c


@kernel('void(float32[::1], UniTuple(float32[::1], 2), '
        'Tuple((float32[:, ::1], int32[::1], int64)), float64[::1], '
        'Tuple((float32[::1], int32[::1])))')
def _choose(values, place, planes, frame, best):
    """Write the squared residual of the best plane for the pixels of a cell, and its label."""
    (u, v), (local, near, count), (error, chosen) = place, planes, best
    tolerance2 = np.float32(frame[3] * PIXEL_TOLERANCE**2)
    variance, depth_floor2 = np.float32(frame[4]), np.float32(frame[5])
    for p in range(len(values)):
        square = values[p] * values[p]
        error[p] = tolerance2 * (variance + depth_floor2 * square * square)
        chosen[p] = -1
    for k in range(count):
        a, b, c, label = local[k, 0], local[k, 1], local[k, 2], near[k]
        for p in range(len(values)):
            residual = values[p] - (a * u[p] + b * v[p] + c)
            chosen[p] = label if residual * residual <= error[p] else chosen[p]
            error[p] = min(error[p], residual * residual)


@kernel('void(float32[::1], UniTuple(float32[::1], 2), '
        'Tuple((float32[:, ::1], int32[::1], int64, int64)), Tuple((float64[::1], int8)), '
        'int32[::1])')
def _choose_side(values, place, planes, limits, chosen):
    """Relabel the pixels close to an intersection, where residuals are alike, by their side."""
    (u, v), (local, near, k, m), (frame, sign) = place, planes, limits
    threshold2, variance, depth_floor2 = (np.float32(frame[3]), np.float32(frame[4]),
                                          np.float32(frame[5]))
    a, b, c = local[k, 0] - local[m, 0], local[k, 1] - local[m, 1], local[k, 2] - local[m, 2]
    for p in range(len(values)):
        square = values[p] * values[p]
        limit = threshold2 * (variance + depth_floor2 * square * square)
        difference = a * u[p] + b * v[p] + c
        if (chosen[p] == near[k] or chosen[p] == near[m]) and difference * difference < limit:
            chosen[p] = near[k] if sign * difference > 0 else near[m]
