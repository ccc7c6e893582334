# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
DBSCAN (Ester et al. 1996) of points in space, in bounded memory.

scikit-learn keeps the neighbours of all points at once: if all points are within the radius of
each other, 20 000 points take 5 GB. Here pairs are processed in parts, and only a component for
each point is kept. The clusters and their numbers are the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from plane_detector.stopping import raise_if_stopped

# derived: 24 bytes each, so that a part takes 48 MB.
PAIRS_AT_ONCE = 2_000_000


def point_clusters(points_m: np.ndarray, eps_m: float, min_samples: int) -> np.ndarray:
    """
    Cluster points by density.

    Parameters
    ----------
    points_m : (n, 3) floating
    eps_m : float
        Radius of the neighbourhood.
    min_samples : int
        Points in the neighbourhood of a core point, including itself.

    Returns
    -------
    (n,) int64
        Cluster of each point, in the order of their first core points; -1 for noise.

    """
    count = len(points_m)
    labels = np.full(count, -1, np.int64)
    if not count:
        return labels
    tree = cKDTree(points_m)
    neighbours = tree.query_ball_point(points_m, eps_m, return_length=True)
    core = np.flatnonzero(neighbours >= min_samples)
    if not len(core):
        return labels
    labels[core] = _components(points_m[core], eps_m, neighbours[core])
    # A border point belongs to the first of the clusters that reach it.
    border = np.flatnonzero(neighbours < min_samples)
    reached = np.full(len(border), len(core), np.int64)
    for first, second in _pairs(points_m[border], cKDTree(points_m[core]), eps_m,
                                neighbours[border]):
        np.minimum.at(reached, first, labels[core[second]])
    labels[border] = np.where(reached < len(core), reached, -1)
    return labels


def _components(points_m: np.ndarray, eps_m: float, neighbours: np.ndarray) -> np.ndarray:
    """Return the component (n,) of each point; numbered in the order of their first points."""
    count = len(points_m)
    component = np.arange(count)
    for first, second in _pairs(points_m, cKDTree(points_m), eps_m, neighbours):
        first, second = component[first], component[second]
        apart = first != second
        if apart.any():
            links = coo_array((np.ones(apart.sum(), bool), (first[apart], second[apart])),
                              shape=(count, count))
            component = connected_components(links, directed=False)[1][component]
    _, first_point, number = np.unique(component, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first_point))[number]


def _pairs(points_m: np.ndarray, tree: cKDTree, eps_m: float,
           neighbours: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """
    Yield, in parts, the indices of points and of those of the tree within the radius.

    Parameters
    ----------
    points_m : (n, 3) floating
    tree : cKDTree
    eps_m : float
    neighbours : (n,) int
        Upper bound of the number of pairs of each point.

    """
    part = np.cumsum(neighbours) // PAIRS_AT_ONCE
    starts = np.flatnonzero(np.diff(part, prepend=-1))
    for start, end in pairwise([*starts, len(points_m)]):
        raise_if_stopped()
        found = cKDTree(points_m[start:end]).sparse_distance_matrix(tree, eps_m,
                                                                    output_type='ndarray')
        yield found['i'] + start, found['j']
