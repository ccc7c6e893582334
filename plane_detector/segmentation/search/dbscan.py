# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Density clusters of cells in the grid of the image (Ester et al. 1996, DBSCAN).

The input cells are inliers of one plane, so neighbours in the image are neighbours in space too:
the inlier threshold bounds the gap in disparity between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import DbscanConfig


@dataclass(frozen=True)
class Neighbourhood:
    """
    Decides which of the cells that fit a plane form one cluster.

    Attributes
    ----------
    offsets : (m, 2) int64
        Rows and columns to the cells of the neighbourhood, the cell itself included.
    min_samples : int
        Cells in the neighbourhood that make a core cell.

    """

    offsets: np.ndarray
    min_samples: int


@lru_cache(maxsize=8)
def neighbourhood(dbscan: DbscanConfig) -> Neighbourhood:
    """Return the cells within ``eps`` of one, and how many of them make a core cell."""
    reach = int(dbscan.eps)
    offsets = np.array([(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)
                        if i * i + j * j <= dbscan.eps**2])
    return Neighbourhood(offsets, dbscan.min_samples)


def label_clusters(labels: np.ndarray, near: Neighbourhood) -> tuple[np.ndarray, int]:
    """
    Cluster the cells of each label separately.

    Parameters
    ----------
    labels : (R, C) int32
        -1 none; below 2**15.
    near : Neighbourhood

    Returns
    -------
    clusters : (R, C) int32
        Cluster of each cell, -1 for noise and where there is no label; no cluster has two labels.
    count : int

    """
    return _cluster(np.ascontiguousarray(labels), near.offsets, near.min_samples)


@kernel('int64(int64[:, ::1])')
def reach_of(offsets):
    """Return the largest row of a symmetric neighbourhood; a loop compiles faster than max."""
    reach = 0
    for k in range(len(offsets)):
        reach = max(reach, offsets[k, 0])
    return reach


@kernel('int64[::1](int64[:, ::1], int64)')
def steps_of(offsets, stride):
    """Return the distances of neighbours in a flat grid with this length of a row."""
    steps = np.empty(len(offsets), np.int64)
    for k in range(len(offsets)):
        steps[k] = offsets[k, 0] * stride + offsets[k, 1]
    return steps


@kernel('Tuple((int32[:, ::1], int64))(int32[:, ::1], int64[:, ::1], int64)', is_short=True)
def _cluster(labels, offsets, min_samples):
    (rows, columns), margin, count = labels.shape, reach_of(offsets), 0
    stride, found = columns + 2 * margin, np.empty_like(labels)
    # Loops, as numba takes a second to compile each assignment to a slice.
    padded = np.full((rows + 2 * margin) * stride, np.int16(-1))
    for row in range(rows):
        first = (row + margin) * stride + margin
        here = padded[first:first + columns]
        for column in range(columns):
            here[column] = labels[row, column]
    steps = steps_of(offsets, stride)
    clusters, queue = np.full(len(padded), np.int32(-1)), np.empty(len(padded), np.int64)
    is_core = _core_places(padded, steps, min_samples)
    for start in range(margin * stride, len(padded) - margin * stride):
        if is_core[start] and padded[start] >= 0:
            for k in range(grow_cluster(queue, 0, start, (padded, is_core), steps)):
                clusters[queue[k]] = count
            count += 1
    for row in range(rows):
        first = (row + margin) * stride + margin
        here = clusters[first:first + columns]
        for column in range(columns):
            found[row, column] = here[column]
    return found, count


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
