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
    index = np.full(count + 1, -1, np.int32)
    index[kept] = np.arange(len(kept))
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


def relative_squares(grid: CellGrid, disparity: np.ndarray, labels: np.ndarray,
                     planes: np.ndarray) -> np.ndarray:
    """Return the sum (K,) of ((1/z - plane) / (1/z))**2 over the pixels of each plane (K, 3)."""
    return _squares(np.ascontiguousarray(disparity), np.ascontiguousarray(labels),
                    np.ascontiguousarray(planes), np.array([grid.width_px, *grid.origin]))


@kernel('float64[::1](float32[:, ::1], int32[:, ::1], float64[:, ::1], float64[::1])')
def _squares(disparity, labels, planes, frame):
    total = np.zeros(len(planes))
    slope = (planes[:, 0] / frame[0]).astype(np.float32)
    start = np.empty(len(planes), np.float32)
    for v in range(labels.shape[0]):
        for k in range(len(planes)):
            start[k] = (planes[k, 0] * frame[1] + planes[k, 1] * (frame[2] + v / frame[0])
                        + planes[k, 2])
        for u in range(labels.shape[1]):
            k = labels[v, u]
            if k >= 0:
                relative = np.float32(1) - (start[k] + slope[k] * np.float32(u)) / max(
                    disparity[v, u], np.float32(TINY_DISPARITY))
                total[k] += relative * relative
    return total
