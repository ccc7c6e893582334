# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Merging of slightly bent surfaces: walls bent by a network, and floors within a set flatness.

Networks bend walls: adjacent regions separated by a slight bend are one plane. In depth without
noise, a concrete floor that dips by a degree or two is several planes: two adjacent planes are
merged if there is no step between them, the surface deviates from a plane by at most a tolerance
in metres, and the angle between them is within a tolerance in degrees.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import SegmentationConfig
from plane_detector.segmentation.cells.plane_fit import fit_plane, squared_error
from plane_detector.segmentation.regions.curved import fit_quadric
from plane_detector.segmentation.regions.merging import (
    MAX_BULGE_STEP_DEVIATIONS,
    normals_differ,
)
from plane_detector.segmentation.regions.region_graph import (
    MIN_BORDER_PAIRS,
    RegionGraph,
    fold,
    merge_pairs,
)
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE

# If the shift of the disparity is unknown, the angle is approximate.
# tuned: benchmark segmentation --only real; the range was not swept.
MAX_BOW_DEG, MAX_BOW_GAP_DEVIATIONS = 35.0, 4.0
# Largest ratio of the quadric's error to the plane's error in a region, and the lower bound of the
# plane's error as a share of the noise.
# tuned: benchmark segmentation --only real; the range was not swept.
MAX_BOW_RATIO, MIN_NOISE_SHARE = 3.0, 0.1


def merge_bowed_walls(graph: RegionGraph) -> RegionGraph:
    """Merge adjacent regions that one slightly bent quadric fits as well as their planes do."""
    merged = merge_pairs(graph, lambda graph: _bow_misfit(graph.planes, graph.sums, graph.borders),
                         lambda graph, i, j: False)
    return merged.without_merged()


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1])')
def _bow_misfit(planes, sums, borders):
    count = len(planes)
    misfit = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i + 1, count):
            if borders[i, j, 0] < MIN_BORDER_PAIRS or normals_differ(sums[i], sums[j]):
                continue
            fold_deg, gap = fold(planes, sums, borders, i, j)
            if fold_deg < MAX_BOW_DEG and gap < MAX_BOW_GAP_DEVIATIONS:
                misfit[i, j] = fit_quadric(sums[i], sums[j], MIN_NOISE_SHARE)[2] / MAX_BOW_RATIO
    return misfit


def join_nearly_flat(graph: RegionGraph, removed: np.ndarray,
                     config: SegmentationConfig) -> tuple[np.ndarray, np.ndarray]:
    """
    Merge adjacent regions that are flat within the settings, flattest pair first.

    Parameters
    ----------
    graph : RegionGraph
        Of 1/z in 1/metres.
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
    if config.flatness_distance > 0:
        is_kept = np.ones(len(graph.planes), bool)
        is_kept[removed] = False
        graph = merge_pairs(graph, lambda graph: _flat_misfit(
            graph.planes, graph.sums, graph.borders, is_kept,
            (config.flatness_distance, max(config.flatness_angle, 1e-9))),
            lambda graph, i, j: False)
    return graph.owner, graph.planes


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1], boolean[::1], '
        'UniTuple(float64, 2))')
def _flat_misfit(planes, sums, borders, is_kept, limits):
    """Return the larger of distance and angle over their tolerances; infinite at a step."""
    count, joint = len(planes), np.empty(10)
    misfit = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i + 1, count):
            if borders[i, j, 0] < MIN_BORDER_PAIRS or not (is_kept[i] and is_kept[j]):
                continue
            fold_deg, gap = fold(planes, sums, borders, i, j)
            if gap >= MAX_BULGE_STEP_DEVIATIONS or fold_deg > limits[1]:
                continue
            for k in range(10):
                joint[k] = sums[i, k] + sums[j, k]
            a, b, c = fit_plane(joint)
            offset_m = 1 / np.sqrt(TYPICAL_FOCAL_SHARE**2 * (a * a + b * b) + c * c)
            worst = fold_deg / limits[1]
            for side in (sums[i], sums[j]):
                # A point at 1/z is off the plane by offset_m times its relative residual.
                square = max(squared_error(a, b, c, side), 0.0) * side[0]
                worst = max(worst, offset_m * np.sqrt(square) / side[6] / limits[0])
            misfit[i, j] = worst
    return misfit
