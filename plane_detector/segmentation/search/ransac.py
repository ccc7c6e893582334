# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The best plane: hypotheses from windows of cells, all scored at once, the best one refined.

RANSAC (Fischler and Bolles 1981) with the truncated quadratic score of MSAC (Torr and Zisserman
2000) and local optimisation (Chum et al. 2003). The samples are windows of cells, not triples of
points: a window is on one plane far more often than three points are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.config import RansacConfig
from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.model import CellModel, Patches, chi_squared, monomials
from plane_detector.segmentation.search.dbscan import Clustering
from plane_detector.stopping import raise_if_stopped

# Rows and columns: small windows find small planes, long ones narrow planes, and large ones see
# through the noise.
WINDOWS_CELLS = ((3, 3), (2, 7), (7, 2), (9, 9))
WINDOW_MIN_FREE = 0.7
WINDOW_MAX_VARIANCES = 2.5
# One round finds, with the configured confidence, the planes with this share of the free cells.
ROUND_PLANE_SHARE = 0.1
REFINEMENTS = 4
# A plane is settled when its cells change by no more than this share.
SETTLED_SHARE = 0.03
# A hypothesis that refines to nothing costs time; after this many in a row the round is over.
MAX_FAILURES = 3












def collect(model: CellModel, found: list[tuple[np.ndarray, np.ndarray]]) -> Patches:
    """Turn what :func:`peel_planes` yields, planes and their cells, into patches."""
    labels = np.full(model.planar.shape, -1, np.int32)
    for k, (_, members) in enumerate(found):
        labels[members] = k
    planes = np.array([plane for plane, _ in found]).reshape(-1, 3)
    return Patches(labels.reshape(model.grid.shape), planes)


def peel_planes(model: CellModel, min_pixels: float, ransac: RansacConfig,
                clustering: Clustering, rng: np.random.Generator,
                taken: np.ndarray | bool = False) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """
    Find planes among the cells, take them out, go on until none is left.

    Parameters
    ----------
    model : CellModel
    min_pixels : float
        Smallest plane.
    ransac : RansacConfig
    clustering : Clustering
        Tells which inliers of a plane belong together.
    rng : numpy.random.Generator
        Draws the windows.
    taken : (R * C,) bool, optional
        Cells that belong to planes already; default: none.

    Yields
    ------
    plane : (3,) float64
        1/z = a x + b y + c.
    members : (R * C,) bool
        Its cells.

    """
    free, drawn, found = model.planar & np.logical_not(taken), 0, True
    shape = model.grid.shape
    count = model.grid.moments[:, cells.N].reshape(shape)
    while (found and drawn < ransac.max_iterations
           and clustering.largest_piece(free.reshape(shape), count) >= min_pixels):
        raise_if_stopped()
        found = False
        batch = _draw(model, free, min_pixels, ransac, rng)
        drawn += len(batch.planes)
        for plane, members in _peel_batch(model, batch, free, min_pixels, ransac, clustering):
            found = True
            free &= ~members
            yield plane, members


@dataclass
class _Batch:
    """Hypotheses (H, 3), their seed cells (H,), and what of their support is still free."""

    planes: np.ndarray
    seeds: np.ndarray
    cells: np.ndarray
    support: np.ndarray
    gain: np.ndarray

    def remove(self, taken: np.ndarray) -> None:
        """Take the support of newly assigned cells (R * C,) bool out of every gain."""
        rows = taken[self.cells]
        if rows.mean() > 0.25:  # a product with all of it is faster than a copy of much of it
            self.gain -= rows.astype(float) @ self.support
        else:
            self.gain -= self.support[rows].sum(axis=0)


def _draw(model: CellModel, free: np.ndarray, min_pixels: float, ransac: RansacConfig,
          rng: np.random.Generator) -> _Batch:
    """Fit planes to random windows of free cells and score them on all free cells."""
    members = np.flatnonzero(free)
    count = model.grid.moments[members, 0]
    share = max(ROUND_PLANE_SHARE, min_pixels / max(count.sum(), 1))
    wanted = np.log1p(-ransac.confidence) / np.log1p(-min(share, 0.99))
    wanted = int(np.clip(np.ceil(wanted), 1, ransac.max_iterations))
    planes, seeds = _window_planes(model, free, wanted, rng)
    # MSAC: a cell supports a plane with its pixels, times 1 - (residual / threshold)**2.
    weighted = model.quadratic[members] * (-count / ransac.inlier_threshold**2)[:, None]
    weighted[:, 9] += count
    support = weighted @ monomials(planes)
    np.maximum(support, 0, out=support)
    return _Batch(planes, seeds, members, support, np.ones(len(support)) @ support)


def _window_planes(model: CellModel, free: np.ndarray, wanted: int,
                   rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return planes (h, 3) of random windows that are flat, and their middle cells (h,)."""
    shape = model.grid.shape
    variance = (model.variances.mean + model.variances.grain) * model.grid.moments[:, cells.N]
    integral = cv2.integral(free.reshape(shape).astype(np.uint8))
    planes, middles = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for height, width in WINDOWS_CELLS:
        if height > shape[0] or width > shape[1]:
            continue
        count = (integral[height:, width:] - integral[:-height, width:]
                 - integral[height:, :-width] + integral[:-height, :-width])
        starts = np.flatnonzero(count >= WINDOW_MIN_FREE * height * width)
        if len(starts) > wanted:
            starts = rng.choice(starts, wanted, replace=False)
        rows, columns = np.unravel_index(starts, count.shape)
        window = ((rows[:, None, None] + np.arange(height)[:, None]) * shape[1]
                  + columns[:, None, None] + np.arange(width)).reshape(len(starts), height * width)
        fitted, flat = _fit_windows(model, variance, free, window)
        planes.append(fitted[flat])
        middles.append(window[flat, height * width // 2])
    return np.concatenate(planes), np.concatenate(middles)


def _fit_windows(model: CellModel, variance: np.ndarray, free: np.ndarray,
                 window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit planes (n, 3) to the free cells of windows (n, m), and say which are flat (n,)."""
    taken = free[window].astype(float)
    moments = (taken[:, None, :] @ model.grid.moments[window])[:, 0]
    planes = cells.fit_planes(moments)
    with np.errstate(invalid='ignore'):
        flat = (cells.squared_error(planes, moments)
                < WINDOW_MAX_VARIANCES * (taken * variance[window]).sum(axis=1))
    return planes, flat


def _peel_batch(model: CellModel, batch: _Batch, free: np.ndarray, min_pixels: float,
                ransac: RansacConfig, clustering: Clustering):
    """Yield plane and cells of the best hypothesis, take them out, and so on."""
    count, failures = model.grid.moments[:, 0], 0
    while len(batch.gain) and failures < MAX_FAILURES:
        best = int(np.argmax(batch.gain))
        if batch.gain[best] < min_pixels / 2:
            return
        plane, members = refine(model, batch.planes[best], batch.seeds[best], free, ransac,
                                clustering)
        if count[members].sum() < min_pixels:
            batch.gain[best] = 0
            failures += 1
            continue
        failures = 0
        batch.remove(members)
        yield plane, members


def refine(model: CellModel, plane: np.ndarray, seed: int, free: np.ndarray,
           ransac: RansacConfig, clustering: Clustering) -> tuple[np.ndarray, np.ndarray]:
    """
    Refit a plane to its inliers until they settle.

    Only the cluster of inliers around the seed counts, so that a plane does not
    gather streaks off the surfaces that it happens to cut.

    Returns
    -------
    plane : (3,) float64
    members : (R * C,) bool
        All False when the plane holds nothing.

    """
    members = np.zeros(len(free), bool)
    members[seed] = True
    for _ in range(REFINEMENTS):
        inliers = (chi_squared(model, plane) < ransac.inlier_threshold**2) & free
        grown = _around(members, inliers.reshape(model.grid.shape), clustering)
        count = np.count_nonzero(grown)
        if not count:
            return plane, grown
        if np.count_nonzero(grown != members) <= SETTLED_SHARE * count:
            break
        refitted = cells.fit_plane(grown.astype(float) @ model.grid.moments)
        if np.isnan(refitted[0]):
            return plane, np.zeros_like(members)
        plane, members = refitted, grown
    return plane, members


def _around(members: np.ndarray, inliers: np.ndarray, clustering: Clustering) -> np.ndarray:
    """
    Return the cluster of inliers (R, C) that holds most members, (R * C,) bool.

    A seed may be an outlier of its own plane: then the largest cluster.
    """
    clusters = clustering(inliers).ravel()
    for counted in (clusters[members], clusters):
        touched = np.bincount(counted + 1, minlength=2)[1:]
        most = int(touched.argmax())
        if touched[most]:
            return clusters == most
    return np.zeros_like(members)
