# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Density clusters of cells in the grid of the picture (Ester et al. 1996, DBSCAN).

The cells that come here are inliers of one plane, so neighbours in the picture are neighbours in
space too: the gap in disparity between them is bounded by the inlier threshold.
"""

from __future__ import annotations

import cv2
import numpy as np
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


def _by_distance(mask: np.ndarray, eps: float, min_samples: int) -> np.ndarray:
    """Cluster with scikit-learn, for neighbourhoods larger than the eight nearest cells."""
    labels = np.full(mask.shape, -1, np.int32)
    if mask.any():
        found = DBSCAN(eps=eps, min_samples=min_samples).fit(np.argwhere(mask))
        labels[mask] = found.labels_
    return labels
