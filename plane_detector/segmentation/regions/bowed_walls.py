# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Networks bend walls: adjacent regions that a slight bend separates are one plane."""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.regions.adjacency import best_pairs, find_adjacency, merge
from plane_detector.segmentation.regions.normal_agreement import normals_differ
from plane_detector.segmentation.regions.quadrics import fit_pairs, folds, sum_up_quadrics

# If the shift of the disparity is unknown, the angle is approximate.
# tuned: benchmark segmentation --only real; the range was not swept.
MAX_BOW_DEG, MAX_BOW_GAP_DEVIATIONS = 35.0, 4.0
# How much worse than its plane the quadric may fit a region, and the lower bound of the plane's
# error as a share of the noise.
# tuned: benchmark segmentation --only real; the range was not swept.
MAX_BOW_RATIO, MIN_NOISE_SHARE = 3.0, 0.1


def merge_bowed_walls(cells: WeightedCells, regions: PlaneRegions) -> PlaneRegions:
    """Merge adjacent regions that one slightly bent quadric fits as well as their planes do."""
    while len(regions.coefficients) > 1:
        adjacency = find_adjacency(cells, regions.labels)
        fold_deg, gap = folds(cells, regions, adjacency)
        misfit = np.full(len(fold_deg), np.inf)
        apart = normals_differ(cells, regions, adjacency.first, adjacency.second)
        slight = np.flatnonzero((gap < MAX_BOW_GAP_DEVIATIONS) & (fold_deg < MAX_BOW_DEG) & ~apart)
        if len(slight):
            pairs = adjacency.first[slight], adjacency.second[slight]
            quadrics = sum_up_quadrics(cells, regions)
            own = np.maximum(quadrics.error, MIN_NOISE_SHARE * quadrics.noise)
            errors = fit_pairs(quadrics, *pairs)[2]
            misfit[slight] = (errors / own[np.stack(pairs, axis=1)]).max(axis=1) / MAX_BOW_RATIO
        chosen = best_pairs(adjacency, misfit)
        if not len(chosen):
            break
        regions = merge(cells, regions, adjacency.first[chosen], adjacency.second[chosen])
    return regions
