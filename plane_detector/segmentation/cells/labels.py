# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels of pixels: renumbered, removed, counted in cells, compared with their planes."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid

# Lower bound of the disparity, to avoid division by 0.
# derived: far below what any sensor measures.
TINY_DISPARITY = 1e-9


def relabel_sequential(labels: np.ndarray, kept: np.ndarray, count: int) -> np.ndarray:
    """Return labels in which ``kept`` of ``count`` labels are 0, 1, ..., all others -1."""
    if len(kept) == count and (kept == np.arange(count)).all():
        return labels
    index = np.full(count, -1, np.int32)
    index[kept] = np.arange(len(kept))
    return rename_labels(labels, index)


def rename_labels(labels: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Return labels in which k is ``names[k]``; -1 stays."""
    index = np.append(names, -1).astype(np.int32)
    return map_labels(labels, index)


def map_labels(labels: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return ``index`` (K + 1,) int32 of labels (H, W) int32; its last entry is that of -1."""
    if (index[:-1] == np.arange(len(index) - 1)).all() and index[-1] == -1:
        return labels
    return _renumbered(np.ascontiguousarray(labels, np.int32), index)


@kernel('int32[:, ::1](int32[:, ::1], int32[::1])')
def _renumbered(labels, index):
    found = np.empty_like(labels)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            found[i, j] = index[labels[i, j]]  # -1 is the last entry
    return found


def remove_regions(labels: np.ndarray, planes: np.ndarray,
                   removed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and planes (K, m) without some of the planes; their labels are -1."""
    kept = np.delete(np.arange(len(planes)), removed)
    return relabel_sequential(labels, kept, len(planes)), planes[kept]


def count_labels(grid: CellGrid, labels: np.ndarray, count: int) -> np.ndarray:
    """Return how many pixels of each label each cell has, (R * C, K) float64."""
    return _count(np.ascontiguousarray(labels), grid.size_px, count)


@kernel('float64[:, ::1](int32[:, ::1], int64, int64)')
def _count(labels, size, count):
    height, width = labels.shape
    columns = -(-width // size)
    counts = np.zeros((-(-height // size) * columns, count))
    for v in range(height):
        for column in range(columns):
            cell = v // size * columns + column
            for u in range(column * size, min(column * size + size, width)):
                if labels[v, u] >= 0:
                    counts[cell, labels[v, u]] += 1
    return counts


def sum_over_pixels(grid: CellGrid, disparity: np.ndarray, labels: np.ndarray,
                    planes: np.ndarray) -> np.ndarray:
    """
    Sum over the pixels of each plane, in one pass over the image.

    Parameters
    ----------
    grid : CellGrid
        Of the disparity.
    disparity : (H, W) float32
        1/z.
    labels : (H, W) int32
        Index into the planes, -1 for none.
    planes : (K, 3) float64
        1/z = a x + b y + c.

    Returns
    -------
    (K, 15) float64
        The ten moments, each cell's shared by its pixels; z x, z y, z and z**3 of the plane at
        the middle of the cells; and the square of (1/z - plane) / (1/z).

    """
    return _sum_over_pixels(np.ascontiguousarray(labels), np.ascontiguousarray(disparity),
                            np.ascontiguousarray(planes), (grid.moments, grid.mean, grid.size_px),
                            np.array([grid.width_px, *grid.origin]))


@kernel('float64[:, ::1](int32[:, ::1], float32[:, ::1], float64[:, ::1], '
        'Tuple((float64[:, ::1], float64[:, ::1], int64)), float64[::1])')
def _sum_over_pixels(labels, disparity, planes, cells, frame):
    moments, mean, size = cells
    (height, width), count = labels.shape, len(planes)
    sums, columns = np.zeros((count, 15)), -(-width // size)
    pixels = np.zeros((columns, count), np.int64)
    for top in range(0, height, size):
        pixels[:] = 0
        for v in range(top, min(top + size, height)):
            end = 0
            while end < width:
                start, k = end, labels[v, end]
                while end < width and labels[v, end] == k:
                    end += 1
                if k < 0:
                    continue
                for column in range(start // size, (end - 1) // size + 1):
                    left = max(start, column * size)
                    pixels[column, k] += min(end, column * size + size) - left
                slope = planes[k, 0] / frame[0]
                first = (planes[k, 0] * (frame[1] + start / frame[0])
                         + planes[k, 1] * (frame[2] + v / frame[0]) + planes[k, 2])
                sums[k, 14] += _relative_square(disparity[v, start:end], first, slope)
        for column in range(columns):
            cell = top // size * columns + column
            for k in range(count):
                if pixels[column, k] > 0:
                    _add_cell(moments[cell], mean[cell], planes[k], pixels[column, k], sums[k])
    return sums


@kernel('float64(float32[::1], float64, float64)')
def _relative_square(disparity, first, slope):
    """Return the squared relative residual of pixels of a row to a plane."""
    total = np.float32(0)
    first, slope = np.float32(first), np.float32(slope)
    for u in range(len(disparity)):
        relative = np.float32(1) - (first + slope * np.float32(u)) / max(
            disparity[u], np.float32(TINY_DISPARITY))
        total += relative * relative
    return total


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
    sums[13] += pixels * depth**3
