# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Reject curved regions of measured depth.

Within the tolerance of any method a curtain or a cushion is a row of narrow planes. At low noise
the cells of a single region show the curvature: a quadric fits them far better than a plane
(F-test), and the normal turns from one end to the other. At higher noise pairs of regions show it.
Hysteresis (Canny 1986): a strong bend starts a curved region, weaker bends linked to it join.
"""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells.labels import remove_regions
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import DepthKind
from plane_detector.segmentation.regions.adjacency import (
    MAX_DEVIATIONS,
    MIN_PLANE_CELLS,
    RegionAdjacency,
    find_adjacency,
    sum_up_regions,
)
from plane_detector.segmentation.regions.quadrics import (
    PLANE_TERMS,
    QUADRIC_TERMS,
    TYPICAL_FOCAL_SHARE,
    Quadrics,
    fit_pairs,
    fit_surfaces,
    folds,
    quadric_products,
    sum_up_quadrics,
)

# derived: nine cells for the six terms of a quadric.
MIN_QUADRIC_CELLS = 9
# Threshold of the F-statistic: improvement of the fit by the quadric over the noise.
# tuned: evaluation.benchmark curved; flat from 5 to 15.
MIN_F = 8.0
# tuned: evaluation.benchmark curved, rooms; flat from 1 to 4.
MIN_TURN_DEG = 2.0
# derived: rounding in float32, relative to the disparity.
ROUNDING = 1e-6
# derived: a uniform spread is this many standard deviations wide.
WIDTH_PER_DEVIATION = 12**0.5
# Planes that meet at less than the first angle are one plane with a dent; at more than the second
# they are two planes with an edge.
# tuned: evaluation.benchmark curved, rooms; flat from 6 to 12, from 60 to 80.
MIN_FOLD_DEG, MAX_FOLD_DEG = 10.0, 70.0
# One plane fits worse than the quadric by this many variances: strong bends, and weak ones.
# tuned: evaluation.benchmark curved; flat from 0.7 to 1.5, half of it for the weak ones.
HIGH_THRESHOLD, LOW_THRESHOLD = 1.0, 0.5
# The quadric may fit one of the regions so many times worse than its plane does.
# tuned: evaluation.benchmark curved; flat from 1.5 to 3.
MAX_RATIO = 2.0
# derived: small regions fit their noise: no plane is taken to fit better than these shares of it.
MIN_NOISE_SHARE, MIN_WEAK_NOISE_SHARE = 0.25, 0.8


def remove_curved(cells: WeightedCells, regions: PlaneRegions,
                  noise_density: float) -> PlaneRegions:
    """
    Remove the regions whose own cells show that they are curved.

    Parameters
    ----------
    cells : WeightedCells
    regions : PlaneRegions
    noise_density : float
        Variance of a cell times the number of cells that share their noise.

    Returns
    -------
    PlaneRegions

    """
    if not len(regions.coefficients):
        return regions
    sums = sum_up_regions(cells, regions)
    mean = sums.moments[:, [1, 2, 6]] / sums.count[:, None]
    curved = (sums.count >= MIN_QUADRIC_CELLS) & _is_curved(
        quadric_products(cells, regions.labels, mean), mean[:, 2], noise_density)
    if not curved.any():
        return regions
    return PlaneRegions(*remove_regions(regions.labels, regions.coefficients,
                                        np.flatnonzero(curved)))


def _is_curved(products: np.ndarray, disparity: np.ndarray,
               noise_density: float) -> np.ndarray:
    """Say whether each region (K,) is curved, from its products and mean disparity."""
    count = np.maximum(products[:, 0, 0], QUADRIC_TERMS + 1)
    flat, _ = fit_surfaces(products, PLANE_TERMS)
    curved, quadric = fit_surfaces(products, QUADRIC_TERMS)
    min_variance = np.maximum(noise_density, (ROUNDING * disparity) ** 2)
    variance = np.maximum(curved / (count - QUADRIC_TERMS), min_variance)
    f_statistic = (flat - curved) / 3 / variance
    spread = products[:, 1:3, 1:3] / count[:, None, None]
    return (f_statistic > MIN_F) & (_turn_deg(quadric, spread, disparity) > MIN_TURN_DEG)


def _turn_deg(quadric: np.ndarray, spread: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Return about the angle (K,) by which the normal turns from end to end of each region."""
    xx, xy, yy = 2 * quadric[:, 3], quadric[:, 4], 2 * quadric[:, 5]
    bend = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
    # The bend over the width of the region along each direction: its squares have this trace.
    change = np.sqrt(np.maximum(np.einsum('kij,kjl,kil->k', bend, spread, bend), 0))
    slope = WIDTH_PER_DEVIATION * change * TYPICAL_FOCAL_SHARE
    return np.degrees(np.arctan2(slope, np.maximum(disparity, np.finfo(float).tiny)))


def find_curved(cells: WeightedCells, regions: PlaneRegions, kind: DepthKind) -> np.ndarray:
    """Return the indices (n,) of regions that a quadric explains as well as their planes do."""
    none = np.zeros(0, int)
    if len(regions.coefficients) < 2:
        return none
    adjacency = find_adjacency(cells, regions.labels)
    kept = _may_be_curved(cells, regions, adjacency, kind)
    pairs = np.stack([adjacency.first[kept], adjacency.second[kept]], axis=1)
    if not len(pairs):
        return none
    clear, weak = _judge(sum_up_quadrics(cells, regions), pairs)
    is_curved = np.zeros(len(regions.coefficients), bool)
    is_curved[pairs[clear].ravel()] = True
    return np.flatnonzero(_grow_by_hysteresis(is_curved, pairs[weak]))


def _may_be_curved(cells: WeightedCells, regions: PlaneRegions, adjacency: RegionAdjacency,
                   kind: DepthKind) -> np.ndarray:
    """Say which pairs (P,) of regions are large enough and meet in a blunt fold without a step."""
    labels = regions.labels[regions.labels >= 0]
    count = np.bincount(labels, minlength=len(regions.coefficients))
    fold_deg, gap = folds(cells, regions, adjacency)
    return ((np.minimum(count[adjacency.first], count[adjacency.second]) >= MIN_PLANE_CELLS)
            & (gap < MAX_DEVIATIONS) & (fold_deg < MAX_FOLD_DEG)
            & (fold_deg > (MIN_TURN_DEG if kind is DepthKind.EXACT else MIN_FOLD_DEG)))


def _judge(quadrics: Quadrics, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit a quadric to each pair (P, 2) of regions.

    Returns
    -------
    clear : (P,) bool
        The quadric fits as well as the two planes of the pair, and no single plane fits.
    weak : (P,) bool
        The same, with weaker thresholds.

    """
    plane, joint, errors = fit_pairs(quadrics, *pairs.T)
    gain = (plane - joint) / quadrics.noise[pairs].sum(axis=1)
    own, weak_own = (np.maximum(quadrics.error, share * quadrics.noise)[pairs]
                     for share in (MIN_NOISE_SHARE, MIN_WEAK_NOISE_SHARE))
    clear = ((gain > HIGH_THRESHOLD) & (joint < own.sum(axis=1))
             & (errors < MAX_RATIO * own).all(axis=1))
    weak = (gain > LOW_THRESHOLD) & (errors < MAX_RATIO * weak_own).all(axis=1)
    return clear, weak


def _grow_by_hysteresis(clear: np.ndarray, weak: np.ndarray) -> np.ndarray:
    """Return the clear regions (K,) bool and the regions that weak pairs (P, 2) link to them."""
    reached = clear.copy()
    while True:
        halfway = weak[reached[weak].sum(axis=1) == 1]
        if not len(halfway):
            return reached
        reached[halfway.ravel()] = True
