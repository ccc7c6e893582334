# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Merging of regions that are coplanar within the noise.

Two regions are merged if a joint plane fits both within the noise, or if the smaller one is a
bulge of the larger: near its plane and without a step along the border. A step keeps parallel
planes apart, since smooth noise does not jump from cell to cell. Regions whose normals differ are
two planes, however well one plane fits their depth.

Pieces that do not touch are one plane if a nearer object separates them: a floor continues behind
a box, two tables of one height do not continue over the floor between them. The depth between them
decides: something nearer than their plane hides its continuation, something farther shows that it
ends.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import WeightedCells, has_no_depth
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.normal_slopes import MIN_ANGLE_RAD
from plane_detector.segmentation.cells.plane_fit import fit_plane, squared_error
from plane_detector.segmentation.regions.model_selection import prefer_two_planes
from plane_detector.segmentation.regions.region_graph import (
    MAX_DEVIATIONS,
    MIN_BORDER_PAIRS,
    PLANE_TERMS,
    RegionGraph,
    merge_pairs,
)
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE

# The mean of chi-squared of either piece about a joint plane is 1 if they are coplanar.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MAX_JOINT_VARIANCES = 2.0
# Largest distance of the cells of a bulge from the plane, in deviations; a step is smaller.
# tuned: benchmark sensitivity; flat to 1.4 times; at 0.7 times precision -0.123.
MAX_BULGE_DEVIATIONS = 3.5
# tuned: benchmark sensitivity; flat to 1.4 times; at 0.7 times precision -0.018.
MAX_BULGE_STEP_DEVIATIONS = 2.0
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MAX_BULGE_SHARE = 0.35
# derived: about as many lines, and samples per line, as cells along the longer side of a piece.
SIGHT_LINES = 24
# Of the cells between two pieces no more than this share may be farther than their plane.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
MAX_SEEN_THROUGH = 0.2


def merge_coplanar(cells: WeightedCells, graph: RegionGraph,
                   correlation: Correlation | None) -> RegionGraph:
    """
    Merge pairs of regions, best fit first, until no pair fits.

    Parameters
    ----------
    cells : WeightedCells
    graph : RegionGraph
    correlation : Correlation or None
        Of the noise, for model selection; if None, all pairs that fit are merged.

    Returns
    -------
    RegionGraph
        Planes refitted to all their cells.

    """
    def is_apart(graph: RegionGraph, i: int, j: int) -> bool:
        if graph.borders[i, j, 0] < MIN_BORDER_PAIRS and not _is_hidden_between(
                graph.labels, cells.table, cells.is_planar, graph.sums, (i, j)):
            return True
        return prefer_two_planes(cells, graph.labels, correlation, i, j)

    for least_pairs in (MIN_BORDER_PAIRS, 0):  # neighbours first
        graph = merge_pairs(graph, partial(coplanar_misfit, least_pairs=least_pairs), is_apart)
    return graph.without_merged()


def coplanar_misfit(graph: RegionGraph, least_pairs: int = 0) -> np.ndarray:
    """
    Return the misfit of one plane to each pair of regions.

    Parameters
    ----------
    graph : RegionGraph
    least_pairs : int
        Pairs of cells along their border, at least.

    Returns
    -------
    (K, K) float64
        For pairs i < j, up to 1 for a fit; infinity elsewhere.

    """
    return _misfits(graph.planes, graph.sums, graph.borders, least_pairs)


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1], int64)')
def _misfits(planes, sums, borders, least_pairs):
    count, joint = len(planes), np.empty(10)
    misfit = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i + 1, count):
            if (sums[i, 0] == 0 or sums[j, 0] == 0 or borders[i, j, 0] < least_pairs
                    or normals_differ(sums[i], sums[j])):
                continue
            for k in range(10):
                joint[k] = sums[i, k] + sums[j, k]
            a, b, c = fit_plane(joint)
            worst = max(squared_error(a, b, c, sums[i]) / sums[i, 10],
                        squared_error(a, b, c, sums[j]) / sums[j, 10])
            if not np.isnan(worst):
                misfit[i, j] = worst / MAX_JOINT_VARIANCES
            if borders[i, j, 0] >= MIN_BORDER_PAIRS:
                large, small = (i, j) if sums[i, 0] >= sums[j, 0] else (j, i)
                misfit[i, j] = min(misfit[i, j], _bulge_misfit(planes[large], sums, borders,
                                                               large, small))
    return misfit


@kernel('boolean(float64[::1], float64[::1])')
def normals_differ(first, second):
    """
    Return whether normals show that two regions, by their sums, lie on two planes.

    The slopes of the disparity are constant on a plane. The scatter of the normals' slopes within
    a region is their noise.
    """
    if min(first[11], second[11]) <= PLANE_TERMS:
        return False
    apart, variance = 0.0, 0.0
    for k in range(2):
        apart += (first[12 + k] / first[11] - second[12 + k] / second[11]) ** 2
    for sums in (first, second):
        n, least = sums[11], MIN_ANGLE_RAD * sums[15] / sums[11] / TYPICAL_FOCAL_SHARE
        spread = sums[14] / n - (sums[12] / n) ** 2 - (sums[13] / n) ** 2
        variance += max(spread, 0.0) / 2 + least**2
    return apart > MAX_DEVIATIONS**2 * variance


@kernel('float64(float64[::1], float64[:, ::1], float64[:, :, ::1], int64, int64)')
def _bulge_misfit(plane, sums, borders, large, small):
    """Return the misfit of the smaller region as a bulge of the larger, up to 1 for a fit."""
    if sums[small, 0] > MAX_BULGE_SHARE * sums[large, 0]:
        return np.inf
    here, there, number = borders[large, small], borders[small, large], borders[large, small, 0]
    square = max(squared_error(plane[0], plane[1], plane[2], sums[small]), 0.0) / sums[small, 10]
    step = abs(here[3] - there[3] - plane[0] * (here[1] - there[1])
               - plane[1] * (here[2] - there[2])) / number
    steps = step**2 * sums[large, 0] / sums[large, 10]
    return max(square / MAX_BULGE_DEVIATIONS**2, steps / MAX_BULGE_STEP_DEVIATIONS**2)


@kernel('boolean(int32[:, ::1], float64[:, ::1], boolean[::1], float64[:, ::1], '
        'UniTuple(int64, 2))')
def _is_hidden_between(labels, table, is_planar, sums, pair):
    """Sample straight lines from cells of one region to the nearest cells of the other."""
    (rows, columns), first, second = labels.shape, pair[0], pair[1]
    at, count, joint = np.empty((2, labels.size, 2)), np.zeros(2, np.int64), np.empty(10)
    for k in range(10):
        joint[k] = sums[first, k] + sums[second, k]
    a, b, c = fit_plane(joint)
    for row in range(rows):
        for column in range(columns):
            if labels[row, column] == first or labels[row, column] == second:
                side = int(labels[row, column] == second)
                at[side, count[side], 0], at[side, count[side], 1] = row, column
                count[side] += 1
    between, tested, farther, last = 0, 0, 0, SIGHT_LINES - 1
    for line in range(SIGHT_LINES):
        start = at[0, (count[0] - 1) * line // last]
        end, nearest = start, np.inf
        for k in range(count[1]):
            square = (at[1, k, 0] - start[0]) ** 2 + (at[1, k, 1] - start[1]) ** 2
            if square < nearest:
                end, nearest = at[1, k], square
        for sample in range(SIGHT_LINES):
            row = int(np.rint(start[0] + sample / last * (end[0] - start[0])))
            column = int(np.rint(start[1] + sample / last * (end[1] - start[1])))
            i, label = row * columns + column, labels[row, column]
            if label in (first, second) or has_no_depth(table, i):
                continue
            between += 1
            if is_planar[i]:  # a cell that straddles an edge is neither nearer nor farther
                tested += 1
                expected = a * table[i, 0] + b * table[i, 1] + c
                farther += expected - table[i, 2] > MAX_DEVIATIONS / np.sqrt(table[i, 5])
    return between > 0 and farther <= MAX_SEEN_THROUGH * tested
