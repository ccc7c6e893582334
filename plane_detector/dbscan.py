# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Density clusters of cells in the grid of the picture (Ester et al. 1996, DBSCAN).

The cells that come here are inliers of one plane, so neighbours in the picture are neighbours in
space too: the gap in disparity between them is bounded by the inlier threshold.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from sklearn.cluster import DBSCAN


def grid_clusters(mask: np.ndarray, eps: float, min_samples: int) -> np.ndarray:
    """
    Cluster the set cells of a grid.

    Parameters
    ----------
    mask : (R, C) bool
    eps : float
        Radius of the neighbourhood in cells.
    min_samples : int
        Cells in the neighbourhood, the cell itself included, that make it a core cell.

    Returns
    -------
    (R, C) int32
        Cluster of each cell from 0, -1 for noise and for cells that are not set.

    """
    if eps >= 2:
        return _by_distance(mask, eps, min_samples)
    set_cells = mask.astype(np.uint8)
    diagonal = eps >= np.sqrt(2)
    shape = cv2.MORPH_RECT if diagonal else cv2.MORPH_CROSS
    neighbourhood = cv2.getStructuringElement(shape, (3, 3))
    density = cv2.filter2D(set_cells, cv2.CV_16S, neighbourhood, borderType=cv2.BORDER_CONSTANT)
    core = (set_cells > 0) & (density >= min_samples)
    _, clusters = cv2.connectedComponents(core.astype(np.uint8), connectivity=8 if diagonal else 4,
                                          ltype=cv2.CV_16U)
    # A border cell joins the last of the clusters that it touches.
    joined = cv2.dilate(clusters, neighbourhood)
    return np.where(core, clusters, joined * set_cells).astype(np.int32) - 1


def label_clusters(labels: np.ndarray, eps: float, min_samples: int) -> np.ndarray:
    """
    Cluster the cells of every label by itself, all at once.

    Parameters
    ----------
    labels : (R, C) int32
        -1 none.
    eps, min_samples
        As in :func:`grid_clusters`.

    Returns
    -------
    (R, C) int32
        Cluster of each cell, -1 for noise and where there is no label; no cluster has two labels.

    """
    if eps >= 2:
        return _clusters_one_by_one(labels, eps, min_samples)
    flat = labels.ravel()
    near, far = _neighbours(labels.shape, diagonal=eps >= np.sqrt(2))
    alike = (flat[near] == flat[far]) & (flat[near] >= 0)
    near, far = near[alike], far[alike]
    density = 1 + np.bincount(near, minlength=flat.size) + np.bincount(far, minlength=flat.size)
    core = (flat >= 0) & (density >= min_samples)
    linked = core[near] & core[far]
    links = coo_array((np.ones(linked.sum(), bool), (near[linked], far[linked])),
                      shape=(flat.size, flat.size))
    _, clusters = connected_components(links, directed=False)
    clusters = np.where(core, clusters, -1).astype(np.int32)
    # A border cell joins the last of the clusters that it touches.
    for cell, neighbour in ((near, far), (far, near)):
        joins = core[neighbour] & ~core[cell]
        np.maximum.at(clusters, cell[joins], clusters[neighbour[joins]])
    return clusters.reshape(labels.shape)


@lru_cache(maxsize=8)
def _neighbours(shape: tuple[int, int], diagonal: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of cells that are neighbours in a grid, each pair once."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    pairs = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])]
    if diagonal:
        pairs += [(index[:-1, :-1], index[1:, 1:]), (index[:-1, 1:], index[1:, :-1])]
    return tuple(np.concatenate([pair[k].ravel() for pair in pairs]) for k in range(2))


def _clusters_one_by_one(labels: np.ndarray, eps: float, min_samples: int) -> np.ndarray:
    out, count = np.full(labels.shape, -1, np.int32), 0
    for label in np.unique(labels[labels >= 0]):
        clusters = grid_clusters(labels == label, eps, min_samples)
        out = np.where(clusters >= 0, clusters + count, out)
        count = int(out.max(initial=-1)) + 1
    return out


def _by_distance(mask: np.ndarray, eps: float, min_samples: int) -> np.ndarray:
    """Cluster with scikit-learn, for neighbourhoods larger than the eight nearest cells."""
    labels = np.full(mask.shape, -1, np.int32)
    if mask.any():
        found = DBSCAN(eps=eps, min_samples=min_samples).fit(np.argwhere(mask))
        labels[mask] = found.labels_
    return labels
