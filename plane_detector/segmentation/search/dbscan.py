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

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import DbscanConfig


def with_margin(grid: np.ndarray, margin: int) -> np.ndarray:
    """Return a grid (R, C) with a margin of -1; its rows have an odd length."""
    rows, columns = grid.shape
    wide = np.full((rows + 2 * margin, (columns + 2 * margin) | 1), -1, grid.dtype)
    wide[margin:margin + rows, margin:margin + columns] = grid
    return wide


@lru_cache(maxsize=8)
def cell_places(shape: tuple[int, int], margin: int) -> np.ndarray:
    """Return the index of the cell at each place of a grid with a margin."""
    return with_margin(np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape), margin)


@lru_cache(maxsize=8)
def neighbour_steps(eps: float, stride: int) -> np.ndarray:
    """Return the steps (m,) to the cells within ``eps`` in a flat grid with rows of a length."""
    reach = range(-int(eps), int(eps) + 1)
    return np.array([i * stride + j for i in reach for j in reach if i * i + j * j <= eps**2])


def label_clusters(labels: np.ndarray, dbscan: DbscanConfig) -> tuple[np.ndarray, int]:
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
    count : int

    """
    (rows, columns), margin = labels.shape, int(dbscan.eps)
    wide = with_margin(labels.astype(np.int16), margin)
    clusters, count = _cluster(wide.reshape(-1), neighbour_steps(dbscan.eps, wide.shape[1]),
                               dbscan.min_samples)
    clusters = clusters.reshape(wide.shape)[margin:margin + rows, margin:margin + columns]
    return np.ascontiguousarray(clusters), count


@kernel('Tuple((int32[::1], int64))(int16[::1], int64[::1], int64)', is_short=True)
def _cluster(labels, steps, min_samples):
    """Return the cluster of each place, and their number; clustered places lose their label."""
    clusters, queue, count = np.full(len(labels), np.int32(-1)), np.empty(len(labels), np.int64), 0
    is_core = _core_places(labels, steps, min_samples)
    for start in range(len(labels)):
        if is_core[start] and labels[start] >= 0:
            for k in range(grow_cluster(queue, 0, start, (labels, is_core), steps)):
                clusters[queue[k]] = count
            count += 1
    return clusters, count


@kernel('boolean[::1](int16[::1], int64[::1], int64)')
def _core_places(labels, steps, min_samples):
    """Return the places of cores: labelled, with enough neighbours of their label."""
    reach, is_core = steps[-1], np.zeros(len(labels), np.bool_)
    count, least = len(labels) - 2 * reach, np.int16(min_samples)
    here, found = labels[reach:reach + count], is_core[reach:reach + count]
    samples = np.zeros(count, np.int16)
    for j in range(len(steps)):  # step by step, so that the loop over places is vectorised
        there = labels[reach + steps[j]:reach + steps[j] + count]
        for k in range(count):
            samples[k] += np.int16(here[k] == there[k])
    for k in range(count):
        found[k] = (here[k] >= 0) & (samples[k] >= least)
    return is_core


@kernel('int64(int64[::1], int64, int64, Tuple((int16[::1], boolean[::1])), int64[::1])')
def grow_cluster(queue, end, start, grids, steps):
    """
    Append the density cluster of a core to a queue of places; return where the queue ends.

    Its cells lose their label, since a cell is in one cluster.
    """
    (labels, is_core), head, here = grids, end, start
    label = labels[start]
    while True:
        if is_core[here]:
            for k in range(len(steps)):  # twice as fast as a loop over the array
                p = np.uint64(here + steps[k])  # unsigned: no wrap-around check
                if labels[p] == label:
                    queue[end], labels[p] = p, -1
                    end += 1
        if head == end:
            return end
        here, head = queue[head], head + 1
