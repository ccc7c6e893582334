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
from plane_detector.geometry.robust import median
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.regions.adjacency import find_adjacency

# Pixel noise above this many times the floor is smoothed before pixels are labelled.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
SMOOTHED_GRAIN = 2.0
# derived: the median of 9 pixels has about 1.25 / 3 of their standard deviation.
MEDIAN_SIDE_PX, MEDIAN_NOISE_SHARE = 3, 0.41
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
    smooth, pixel_sigma = _smoothed(image.values, noise)
    grid = cells.grid
    variance = noise.mean_sigma**2 + pixel_sigma**2
    frame = np.array([grid.width_px, *grid.origin, threshold**2, variance,
                      noise.depth_floor_m**2, noise.disparity_floor**2])
    return _label(smooth, image.valid, np.ascontiguousarray(regions.labels), cells.is_planar,
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


def _smoothed(disparity: np.ndarray, noise: Noise) -> tuple[np.ndarray, float]:
    """Return the disparity with its pixel noise reduced, edges kept, and the remaining sigma."""
    typical = median(disparity[::7, ::7].ravel())
    if noise.pixel_sigma <= SMOOTHED_GRAIN * np.sqrt(noise.variance_floor(typical)):
        return disparity, noise.pixel_sigma
    return cv2.medianBlur(disparity, MEDIAN_SIDE_PX), MEDIAN_NOISE_SHARE * noise.pixel_sigma


@kernel('int32[:, ::1](float32[:, ::1], boolean[:, ::1], int32[:, ::1], boolean[::1], '
        'Tuple((float64[:, ::1], int8[:, ::1])), Tuple((int64, float64[::1])))')
def _label(disparity, valid, cell_labels, is_planar, planes, geometry):
    """Return the label of every pixel."""
    (coefficients, signs), (size, frame) = planes, geometry
    height, width = disparity.shape
    labels = np.full((height, width), np.int32(-1))
    near, local = np.empty(9, np.int32), np.empty((9, 3), np.float32)
    for i in range(cell_labels.size):
        row, column = i // cell_labels.shape[1], i % cell_labels.shape[1]
        count, agree = _labels_around(cell_labels, row, column, near)
        if count == 0:
            continue
        top, left = row * size, column * size
        bottom, right = min(top + size, height), min(left + size, width)
        if count == 1 and agree and is_planar[i]:
            for v in range(top, bottom):
                for u in range(left, right):
                    labels[v, u] = near[0] if valid[v, u] else -1
            continue
        _at_corner(coefficients, near[:count], frame, (top, left), local)
        for v in range(top, bottom):
            _choose(disparity[v, left:right], valid[v, left:right], np.float32(v - top),
                    local[:count], near[:count], frame[3:], labels[v, left:right])
            if count > 1:
                _choose_sides(disparity[v, left:right], np.float32(v - top), local[:count],
                              near[:count], signs, frame[3:], labels[v, left:right])
    return labels


@kernel('void(float64[:, ::1], int32[::1], float64[::1], UniTuple(int64, 2), float32[:, ::1])')
def _at_corner(coefficients, near, frame, corner, local):
    """Write the planes as affine functions of column and row relative to a corner."""
    width, x, y = frame[0], frame[1] + corner[1] / frame[0], frame[2] + corner[0] / frame[0]
    for k in range(len(near)):
        a, b, c = coefficients[near[k], 0], coefficients[near[k], 1], coefficients[near[k], 2]
        local[k, 0], local[k, 1], local[k, 2] = a / width, b / width, a * x + b * y + c


@kernel('Tuple((int64, boolean))(int32[:, ::1], int64, int64, int32[::1])')
def _labels_around(labels, row, column, near):
    """Write the labels of the 3 x 3 cells around one; return their number and if all agree."""
    count, agree = 0, True
    for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, labels.shape[1])):
            label, is_new = labels[r, c], labels[r, c] >= 0
            agree &= label >= 0
            for k in range(count):
                is_new &= near[k] != label
            if is_new:
                near[count] = label
                count += 1
    return count, agree


@kernel('void(float32[::1], boolean[::1], float32, float32[:, ::1], int32[::1], float64[::1], '
        'int32[::1])')
def _choose(disparity, valid, v, local, near, limits, chosen):
    """Write the plane of smallest residual for the pixels of one row of a cell, -1 none."""
    threshold2, variance, depth_floor2, disparity_floor2 = (
        np.float32(limits[0] * PIXEL_TOLERANCE**2), np.float32(limits[1]), np.float32(limits[2]),
        np.float32(limits[3]))
    for u in range(len(chosen)):
        d = disparity[u]
        square = d * d
        best = threshold2 * (variance + disparity_floor2 + depth_floor2 * square * square)
        label = np.int32(-1)
        for k in range(len(near)):
            error = d - (local[k, 0] * np.float32(u) + local[k, 1] * v + local[k, 2])
            if error * error <= best:
                best, label = error * error, near[k]
        chosen[u] = label if valid[u] else np.int32(-1)


@kernel('void(float32[::1], float32, float32[:, ::1], int32[::1], int8[:, ::1], float64[::1], '
        'int32[::1])')
def _choose_sides(disparity, v, local, near, signs, limits, chosen):
    """Relabel the pixels close to intersections, where residuals are ambiguous, by their side."""
    threshold2, variance, depth_floor2, disparity_floor2 = (
        np.float32(limits[0]), np.float32(limits[1]), np.float32(limits[2]),
        np.float32(limits[3]))
    for i in range(len(near)):
        for j in range(len(near)):
            if near[i] >= near[j] or signs[near[i], near[j]] == 0:
                continue
            a, b, c = (local[i, 0] - local[j, 0], local[i, 1] - local[j, 1],
                       local[i, 2] - local[j, 2])
            for u in range(len(chosen)):
                if chosen[u] != near[i] and chosen[u] != near[j]:
                    continue
                square = disparity[u] * disparity[u]
                limit = threshold2 * (variance + disparity_floor2 + depth_floor2 * square * square)
                difference = a * np.float32(u) + b * v + c
                if difference * difference < limit:
                    is_first = signs[near[i], near[j]] * difference > 0
                    chosen[u] = near[i] if is_first else near[j]
