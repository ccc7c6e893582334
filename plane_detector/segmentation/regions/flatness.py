# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
How flat is flat: what noise tells apart may still be one plane to the user.

A concrete floor that dips by a degree or two is several planes to depth without noise. Two
touching planes are joined if they meet without a step, the surface departs from a plane by no more
than a tolerance, in metres, and they meet at no more than another, in degrees.
"""

from __future__ import annotations

import numpy as np

from plane_detector.config import SegmentationConfig
from plane_detector.segmentation.cells.grid import D
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, region_moments
from plane_detector.segmentation.cells.plane_fit import fit_planes, squared_errors
from plane_detector.segmentation.regions.adjacency import (
    RegionAdjacency,
    best_pairs,
    find_adjacency,
    sum_up_regions,
)
from plane_detector.segmentation.regions.merging import MAX_BULGE_STEP_DEVIATIONS
from plane_detector.segmentation.regions.quadrics import folds
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE


def join_nearly_flat(cells: WeightedCells, regions: PlaneRegions, removed: np.ndarray,
                     config: SegmentationConfig) -> tuple[np.ndarray, np.ndarray]:
    """
    Join touching regions that together are as flat as the user asks, flattest pair first.

    Parameters
    ----------
    cells : WeightedCells
        Of 1/z in 1/metres.
    regions : PlaneRegions
    removed : (n,) int
        Regions that are not joined to others.
    config : SegmentationConfig
        Its ``flatness_distance`` and ``flatness_angle`` are used.

    Returns
    -------
    owner : (K,) int
        The region that each is part of, itself if it is not joined.
    coefficients : (K, 3) float64
        Refitted for regions that others joined.

    """
    owner, planes = np.arange(len(regions.coefficients)), regions.coefficients.copy()
    labels = regions.labels.copy()
    labels[np.isin(labels, removed)] = -1
    while config.flatness_distance > 0:
        joined = PlaneRegions(labels, planes)
        adjacency = find_adjacency(cells, labels)
        chosen = best_pairs(adjacency, _misfit(cells, joined, adjacency, config))
        if not len(chosen):
            break
        for first, second in zip(adjacency.first[chosen], adjacency.second[chosen], strict=True):
            owner[owner == second] = first
        labels = np.where(labels >= 0, owner[labels], -1).astype(np.int32)
        changed = adjacency.first[chosen]
        planes[changed] = fit_planes(region_moments(cells, labels, len(planes)))[changed]
    return owner, planes


def _misfit(cells: WeightedCells, regions: PlaneRegions, adjacency: RegionAdjacency,
            config: SegmentationConfig) -> np.ndarray:
    """Return distance and angle (P,) over what is tolerated, the larger; infinite at a step."""
    pair, sums = np.stack([adjacency.first, adjacency.second]), sum_up_regions(cells, regions)
    joint = fit_planes(sums.moments[pair[0]] + sums.moments[pair[1]])
    offset_m = 1 / np.linalg.norm(joint * [TYPICAL_FOCAL_SHARE, TYPICAL_FOCAL_SHARE, 1], axis=1)
    # A point at 1/z is off the plane by offset_m times its relative residual.
    relative = [np.sqrt(np.maximum(squared_errors(joint, sums.moments[side]), 0)
                        * sums.count[side]) / sums.moments[side, D] for side in pair]
    fold_deg, gap = folds(cells, regions, adjacency)
    misfit = np.fmax(offset_m * np.max(relative, axis=0) / config.flatness_distance,
                     fold_deg / max(config.flatness_angle, 1e-9))
    return np.where(gap < MAX_BULGE_STEP_DEVIATIONS, misfit, np.inf)
