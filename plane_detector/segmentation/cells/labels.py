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
    names = np.full(count, -1, np.int32)
    names[kept] = np.arange(len(kept))
    return rename_labels(labels, names)


def rename_labels(labels: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Return labels (H, W) int32 in which k is ``names[k]``; -1 stays."""
    if (names == np.arange(len(names))).all():
        return labels
    return _renamed(np.ascontiguousarray(labels, np.int32), names.astype(np.int32))


@kernel('int32[:, ::1](int32[:, ::1], int32[::1])')
def _renamed(labels, names):
    index, found = np.full(len(names) + 1, np.int32(-1)), np.empty_like(labels)
    index[1:] = names
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            found[i, j] = index[np.uint32(labels[i, j] + 1)]  # unsigned: no wrap-around check
    return found


def remove_regions(labels: np.ndarray, planes: np.ndarray,
                   removed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and planes (K, m) without some of the planes; their labels are -1."""
    kept = np.delete(np.arange(len(planes)), removed)
    return relabel_sequential(labels, kept, len(planes)), planes[kept]


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


def connected_pieces(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Find the connected components of equal labels, by shared sides.

    Parameters
    ----------
    labels : (R, C) int32
        -1 none.

    Returns
    -------
    pieces : (R, C) int32
        -1 where there is no label.
    label, size : (n,) int64
        Of each piece.

    """
    return _pieces(np.ascontiguousarray(labels))


@kernel('Tuple((int32[:, ::1], int64[::1], int64[::1]))(int32[:, ::1])')
def _pieces(labels):
    rows, columns = labels.shape
    pieces, count = np.full((rows, columns), np.int32(-1)), 0
    first, queue = np.empty(labels.size + 1, np.int64), np.empty((labels.size, 2), np.int64)
    head = tail = 0
    for row in range(rows):
        for column in range(columns):
            label = labels[row, column]
            if label < 0 or pieces[row, column] >= 0:
                continue
            pieces[row, column], first[count] = count, tail
            queue[tail, 0], queue[tail, 1] = row, column
            tail += 1
            while head < tail:
                i, j = queue[head, 0], queue[head, 1]
                head += 1
                for r, c in ((i - 1, j), (i, j - 1), (i, j + 1), (i + 1, j)):
                    if (0 <= r < rows and 0 <= c < columns and labels[r, c] == label
                            and pieces[r, c] < 0):
                        pieces[r, c], queue[tail, 0], queue[tail, 1] = count, r, c
                        tail += 1
            count += 1
    first[count] = tail
    label = np.empty(count, np.int64)
    for k in range(count):
        label[k] = labels[queue[first[k], 0], queue[first[k], 1]]
    return pieces, label, np.diff(first[:count + 1])
