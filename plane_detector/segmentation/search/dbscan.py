# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Density clusters of cells in the grid of the image (Ester et al. 1996, DBSCAN).

The input cells are inliers of one plane, so neighbours in the image are neighbours in space too:
the inlier threshold bounds the gap in disparity between them. The grid gets a margin, so that all
neighbours of a cell are places in it, and is flat, so that they are a fixed number of steps away.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.config import DbscanConfig

# Type of kernels' arguments: steps to the neighbours in a flat grid, and how many of them, itself
# included, a core cell has.
NEAR = 'Tuple((int64[::1], int64))'


def with_margin(grid: np.ndarray, margin: int) -> np.ndarray:
    """Return a grid (R, C) with a margin of -1."""
    # Rows of odd length: in the flat grid, places of one parity are a checkerboard.
    right = margin + 1 - grid.shape[1] % 2
    return cv2.copyMakeBorder(grid, margin, margin, margin, right, cv2.BORDER_CONSTANT, value=-1)


@lru_cache(maxsize=8)
def cell_places(shape: tuple[int, int], margin: int) -> np.ndarray:
    """Return the index of the cell at each place of a grid with a margin."""
    return with_margin(np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape), margin)


@lru_cache(maxsize=8)
def neighbour_steps(eps: float, stride: int) -> np.ndarray:
    """Return the steps (m,) to the cells within ``eps`` in a flat grid with rows of a length."""
    reach = range(-int(eps), int(eps) + 1)
    return np.array([i * stride + j for i in reach for j in reach if i * i + j * j <= eps**2])


def label_clusters(labels: np.ndarray, dbscan: DbscanConfig
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Cluster the cells of each label separately.

    Parameters
    ----------
    labels : (R, C) int32
        -1 none; below 2**15.
    dbscan : DbscanConfig

    Returns
    -------
    clusters : (R, C) int32
        Cluster of each cell, -1 for noise and where there is no label; no cluster has two labels.
    cells : (N,) int32
        Cells of the clusters, one cluster after the other.
    starts : (K + 1,) int64
        Where each begins in ``cells``, and the end.

    """
    (rows, columns), margin = labels.shape, int(dbscan.eps)
    wide = with_margin(labels.astype(np.int16), margin)
    near = neighbour_steps(dbscan.eps, wide.shape[1]), dbscan.min_samples
    clusters, places, starts = _cluster(wide.reshape(-1), near)
    clusters = clusters.reshape(wide.shape)[margin:margin + rows, margin:margin + columns]
    cells = cell_places(labels.shape, margin).reshape(-1)[places]
    return np.ascontiguousarray(clusters), cells, starts


@kernel(f'Tuple((int32[::1], int64[::1], int64[::1]))(int16[::1], {NEAR})', is_short=True)
def _cluster(labels, near):
    """Return the cluster of each place, the places cluster by cluster, where each starts."""
    clusters, queue = np.full(len(labels), np.int32(-1)), np.empty(len(labels), np.int64)
    is_taken, starts = np.zeros(len(labels), np.bool_), np.zeros(len(labels) + 1, np.int64)
    count, end = 0, 0
    for start in range(len(labels)):
        if labels[start] >= 0 and not is_taken[start]:
            begin, end = end, grow_cluster(queue, end, start, (labels, is_taken), near)
            for k in range(begin, end):
                clusters[queue[k]] = count
            count += end > begin
            starts[count] = end
    return clusters, queue[:end].copy(), starts[:count + 1].copy()


@kernel(f'int64(int64[::1], int64, int64, Tuple((int16[::1], boolean[::1])), {NEAR})')
def grow_cluster(queue, end, start, grids, near):
    """
    Append the density cluster of a core to a queue of places; return where the queue ends.

    Its cells are marked as taken, since a cell is in one cluster. If the start is no core, nothing
    is appended.
    """
    (labels, is_taken), (steps, min_samples), head, here = grids, near, end, start
    label = labels[start]
    while True:
        samples = 0
        for k in range(len(steps)):  # twice as fast as a loop over the array
            samples += labels[np.uint64(here + steps[k])] == label  # unsigned: no wrap-around
        for k in range(len(steps) if samples >= min_samples else 0):
            p = np.uint64(here + steps[k])
            if labels[p] == label and not is_taken[p]:
                queue[end], is_taken[p] = p, True
                end += 1
        if head == end:
            return end
        here, head = queue[head], head + 1
