# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Removal of curved regions in measured depth.

Within the tolerance of any method a curtain or a cushion is a row of narrow planes. At low noise
the cells of a single region show the curvature: a quadric fits them far better than a plane
(F-test), and the normal turns from one end to the other. Noise hides that, and a column becomes
three or four planes. A quadric has as many parameters as the two planes of a pair: it fits a bend
better than the two planes do, and a fold between planes worse. Hysteresis (Canny 1986): a strong
bend starts a curved region, weaker bends linked to it join.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.labels import remove_regions
from plane_detector.segmentation.cells.model import ROUNDING, PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import DepthKind
from plane_detector.segmentation.cells.plane_fit import solve_least_squares
from plane_detector.segmentation.regions.region_graph import (
    MAX_DEVIATIONS,
    MIN_BORDER_PAIRS,
    PLANE_TERMS,
    RegionGraph,
    fold,
)
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE

# derived: coefficients of a quadric over the image.
QUADRIC_TERMS = 6
# Threshold of the F-statistic: improvement of the fit by the quadric over the noise.
# tuned: evaluation.benchmark curved; flat from 5 to 15.
MIN_F = 8.0
# tuned: evaluation.benchmark curved, rooms; flat from 1 to 4.
MIN_TURN_DEG = 2.0
# Planes that meet at less than the first angle are one plane with a dent; at more than the second
# they are two planes with an edge.
# tuned: evaluation.benchmark curved, rooms; flat from 6 to 12, from 60 to 80.
MIN_FOLD_DEG, MAX_FOLD_DEG = 10.0, 70.0
# One plane fits worse than the quadric by more than the noise: a strong bend; by more than this
# share of it: a weak one.
# tuned: evaluation.benchmark curved; flat from 0.7 to 1.5.
LOW_THRESHOLD = 0.5
# Largest ratio of the quadric's error to the plane's error in one of the regions.
# tuned: evaluation.benchmark curved; flat from 1.5 to 3.
MAX_RATIO = 2.0
# derived: small regions fit their noise: lower bounds of a plane's error as shares of the noise.
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
    products, disparity = quadric_products(cells, regions.labels, len(regions.coefficients))
    curved = np.flatnonzero(_are_curved(products, disparity, noise_density))
    if not len(curved):
        return regions
    return PlaneRegions(*remove_regions(regions.labels, regions.coefficients, curved))


def quadric_products(cells: WeightedCells, labels: np.ndarray,
                     count: int) -> tuple[np.ndarray, float]:
    """
    Sum up the planar cells of ``count`` regions for surface fits.

    Returns
    -------
    products : (K, 7, 7) float64
        Sums of the products of two of 1, x, y, xx, xy, yy and d, less their means over all cells.
    disparity : float
        The mean of d.

    """
    return _products(np.ascontiguousarray(labels).reshape(-1), cells.table, cells.is_planar, count)


@kernel('Tuple((float64[:, :, ::1], float64))(int32[::1], float64[:, ::1], boolean[::1], int64)')
def _products(labels, table, is_planar, count):
    products, terms, mean, number = np.zeros((count, 7, 7)), np.ones(7), np.zeros(3), 0
    for i in range(len(labels)):
        if labels[i] >= 0 and is_planar[i]:
            number += 1
            for k in range(3):
                mean[k] += table[i, k]
    mean /= max(number, 1)
    for i in range(len(labels)):
        k = labels[i]
        if k < 0 or not is_planar[i]:
            continue
        x, y = table[i, 0] - mean[0], table[i, 1] - mean[1]
        terms[1], terms[2], terms[3], terms[4], terms[5] = x, y, x * x, x * y, y * y
        terms[6] = table[i, 2] - mean[2]
        for row in range(7):
            for column in range(7):
                products[k, row, column] += terms[row] * terms[column]
    return products, mean[2]


@kernel('boolean[::1](float64[:, :, ::1], float64, float64)')
def _are_curved(products, disparity, noise_density):
    """Return whether each region is curved; its disparity counts from ``disparity``."""
    curved, quadric = np.zeros(len(products), np.bool_), np.zeros(7)
    for k in range(len(products)):
        sums, count = products[k], products[k, 0, 0]
        if count < QUADRIC_TERMS + PLANE_TERMS:
            continue
        mean = disparity + sums[0, 6] / count
        of_plane = solve_least_squares(sums, PLANE_TERMS, quadric)
        of_quadric = solve_least_squares(sums, QUADRIC_TERMS, quadric)
        variance = max(of_quadric / (count - QUADRIC_TERMS), noise_density, (ROUNDING * mean) ** 2)
        # The bend over the width of the region along each direction, whose variance is a twelfth
        # of the width squared: its squares have this trace.
        xx, xy, yy = 2 * quadric[3], quadric[4], 2 * quadric[5]
        change = ((xx * xx + xy * xy) * (sums[1, 1] - sums[0, 1] ** 2 / count)
                  + (xy * xy + yy * yy) * (sums[2, 2] - sums[0, 2] ** 2 / count)
                  + 2 * xy * (xx + yy) * (sums[1, 2] - sums[0, 1] * sums[0, 2] / count))
        slope = np.sqrt(max(12 * change / count, 0.0)) * TYPICAL_FOCAL_SHARE
        curved[k] = (of_plane - of_quadric > MIN_F * 3 * variance
                     and np.degrees(np.arctan2(slope, mean)) > MIN_TURN_DEG)
    return curved


@kernel('UniTuple(float64, 4)(float64[:, ::1], float64[:, ::1])')
def fit_pair(first, second):
    """
    Fit one plane and one quadric to a pair of regions, by products (7, 7) about a common centre.

    Return the squared error of the plane, of the quadric, and of the quadric over each region.
    """
    joint, quadric = first + second, np.zeros(7)
    of_plane = solve_least_squares(joint, PLANE_TERMS, quadric)
    of_quadric = solve_least_squares(joint, QUADRIC_TERMS, quadric)
    quadric[6], of_first, of_second = -1.0, 0.0, 0.0
    for row in range(7):
        for column in range(7):
            of_first += quadric[row] * first[row, column] * quadric[column]
            of_second += quadric[row] * second[row, column] * quadric[column]
    return of_plane, of_quadric, of_first, of_second


@kernel('float64(float64[:, ::1])')
def plane_error(products):
    """Return the squared error of the plane of products (7, 7)."""
    return solve_least_squares(products, PLANE_TERMS, np.empty(7))


def find_curved(cells: WeightedCells, graph: RegionGraph, kind: DepthKind) -> np.ndarray:
    """Return the indices (n,) of regions that a quadric explains as well as their planes do."""
    bends = _bends(graph.planes, graph.sums, graph.borders,
                   quadric_products(cells, graph.labels, len(graph.planes))[0],
                   MIN_TURN_DEG if kind is DepthKind.EXACT else MIN_FOLD_DEG)
    curved, reached = np.zeros(len(bends), bool), (bends > 1).any(axis=0)
    while (curved != reached).any():
        curved, reached = reached, reached | (bends[reached] > 0).any(axis=0)
    return np.flatnonzero(curved)


@kernel('int8[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[:, :, ::1], '
        'float64)')
def _bends(planes, sums, borders, products, min_fold_deg):
    """Return 2 for pairs of regions that are clearly bent, 1 for weak bends, 0 for others."""
    count = len(planes)
    bends = np.zeros((count, count), np.int8)
    for i in range(count):
        for j in range(i + 1, count):
            if (borders[i, j, 0] < MIN_BORDER_PAIRS
                    or min(sums[i, 0], sums[j, 0]) <= PLANE_TERMS):
                continue
            fold_deg, gap = fold(planes, sums, borders, i, j)
            if gap < MAX_DEVIATIONS and min_fold_deg < fold_deg < MAX_FOLD_DEG:
                bends[i, j] = bends[j, i] = _bend(products[i], products[j], sums[i, 10],
                                                  sums[j, 10])
    return bends


@kernel('int8(float64[:, ::1], float64[:, ::1], float64, float64)')
def _bend(first, second, noise_first, noise_second):
    """Return the strength of the bend of a pair, by its products and the errors of its noise."""
    of_plane, of_quadric, of_first, of_second = fit_pair(first, second)
    own_first, own_second = plane_error(first), plane_error(second)
    gain = (of_plane - of_quadric) / (noise_first + noise_second)
    if (gain > LOW_THRESHOLD
            and of_first < MAX_RATIO * max(own_first, MIN_WEAK_NOISE_SHARE * noise_first)
            and of_second < MAX_RATIO * max(own_second, MIN_WEAK_NOISE_SHARE * noise_second)):
        own_first = max(own_first, MIN_NOISE_SHARE * noise_first)
        own_second = max(own_second, MIN_NOISE_SHARE * noise_second)
        return np.int8(1 + (gain > 1 and of_quadric < own_first + own_second
                            and of_first < MAX_RATIO * own_first
                            and of_second < MAX_RATIO * own_second))
    return np.int8(0)
