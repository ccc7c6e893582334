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

from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.grid import around
from plane_detector.segmentation.cells.model import CellModel, Patches, chi_squared
from plane_detector.segmentation.search.dbscan import label_clusters

SWEEPS = 4
# The labels are settled when no more than this share of the cells changes.
SETTLED_SHARE = 0.004
# Beyond this many squared thresholds every misfit is as bad.
MISFIT_CAP = 3.0
# A cell that may belong to a plane by its neighbours is let go only beyond this many.
RELEASE = 1.6
# What one neighbour's agreement is worth, in units of chi-squared.
AGREEMENT = 1.5
# A cell whose nine cells all agree stays if it fits this well: the ninth is for rounding.
SURE_VOTES = 8
# A plane competes for cells up to this many cells away from its own.
REACH_CELLS = 2
# derived: CV_CN_MAX of OpenCV 5 (512 in OpenCV 4); an array with more is no image to it.
MOST_CHANNELS = 128


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
    count = len(patches.planes)
    cost = _costs(model, patches, threshold)
    active = _unsettled(cost, patches.labels)
    labels = np.where(patches.labels < 0, count, patches.labels)
    for _ in range(SWEEPS):
        votes = _votes(labels, active, count + 1)
        updated = labels.copy()
        updated.ravel()[active] = (cost[active] - np.float32(AGREEMENT) * votes).argmin(axis=1)
        changed, labels = updated != labels, updated
        if np.count_nonzero(changed) <= SETTLED_SHARE * labels.size:
            break
        # Elsewhere the neighbours vote as before.
        active = np.flatnonzero(cv2.dilate(changed.view(np.uint8), _square(1)))
    return np.where(labels == count, -1, labels)


def _costs(model: CellModel, patches: Patches, threshold: float) -> np.ndarray:
    """Return what each plane, and last no plane, costs each cell, (R * C, K + 1) float32."""
    count = len(patches.planes)
    cap = MISFIT_CAP * threshold**2
    cost = np.empty((patches.labels.size, count + 1), np.float32)
    cost[:, :count] = np.minimum(chi_squared(model, patches.planes), cap)
    cost[:, count] = RELEASE * threshold**2
    # A cell on an edge says nothing itself: its neighbours decide.
    cost[~model.planar] = 0
    members = np.eye(count + 1, count, dtype=np.uint8)[patches.labels]
    near = _dilated_each(members).reshape(-1, count)
    np.copyto(cost[:, :count], cap, where=near == 0)
    return cost


def _dilated_each(members: np.ndarray) -> np.ndarray:
    """Return the members (R, C, K) uint8 of each plane, grown by the reach."""
    starts = range(0, members.shape[2], MOST_CHANNELS)
    parts = [cv2.dilate(np.ascontiguousarray(members[..., k:k + MOST_CHANNELS]),
                        _square(REACH_CELLS)) for k in starts]
    return np.concatenate([part.reshape(*members.shape[:2], -1) for part in parts], axis=2)


def _unsettled(cost: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """
    Return the cells whose label may change.

    A cell amid its plane stays there when it fits it better than the agreement of its neighbours
    is worth, and one without any plane in reach goes on having none.
    """
    known = (labels + 1).astype(np.uint16)
    amid = cv2.dilate(known, _square(1)) == cv2.erode(known, _square(1))
    own = cost[np.arange(labels.size), labels.ravel()].reshape(labels.shape)
    settled = np.where(known > 0, amid & (own < SURE_VOTES * AGREEMENT),
                       cv2.dilate(known, _square(REACH_CELLS)) == 0)
    return np.flatnonzero(~settled)


def _votes(labels: np.ndarray, cell: np.ndarray, classes: int) -> np.ndarray:
    """Return how many of the nine cells around some (n,) have each label, (n, K + 1) float32."""
    key = around(labels, cell) + classes * np.arange(len(cell))[:, None]
    votes = np.bincount(key.ravel(), minlength=classes * len(cell))
    return votes.reshape(-1, classes).astype(np.float32)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _split(model: CellModel, labels: np.ndarray, min_pixels: float,
           dbscan: DbscanConfig) -> Patches:
    """Cut each label into its density clusters, drop the small ones and fit the others."""
    clusters = label_clusters(labels, dbscan.eps, dbscan.min_samples).ravel()
    pixels = np.bincount(clusters + 1, model.grid.moments[:, cells.N] * model.planar)[1:]
    kept = np.flatnonzero(pixels >= max(min_pixels, 1)).astype(clusters.dtype)
    members = (clusters == kept[:, None]) & model.planar
    planes = cells.fit_planes(members.astype(float) @ model.grid.moments)
    fitted = np.isfinite(planes).all(axis=1)
    renumbered = np.full(len(pixels) + 1, -1, np.int32)
    renumbered[kept[fitted]] = np.arange(fitted.sum())
    return Patches(renumbered[clusters].reshape(labels.shape), planes[fitted])
