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
        Rows and columns to the cells of the neighbourhood, the cell itself included. Empty: all
        cells form one cluster.
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
        -1 none.
    near : Neighbourhood

    Returns
    -------
    clusters : (R, C) int32
        Cluster of each cell, -1 for noise and where there is no label; no cluster has two labels.
    count : int

    """
    return _cluster(np.ascontiguousarray(labels), near.offsets, near.min_samples)


@kernel('Tuple((int32[:, ::1], int64))(int32[:, ::1], int64[:, ::1], int64)')
def _cluster(labels, offsets, min_samples):
    (rows, columns), margin, count = labels.shape, offsets.max(), 0
    stride, found = columns + 2 * margin, np.empty_like(labels)
    # Loops, as numba takes a second to compile each assignment to a slice.
    left = np.full((rows + 2 * margin) * stride, np.int16(-1))
    for row in range(rows):
        for column in range(columns):
            left[(row + margin) * stride + column + margin] = labels[row, column]
    steps = offsets[:, 0] * stride + offsets[:, 1]
    clusters, queue = np.full(left.shape, np.int32(-1)), np.empty(labels.size + 1, np.int64)
    samples = count_samples(left, steps)
    for start in range(margin * stride, len(left) - margin * stride):
        if left[start] >= 0 and samples[start] >= min_samples:
            for k in range(grow_cluster(queue, 0, start, (left, samples), (steps, min_samples))):
                clusters[queue[k]] = count
            count += 1
    for row in range(rows):
        for column in range(columns):
            found[row, column] = clusters[(row + margin) * stride + column + margin]
    return found, count


@kernel('int16[::1](int16[::1], int64[::1])')
def count_samples(labels, steps):
    """Return how many cells of the neighbourhood of each cell have its label."""
    samples, first, last = np.zeros(len(labels), np.int16), steps.max(), len(labels) - steps.max()
    count, here = samples[first:last], labels[first:last]
    for step in steps:
        there = labels[first + step:last + step]
        for k in range(len(count)):  # slices of one length: vectorised
            count[k] += np.int16(there[k] == here[k])
    return samples


@kernel('int64(int64[::1], int64, int64, UniTuple(int16[::1], 2), Tuple((int64[::1], int64)))')
def grow_cluster(queue, end, start, cells, near):
    """
    Append the density cluster of a core cell to a queue.

    Parameters
    ----------
    queue : (n,) int64
        Output: the indices of the cells.
    end : int
        Where the queue ends.
    start : int
        The core cell.
    cells : (labels, samples)
        Labels (m,) int16 of a grid with a margin, -1 none: the labels of the cluster are removed;
        and what :func:`count_samples` returns of them.
    near : (steps, min_samples)
        Steps to the cells of the neighbourhood, and how many of them a core cell has.

    Returns
    -------
    int
        Where the queue ends now.

    """
    (labels, samples), (steps, min_samples), head = cells, near, end
    label, queue[end], labels[start] = labels[start], start, -1
    end += 1
    while head < end:
        p = queue[head]
        head += 1
        if samples[p] >= min_samples:
            for step in steps:
                queue[end] = p + step
                if labels[p + step] == label:
                    labels[p + step] = -1
                    end += 1
    return end
