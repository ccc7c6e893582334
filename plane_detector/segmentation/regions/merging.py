# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Merge adjacent regions that cannot be told apart at the noise level.

Two regions are merged if a joint plane fits both within the noise, or if the smaller one is a
bulge of the larger: near its plane and without a step along the border. A step keeps parallel
planes apart, since smooth noise does not jump from cell to cell.
"""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import squared_errors
from plane_detector.segmentation.regions.adjacency import (
    RegionAdjacency,
    best_pairs,
    find_adjacency,
    joint_misfit,
    merge,
    sum_up_regions,
)
from plane_detector.segmentation.regions.model_selection import prefer_two_planes
from plane_detector.segmentation.regions.normal_agreement import normals_differ

# Largest distance of the cells of a bulge from the plane, in deviations; a step is smaller.
# tuned: benchmark sensitivity; flat to 1.4 times; at 0.7 times precision -0.123.
MAX_BULGE_DEVIATIONS = 3.5
# tuned: benchmark sensitivity; flat to 1.4 times; at 0.7 times precision -0.018.
MAX_BULGE_STEP_DEVIATIONS = 2.0
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MAX_BULGE_SHARE = 0.35


def merge_adjacent(cells: WeightedCells, regions: PlaneRegions,
                   correlation: Correlation | None) -> PlaneRegions:
    """
    Merge pairs of regions, best fit first, until no pair fits.

    Parameters
    ----------
    cells : WeightedCells
    regions : PlaneRegions
    correlation : Correlation or None
        Of the noise, for model selection; if None, all pairs that fit are merged.

    Returns
    -------
    PlaneRegions
        Planes refitted to all their cells.

    """
    while len(regions.coefficients) > 1:
        adjacency = find_adjacency(cells, regions.labels)
        joint, _ = joint_misfit(cells, regions, adjacency.first, adjacency.second)
        misfit = np.fmin(joint, _bulge_misfit(cells, regions, adjacency))
        misfit[normals_differ(cells, regions, adjacency.first, adjacency.second)] = np.inf
        chosen = _chosen(cells, regions, adjacency, misfit, correlation)
        if not len(chosen):
            break
        regions = merge(cells, regions, adjacency.first[chosen], adjacency.second[chosen])
    return regions


def _chosen(cells: WeightedCells, regions: PlaneRegions, adjacency: RegionAdjacency,
            misfit: np.ndarray, correlation: Correlation | None) -> np.ndarray:
    """Return the best pairs not separated by a step or crease."""
    tested = np.zeros(len(misfit), bool)
    while True:
        chosen = best_pairs(adjacency, misfit)
        new = chosen[~tested[chosen]]
        apart = new[[prefer_two_planes(cells, regions.labels, correlation, adjacency.first[k],
                                       adjacency.second[k]) for k in new]] if len(new) else new
        if not len(apart):
            return chosen
        tested[new], misfit[apart] = True, np.inf


def _bulge_misfit(cells: WeightedCells, regions: PlaneRegions,
                  adjacency: RegionAdjacency) -> np.ndarray:
    """Return the misfit (P,) of the smaller region as a bulge of the larger, up to 1 for a fit."""
    sums = sum_up_regions(cells, regions)
    first_larger = sums.count[adjacency.first] >= sums.count[adjacency.second]
    large = np.where(first_larger, adjacency.first, adjacency.second)
    small = np.where(first_larger, adjacency.second, adjacency.first)
    planes = regions.coefficients[large]
    square = np.maximum(squared_errors(planes, sums.moments[small]), 0) / sums.count[small]
    deviation = np.sqrt(square / sums.variance[small])
    step = adjacency.step(planes) / np.sqrt(sums.variance[large])
    misfit = np.maximum(deviation / MAX_BULGE_DEVIATIONS, step / MAX_BULGE_STEP_DEVIATIONS) ** 2
    return np.where(sums.count[small] <= MAX_BULGE_SHARE * sums.count[large], misfit, np.inf)
