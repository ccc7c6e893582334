# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels of cells and pixels: renamed, counted in cells, and their connected components."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
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
    return _renamed(np.ascontiguousarray(labels, np.int32), names.astype(np.int32), none)


@kernel('int32[:, ::1](int32[:, ::1], int32[::1], int32)')
def _renamed(labels, names, none):
    index, found = np.full(len(names) + 1, none), np.empty_like(labels)
    for k in range(len(names)):
        index[k + 1] = names[k]
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            found[i, j] = index[np.uint32(labels[i, j] + 1)]  # unsigned: no wrap-around check
    return found


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


@kernel('Tuple((int32[:, ::1], int64[::1], int64[::1]))(int32[:, ::1])')
def connected_pieces(labels):
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
    start, parent, count = _joined_runs(labels)
    flat, pieces = labels.reshape(-1), np.empty(labels.size, np.int32)
    number, pixels = np.empty(count, np.int32), np.zeros((2, count), np.int64)
    found = 0
    for k in range(count):  # parents come before their children
        here = flat[start[k]]
        if here < 0:
            number[k] = -1
        elif parent[k] < k:
            number[k] = number[parent[k]]
        else:
            number[k], pixels[0, found], found = found, here, found + 1
        for i in range(start[k], start[k + 1]):
            pieces[i] = number[k]
        if here >= 0:
            pixels[1, number[k]] += start[k + 1] - start[k]
    return pieces.reshape(labels.shape), pixels[0, :found].copy(), pixels[1, :found].copy()


@kernel('Tuple((int64[::1], int64[::1], int64))(int32[:, ::1])')
def _joined_runs(labels):
    """Return the start and the parent of each run of equal labels in a row, and their number."""
    (rows, columns), flat = labels.shape, labels.reshape(-1)
    start, parent = np.empty(labels.size + 1, np.int64), np.empty(labels.size, np.int64)
    first = count = 0
    for row in range(rows):
        above, first = first, count
        for i in range(row * columns, (row + 1) * columns):
            if i == row * columns or flat[i] != flat[i - 1]:
                start[count], parent[count], count = i, count, count + 1
        start[count] = (row + 1) * columns
        for k in range(first, count):
            while above < first and start[above + 1] + columns <= start[k]:
                above += 1
            for upper in range(above, first):
                if start[upper] + columns >= start[k + 1]:
                    break
                if flat[start[upper]] == flat[start[k]]:
                    _unite(parent, upper, k)
    return start, parent, count


@kernel('void(int64[::1], int64, int64)')
def _unite(parent, a, b):
    """Make the first run of one set the parent of the first run of the other."""
    while parent[a] != a:
        a = parent[a]
    while parent[b] != b:
        b = parent[b]
    parent[max(a, b)] = min(a, b)
