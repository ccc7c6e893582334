# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sums over the pixels of each plane, from which its extent, position and errors follow.

In most cells all valid pixels are of one plane: the moments of the cell give the residuals. The
pixels of the other cells are read, once for each of their planes.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.columns import N
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.cells.plane_fit import squared_error

# derived: the columns of the sums behind those of the moments: z x, z y, z and z**3 of the plane
# at the middle of the cells, and the square of (1/z - plane) / (1/z).
XZ, YZ, Z, ZZZ, SQUARE = range(10, 15)
# Lower bound of the disparity, to avoid division by 0.
# derived: far below what any sensor measures.
TINY_DISPARITY = 1e-9


def sum_over_pixels(regions: PixelRegions) -> np.ndarray:
    """
    Sum over the pixels of each plane.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z.

    Returns
    -------
    (K, 15) float64
        The ten moments, each cell's shared by its pixels, and the columns of this module.

    """
    grid = regions.grid
    return _sum_over_pixels(
        np.ascontiguousarray(regions.labels), np.ascontiguousarray(regions.disparity),
        np.ascontiguousarray(regions.coefficients), (grid.moments, grid.mean, grid.size_px),
        np.array([grid.width_px, *grid.origin]))


@kernel('float64[:, ::1](int32[:, ::1], float32[:, ::1], float64[:, ::1], '
        'Tuple((float64[:, ::1], float64[:, ::1], int64)), float64[::1])')
def _sum_over_pixels(labels, disparity, planes, cells, frame):
    """Return the sums (K, 15) over the pixels of planes (K, 3)."""
    (moments, mean, size), (height, width) = cells, labels.shape
    sums, columns, cell = np.zeros((len(planes), 15)), np.empty((2, width), np.int32), -1
    pixels, own = np.zeros((3, size**2), np.float32), np.empty(size**2, np.int32)
    for p in range(size**2):
        pixels[0, p], pixels[1, p] = p % size, p // size
    for top in range(0, height, size):
        _sum_columns(labels, top, min(top + size, height), columns)
        for left in range(0, width, size):
            cell, label, total = cell + 1, np.int32(-1), np.int32(0)
            for u in range(left, min(left + size, width)):
                label, total = max(label, columns[0, u]), total + columns[1, u]
            if label >= 0 and total == (label + 1) * moments[cell, N]:
                plane, middle = planes[label], mean[cell]
                error = squared_error(plane[0], plane[1], plane[2], moments[cell])
                _add_cell(moments[cell], middle, plane, moments[cell, N], sums[label])
                sums[label, SQUARE] += max(error, 0.0) / max(middle[2], TINY_DISPARITY) ** 2
            elif label >= 0:
                _load(labels, disparity, (top, left, size), own, pixels)
                _sum_parts(own, pixels, (planes, moments[cell], mean[cell]), (label, top, left),
                           frame, sums)
    return sums


@kernel('void(int32[:, ::1], int64, int64, int32[:, ::1])')
def _sum_columns(labels, top, bottom, columns):
    """Write the largest label and the sum of label + 1 of each column from top to bottom."""
    for u in range(labels.shape[1]):
        columns[0, u], columns[1, u] = -1, 0
    for v in range(top, bottom):
        for u in range(labels.shape[1]):
            columns[0, u] = max(columns[0, u], labels[v, u])
            columns[1, u] += labels[v, u] + np.int32(1)


@kernel('void(int32[:, ::1], float32[:, ::1], UniTuple(int64, 3), int32[::1], float32[:, ::1])')
def _load(labels, disparity, corner, own, pixels):
    """Copy the labels of a cell, and z to the last row of its pixels, behind their u and v."""
    (top, left, size), least = corner, np.float32(TINY_DISPARITY)
    for p in range(size**2):
        own[p] = -1
    for i in range(min(size, labels.shape[0] - top)):
        for j in range(min(size, labels.shape[1] - left)):
            # Unsigned: no wrap-around check.
            p, v, u = np.uint64(i * size + j), np.uint64(top + i), np.uint64(left + j)
            own[p], pixels[2, p] = labels[v, u], np.float32(1) / max(disparity[v, u], least)


@kernel('void(int32[::1], float32[:, ::1], '
        'Tuple((float64[:, ::1], float64[::1], float64[::1])), UniTuple(int64, 3), '
        'float64[::1], float64[:, ::1])')
def _sum_parts(own, pixels, cell, place, frame, sums):
    """Add the pixels of each label in a cell to the sums; its largest label comes first."""
    (planes, moments, mean), (label, top, left) = cell, place
    while label >= 0:
        plane, this, below = planes[label], np.int32(label), np.int32(-1)
        a, b = np.float32(plane[0] / frame[0]), np.float32(plane[1] / frame[0])
        c = np.float32(plane[0] * (frame[1] + left / frame[0])
                       + plane[1] * (frame[2] + top / frame[0]) + plane[2])
        count, square = np.int32(0), np.float32(0)
        for p in range(len(own)):
            relative = np.float32(1) - (a * pixels[0, p] + b * pixels[1, p] + c) * pixels[2, p]
            count += np.int32(own[p] == this)
            square += relative * relative if own[p] == this else np.float32(0)
            below = max(below, own[p] if own[p] < this else np.int32(-1))
        _add_cell(moments, mean, plane, count, sums[label])
        sums[label, SQUARE] += square
        label = np.int64(below)


@kernel('void(float64[::1], float64[::1], float64[::1], float64, float64[::1])')
def _add_cell(moments, mean, plane, pixels, sums):
    """Add the share of a cell that some of its pixels have to the sums (15,) of a plane."""
    share = pixels / max(moments[N], 1.0)
    for j in range(10):
        sums[j] += share * moments[j]
    depth = 1 / max(plane[0] * mean[0] + plane[1] * mean[1] + plane[2], TINY_DISPARITY)
    sums[XZ] += pixels * depth * mean[0]
    sums[YZ] += pixels * depth * mean[1]
    sums[Z] += pixels * depth
    sums[ZZZ] += pixels * depth * depth * depth
