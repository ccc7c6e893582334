# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sums over the pixels of each plane, from which its extent, position and errors follow.

Most cells have pixels of one plane only: these are counted by columns of the image, over whole
rows of cells at a time. Cells with pixels of several planes are read once more for each other one.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.labels import TINY_DISPARITY
from plane_detector.segmentation.cells.pixel_regions import PixelRegions


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
        The ten moments, each cell's shared by its pixels; z x, z y, z and z**3 of the plane at
        the middle of the cells; and the square of (1/z - plane) / (1/z).

    """
    grid = regions.grid
    if not len(regions.coefficients):
        return np.zeros((0, 15))
    return _sum_over_pixels(
        np.ascontiguousarray(regions.labels), np.ascontiguousarray(regions.disparity),
        np.ascontiguousarray(regions.coefficients), (grid.moments, grid.mean, grid.size_px),
        np.array([grid.width_px, *grid.origin]))


@kernel('UniTuple(float32, 3)(float64[::1], int64, int64, float64[::1])')
def _in_cell(plane, top, left, frame):
    """Return a plane as its slopes along u and v and its value at the corner of a cell."""
    a, b = plane[0] / frame[0], plane[1] / frame[0]
    at_corner = plane[0] * frame[1] + a * left + plane[1] * frame[2] + b * top + plane[2]
    return np.float32(a), np.float32(b), np.float32(at_corner)


@kernel('void(int32[:, ::1], UniTuple(int64, 3), int32[::1])')
def _find_owners(labels, band, owners):
    """Write the largest label of the cell of each column."""
    (top, bottom, size), width = band, labels.shape[1]
    owners[:] = -1
    for v in range(top, bottom):
        for u in range(width):
            owners[u] = max(owners[u], labels[v, u])
    for left in range(0, width, size):
        owner = np.int32(-1)
        for u in range(left, min(left + size, width)):
            owner = max(owner, owners[u])
        for u in range(left, min(left + size, width)):
            owners[u] = owner


@kernel('void(int32[:, ::1], float32[:, ::1], UniTuple(int64, 2), int32[::1], float32[:, ::1])')
def _sum_columns(labels, disparity, rows, owners, columns):
    """
    Sum over the pixels of each column in a row of cells.

    ``columns`` (5, W) has the plane of the owner at the top and its slope downwards; written are
    the owner's pixels, their squared relative residuals, and the pixels of other planes.
    """
    columns[2:] = 0
    for v in range(rows[0], rows[1]):
        down = np.float32(v - rows[0])
        for u in range(labels.shape[1]):
            relative = np.float32(1) - (columns[0, u] + down * columns[1, u]) / max(
                disparity[v, u], np.float32(TINY_DISPARITY))
            is_own = labels[v, u] == owners[u]
            columns[2, u] += np.float32(is_own)
            columns[3, u] += relative * relative if is_own else np.float32(0)
            columns[4, u] += np.float32((not is_own) & (labels[v, u] >= 0))


@kernel('void(float64[::1], float64[::1], float64[::1], int64, float64[::1])')
def _add_cell(moments, mean, plane, pixels, sums):
    """Add the share of a cell that some of its pixels have to the sums (15,) of a plane."""
    share = pixels / max(moments[0], 1.0)
    for j in range(10):
        sums[j] += share * moments[j]
    depth = 1 / max(plane[0] * mean[0] + plane[1] * mean[1] + plane[2], TINY_DISPARITY)
    sums[10] += pixels * depth * mean[0]
    sums[11] += pixels * depth * mean[1]
    sums[12] += pixels * depth
    sums[13] += pixels * depth * depth * depth


@kernel('Tuple((int64, int64, float64))(int32[:, ::1], float32[:, ::1], UniTuple(int64, 4), '
        'float64[:, ::1], float64[::1])')
def _sum_next(labels, disparity, cell, planes, frame):
    """Return the largest label of a cell below the one given, its pixels, their residuals."""
    top, left, size, before = cell
    bottom, right = min(top + size, labels.shape[0]), min(left + size, labels.shape[1])
    label, pixels, total = np.int32(-1), 0, np.float32(0)
    for v in range(top, bottom):
        for u in range(left, right):
            label = max(label, labels[v, u] if labels[v, u] < before else np.int32(-1))
    a, b, at_corner = _in_cell(planes[label], top, left, frame)
    for v in range(top, bottom):
        for u in range(left, right):
            plane = a * np.float32(u - left) + b * np.float32(v - top) + at_corner
            relative = np.float32(1) - plane / max(disparity[v, u], np.float32(TINY_DISPARITY))
            pixels += labels[v, u] == label
            total += relative * relative if labels[v, u] == label else np.float32(0)
    return label, pixels, total


@kernel('float64[:, ::1](int32[:, ::1], float32[:, ::1], float64[:, ::1], '
        'Tuple((float64[:, ::1], float64[:, ::1], int64)), float64[::1])')
def _sum_over_pixels(labels, disparity, planes, cells, frame):
    """Return the sums (K, 15) over the pixels of planes (K, 3), K at least 1."""
    (moments, mean, size), (height, width) = cells, labels.shape
    sums, columns = np.zeros((len(planes), 15)), np.empty((5, width), np.float32)
    owners, cell = np.empty(width, np.int32), -1
    for top in range(0, height, size):
        _find_owners(labels, (top, min(top + size, height), size), owners)
        for left in range(0, width, size):
            a, b, at_corner = _in_cell(planes[owners[left]], top, left, frame)
            for u in range(left, min(left + size, width)):
                columns[0, u], columns[1, u] = at_corner + a * np.float32(u - left), b
        _sum_columns(labels, disparity, (top, min(top + size, height)), owners, columns)
        for left in range(0, width, size):
            cell, k, own, square, others = cell + 1, np.int64(owners[left]), 0.0, 0.0, 0.0
            for u in range(left, min(left + size, width)):
                own += columns[2, u]
                square += columns[3, u]
                others += columns[4, u]
            pixels = int(own)
            while k >= 0:
                _add_cell(moments[cell], mean[cell], planes[k], pixels, sums[k])
                sums[k, 14] += square
                if others == 0:
                    break
                k, pixels, square = _sum_next(labels, disparity, (top, left, size, k), planes,
                                              frame)
                others -= pixels
    return sums
