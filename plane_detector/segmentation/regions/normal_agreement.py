# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Regions whose normals differ are not one plane, however well one plane fits their depth.

The two slopes of the disparity are constant on a plane, so that the normals of a network give
every cell of a region the same slopes up to their noise. That noise is how far they stray within
the region.
"""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.normal_slopes import MIN_ANGLE_RAD
from plane_detector.segmentation.regions.adjacency import MAX_DEVIATIONS, MIN_PLANE_CELLS
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE


def normals_differ(cells: WeightedCells, regions: PlaneRegions, first: np.ndarray,
                   second: np.ndarray) -> np.ndarray:
    """
    Say which pairs of regions lie on two planes by their normals.

    Parameters
    ----------
    cells : WeightedCells
        Without ``normal_slope`` no pair differs.
    regions : PlaneRegions
    first, second : (P,) int
        The pairs.

    Returns
    -------
    (P,) bool

    """
    slope, label = cells.grid.normal_slope, regions.labels.ravel()
    used = np.flatnonzero(np.isfinite(slope[:, 0]) & (label >= 0) & cells.is_planar)
    if not len(used):
        return np.zeros(len(first), bool)
    label, slope, count = label[used], slope[used], len(regions.coefficients)
    number = np.bincount(label, minlength=count)
    mean, square, disparity = (
        np.stack([np.bincount(label, column, count) for column in columns.T], axis=1)
        / np.maximum(number, 1)[:, None]
        for columns in (slope, slope**2, cells.grid.mean[used, 2:]))
    least = MIN_ANGLE_RAD * disparity[:, 0] / TYPICAL_FOCAL_SHARE
    variance = (square - mean**2).clip(0).mean(axis=1) + least**2
    apart = ((mean[first] - mean[second]) ** 2).sum(axis=1)
    is_known = np.minimum(number[first], number[second]) >= MIN_PLANE_CELLS
    return is_known & (apart > MAX_DEVIATIONS**2 * (variance[first] + variance[second]))
