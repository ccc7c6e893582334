# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
All planes compete for every cell, and neighbours prefer to agree.

Planes found one after the other keep whatever cell they met first; here each cell goes to the
plane that explains it best, and the planes are refitted, as in PEaRL (Isack and Boykov 2012). The
energy, a capped chi-squared per cell and a Potts term, is lowered by iterated conditional modes.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector import cells
from plane_detector.config import DbscanConfig
from plane_detector.dbscan import label_clusters
from plane_detector.ransac import CellModel, Patches, chi_squared

SWEEPS = 4
# The labels are settled when no more than this share of the cells changes.
SETTLED_SHARE = 0.004
# Beyond this many squared thresholds every misfit is as bad.
MISFIT_CAP = 3.0
# A cell that may belong to a plane by its neighbours is let go only beyond this many.
RELEASE = 1.6
# What one neighbour's agreement is worth, in units of chi-squared.
AGREEMENT = 1.5
# A plane competes for cells up to this many cells away from its own.
REACH_CELLS = 2


def relabel(model: CellModel, patches: Patches, threshold: float, min_pixels: float,
            dbscan: DbscanConfig) -> Patches:
    """
    Reassign all cells to planes and refit the planes.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    threshold : float
        Beyond this many standard deviations a cell would rather belong to no plane.
    min_pixels : float
        Smaller clusters are given up.
    dbscan : DbscanConfig
        Splits planes into clusters; pieces far apart become planes of their own.

    Returns
    -------
    Patches

    """
    if len(patches.planes) == 0:
        return patches
    labels = _compete(model, patches, threshold)
    return _split(model, labels, min_pixels, dbscan)


def _compete(model: CellModel, patches: Patches, threshold: float) -> np.ndarray:
    """Return the label (R, C) of each cell that lowers the energy."""
    shape, count = patches.labels.shape, len(patches.planes)
    cost = _costs(model, patches, threshold)
    labels = np.where(patches.labels < 0, count, patches.labels).astype(np.uint16)
    classes = np.arange(count + 1, dtype=np.uint16)
    for _ in range(SWEEPS):
        votes = (labels[..., None] == classes).view(np.uint8)
        votes = cv2.boxFilter(votes, cv2.CV_8U, (3, 3), normalize=False,
                              borderType=cv2.BORDER_REPLICATE).reshape(*shape, -1)
        updated = (cost - np.float32(AGREEMENT) * votes).argmin(axis=2).astype(np.uint16)
        changed, labels = np.count_nonzero(updated != labels), updated
        if changed <= SETTLED_SHARE * labels.size:
            break
    return np.where(labels == count, -1, labels.astype(np.int32))


def _costs(model: CellModel, patches: Patches, threshold: float) -> np.ndarray:
    """Return what each plane, and last no plane, costs each cell, (R, C, K + 1) float32."""
    shape, count = patches.labels.shape, len(patches.planes)
    cap = MISFIT_CAP * threshold**2
    misfit = np.minimum(chi_squared(model, patches.planes), cap)
    cost = np.empty((*shape, count + 1), np.float32)
    cost[..., :count] = misfit.reshape(*shape, count)
    cost[..., count] = RELEASE * threshold**2
    # A cell on an edge says nothing itself: its neighbours decide.
    cost[~model.planar.reshape(shape)] = 0
    members = (patches.labels[..., None] == np.arange(count)).astype(np.uint8)
    side = 2 * REACH_CELLS + 1
    near = cv2.dilate(members, np.ones((side, side), np.uint8)).reshape(*shape, count)
    cost[..., :count][near == 0] = cap
    return cost


def _split(model: CellModel, labels: np.ndarray, min_pixels: float,
           dbscan: DbscanConfig) -> Patches:
    """Cut each label into its density clusters, drop the small ones and fit the others."""
    clusters = label_clusters(labels, dbscan.eps, dbscan.min_samples).ravel()
    pixels = np.bincount(clusters + 1, model.grid.moments[:, cells.N] * model.planar)[1:]
    kept = np.flatnonzero(pixels >= max(min_pixels, 1))
    members = (clusters[:, None] == kept).T & model.planar
    planes = cells.fit_planes(members.astype(float) @ model.grid.moments)
    fitted = np.isfinite(planes).all(axis=1)
    renumbered = np.full(len(pixels) + 1, -1, np.int32)
    renumbered[kept[fitted]] = np.arange(fitted.sum())
    return Patches(renumbered[clusters].reshape(labels.shape), planes[fitted])
