# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Density clusters of cells in the grid of the picture (Ester et al. 1996, DBSCAN).

The cells that come here are inliers of one plane, so neighbours in the picture are neighbours in
space too: the gap in disparity between them is bounded by the inlier threshold.
"""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from sklearn.cluster import DBSCAN

_SQUARE = np.ones((3, 3), np.uint8)
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
_DIAGONAL = 2**0.5
# Slices of the cells of a grid and of their neighbours: right, down, and along the diagonals.
NEIGHBOURS = ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1, :], np.s_[1:, :]))
DIAGONALS = ((np.s_[:-1, :-1], np.s_[1:, 1:]), (np.s_[:-1, 1:], np.s_[1:, :-1]))


class Clustering(Protocol):
    """Which of the cells that fit a plane belong together."""

    def __call__(self, mask: np.ndarray) -> np.ndarray:
        """Return the cluster (R, C) int32 of each set cell of (R, C) bool, -1 for none."""

    def largest_piece(self, mask: np.ndarray, weight: np.ndarray) -> float:
        """Return a bound on the weight (R, C) of any cluster of the set cells."""


class GridDbscan:
    """
    DBSCAN in the grid.

    Parameters
    ----------
    eps, min_samples
        As in :func:`grid_clusters`.

    """

    def __init__(self, eps: float, min_samples: int) -> None:
        self._eps, self._min_samples = eps, min_samples

    def __call__(self, mask: np.ndarray) -> np.ndarray:
        """Return what :func:`grid_clusters` does."""
        return grid_clusters(mask, self._eps, self._min_samples)

    def largest_piece(self, mask: np.ndarray, weight: np.ndarray) -> float:
        """Return what :func:`largest_piece` does."""
        return largest_piece(mask, weight, self._eps)


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
    set_cells = np.ascontiguousarray(mask).view(np.uint8)
    diagonal = eps >= _DIAGONAL
    neighbourhood = _SQUARE if diagonal else _CROSS
    density = cv2.filter2D(set_cells, cv2.CV_8U, neighbourhood, borderType=cv2.BORDER_CONSTANT)
    core = mask & (density >= min_samples)
    _, clusters = cv2.connectedComponents(core.view(np.uint8), connectivity=8 if diagonal else 4,
                                          ltype=cv2.CV_16U)
    # A border cell joins the last of the clusters that it touches.
    joined = cv2.dilate(clusters, neighbourhood) * set_cells
    np.copyto(joined, clusters, where=core)
    return np.subtract(joined, 1, dtype=np.int32)


def largest_piece(mask: np.ndarray, weight: np.ndarray, eps: float) -> float:
    """
    Return a bound on the weight of any cluster, much cheaper than the clusters.

    Parameters
    ----------
    mask : (R, C) bool
    weight : (R, C) float64
        Of each cell; cells that are not set have none.
    eps : float
        As in :func:`grid_clusters`.

    """
    weight = weight * mask
    if eps >= 2:  # clusters leap over gaps
        return float(weight.sum())
    _, pieces = cv2.connectedComponents(np.ascontiguousarray(mask).view(np.uint8), connectivity=8,
                                        ltype=cv2.CV_32S)
    return float(np.bincount(pieces.ravel(), weight.ravel()).max())


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
    sides = _alike(labels, NEIGHBOURS)
    corners = _alike(labels, DIAGONALS) if eps >= _DIAGONAL else []
    density = np.ones(labels.shape, np.int32)
    for near, far, alike in sides + corners:
        density[near] += alike
        density[far] += alike
    core = (labels >= 0) & (density >= min_samples)
    right, down = (alike & core[near] & core[far] for near, far, alike in sides)
    clusters = linked_components(core, right, down)
    for near, far, alike in corners:
        clusters = _united(clusters, near, far, alike & core[near] & core[far])
    return _with_border_cells(clusters, core, sides + corners)


def linked_components(mask: np.ndarray, right: np.ndarray, down: np.ndarray) -> np.ndarray:
    """
    Find the connected components of a grid whose links are given.

    Parameters
    ----------
    mask : (R, C) bool
        Cells that count.
    right : (R, C - 1) bool
        Cells that are linked with the next one in their row.
    down : (R - 1, C) bool
        ... with the next one in their column.

    Returns
    -------
    (R, C) int32
        From 0, -1 where the mask is not set.

    """
    # Cells are the pixels with even coordinates, the links between them the pixels between these.
    picture = np.zeros((2 * mask.shape[0], 2 * mask.shape[1]), np.uint8)
    picture[::2, ::2] = mask
    picture[::2, 1:-1:2] = right
    picture[1:-1:2, ::2] = down
    # Links that touch at a corner have a cell in common; OpenCV is faster with all eight sides.
    _, components = cv2.connectedComponents(picture, connectivity=8, ltype=cv2.CV_32S)
    return components[::2, ::2] - 1


def _alike(labels: np.ndarray, directions: tuple) -> list[tuple]:
    """Return each direction's slices and which neighbours along it have the same label."""
    labelled = labels >= 0
    return [(near, far, (labels[near] == labels[far]) & labelled[near])
            for near, far in directions]


def _united(clusters: np.ndarray, near: tuple, far: tuple, linked: np.ndarray) -> np.ndarray:
    """Unite clusters (R, C) that further links join."""
    first, second = clusters[near][linked], clusters[far][linked]
    apart = first != second
    if not apart.any():
        return clusters
    count = int(clusters.max()) + 1
    links = coo_array((np.ones(apart.sum(), bool), (first[apart], second[apart])),
                      shape=(count, count))
    _, united = connected_components(links, directed=False)
    return np.where(clusters >= 0, united[clusters], -1).astype(np.int32)


def _with_border_cells(clusters: np.ndarray, core: np.ndarray, alike: list[tuple]) -> np.ndarray:
    """Give each cell that is not core the last of the clusters that it touches."""
    joined = clusters.copy()
    for near, far, same in alike:
        for cell, neighbour in ((near, far), (far, near)):
            joins = same & ~core[cell]
            np.maximum(joined[cell], clusters[neighbour], out=joined[cell], where=joins)
    return joined


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
