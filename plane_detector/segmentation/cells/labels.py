# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels of pixels: renumbered, removed, counted in cells."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.grid import CellGrid


def renumber(labels: np.ndarray, kept: np.ndarray, count: int) -> np.ndarray:
    """Return labels in which ``kept`` of ``count`` labels are 0, 1, ..., all others -1."""
    if len(kept) == count and (kept == np.arange(count)).all():
        return labels
    # One look-up serves -1 too: it is the last entry.
    renumbered = np.full(max(count + 1, 256), -1, np.int32)
    renumbered[kept] = np.arange(len(kept))
    if len(renumbered) == 256:  # labels are bytes then, which takes half the time
        return cv2.LUT(labels.astype(np.uint8), renumbered)
    return renumbered.take(labels, mode='wrap')


def without(labels: np.ndarray, planes: np.ndarray,
            gone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and planes (K, m) without some of the planes; their labels are -1."""
    kept = np.delete(np.arange(len(planes)), gone)
    return renumber(labels, kept, len(planes)), planes[kept]


def count_labels(grid: CellGrid, labels: np.ndarray, count: int) -> np.ndarray:
    """Return how many pixels of each label each cell has, (R * C, K) float64."""
    rows, columns, size = *grid.shape, grid.size_px
    across = cells.blocks(labels, size, fill=-1).reshape(rows, size, columns * size)
    # Short rows are slow to reduce: once down each cell, it is turned to reduce down again.
    highest, lowest = (
        reduce(np.ascontiguousarray(reduce(across, axis=1).reshape(-1, size).T), axis=0)
        for reduce in (np.max, np.min))
    counts = np.zeros((rows * columns, count + 1))
    # Most cells have one label.
    counts[np.arange(rows * columns), highest + 1] = size**2
    at_row, at_column = np.divmod(np.flatnonzero(highest != lowest), columns)
    mixed = cells.pixels_of_cells(labels, size, at_row, at_column, -1).reshape(-1, size**2)
    key = mixed + (1 + (count + 1) * np.arange(len(mixed)))[:, None]
    found = np.bincount(key.ravel(), minlength=len(mixed) * (count + 1))
    counts[at_row * columns + at_column] = found.reshape(-1, count + 1)
    return counts[:, 1:]
