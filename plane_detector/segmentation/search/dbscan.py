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
    clusters, count = _cluster(labels, near.offsets, near.min_samples)
    return clusters, count


@kernel('Tuple((int32[:, ::1], int64))(int32[:, ::1], int64[:, ::1], int64)')
def _cluster(labels, offsets, min_samples):
    rows, columns = labels.shape
    clusters = np.full((rows, columns), np.int32(-1))
    queue = np.empty((labels.size, 2), np.int32)
    count = 0
    for row in range(rows):
        for column in range(columns):
            if (labels[row, column] < 0 or clusters[row, column] >= 0
                    or not _is_core(labels, row, column, offsets, min_samples)):
                continue
            clusters[row, column] = count
            queue[0, 0], queue[0, 1] = row, column
            head, tail = 0, 1
            while head < tail:
                i, j = queue[head, 0], queue[head, 1]
                head += 1
                if not _is_core(labels, i, j, offsets, min_samples):
                    continue
                for k in range(len(offsets)):
                    r, c = i + offsets[k, 0], j + offsets[k, 1]
                    if (0 <= r < rows and 0 <= c < columns and clusters[r, c] < 0
                            and labels[r, c] == labels[i, j]):
                        clusters[r, c] = count
                        queue[tail, 0], queue[tail, 1] = r, c
                        tail += 1
            count += 1
    return clusters, count


@kernel('boolean(int32[:, ::1], int64, int64, int64[:, ::1], int64)')
def _is_core(labels, row, column, offsets, min_samples):
    found = 0
    for k in range(len(offsets)):
        r, c = row + offsets[k, 0], column + offsets[k, 1]
        if (0 <= r < labels.shape[0] and 0 <= c < labels.shape[1]
                and labels[r, c] == labels[row, column]):
            found += 1
    return found >= min_samples
