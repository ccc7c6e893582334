# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels of cells and pixels: renamed, and counted in cells."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid


def relabel_sequential(labels: np.ndarray, kept: np.ndarray, count: int) -> np.ndarray:
    """Return labels in which ``kept`` of ``count`` labels are 0, 1, ..., all others -1."""
    names = np.full(count, -1, np.int32)
    names[kept] = np.arange(len(kept))
    return rename_labels(labels, names)


def rename_labels(labels: np.ndarray, names: np.ndarray, none: int = -1) -> np.ndarray:
    """Return labels (H, W) int32 in which k is ``names[k]``, and -1 is ``none``."""
    if none == -1 and names.tolist() == list(range(len(names))):
        return labels
    return _renamed(np.ascontiguousarray(labels, np.int32),
                    np.concatenate([[none], names]).astype(np.int32))


@kernel('int32[:, ::1](int32[:, ::1], int32[::1])')
def _renamed(labels, names):
    found = np.empty_like(labels)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            found[i, j] = names[np.uint32(labels[i, j] + 1)]  # unsigned: no wrap-around check
    return found


def at_borders(labels: np.ndarray, reach: int) -> np.ndarray:
    """Return which labels (H, W) int32 have another so near in rows and columns, (H, W) bool."""
    square, values = np.ones((2 * reach + 1,) * 2, np.uint8), labels.astype(np.int16)
    return cv2.dilate(values, square) != cv2.erode(values, square)


def count_labels(grid: CellGrid, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the number of pixels of each label in each cell, (R * C, K) float64."""
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
