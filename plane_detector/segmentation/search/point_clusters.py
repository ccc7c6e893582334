# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
DBSCAN (Ester et al. 1996) of points in space, in little memory.

scikit-learn keeps the neighbours of all points at once: if all points are within the radius of
each other, 20 000 points take 5 GB. Here those of one point are kept, and the search can be
stopped. The clusters and their numbers are the same.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from plane_detector.stopping import raise_if_stopped


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
        Cluster of each point, in the order of their first core points; -1 for noise. A border
        point belongs to the first of the clusters that reach it.

    """
    labels, count = np.full(len(points_m), -1), 0
    if not len(points_m):
        return labels
    tree = cKDTree(points_m)
    is_core = tree.query_ball_point(points_m, eps_m, return_length=True) >= min_samples
    for first in np.flatnonzero(is_core):
        if labels[first] >= 0:
            continue
        labels[first], waiting = count, [first]
        while waiting:
            raise_if_stopped()
            near = np.array(tree.query_ball_point(points_m[waiting.pop()], eps_m))
            new = near[labels[near] < 0]
            labels[new] = count
            waiting.extend(new[is_core[new]])
        count += 1
    return labels
