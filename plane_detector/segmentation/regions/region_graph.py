# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The region adjacency graph, and merging of its nodes, best pair first.

All tests of regions and of pairs of regions work on sums over cells. Sums add up when regions are
merged, so that the cells are read once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import N, add_moments, fit_plane, normal_of
from plane_detector.segmentation.cells.model import (
    MEAN_D,
    MEAN_WEIGHT,
    MEAN_X,
    MEAN_Y,
    MIN_VARIANCE,
    PlaneRegions,
    WeightedCells,
    relabel_sequential,
)

# derived: cells at this distance touch, because a cell that straddles the border may lie between
# them.
BORDER_REACH_CELLS = 2
# derived: no sign.
APART = 2
# derived: the number of coefficients of a plane; a fit needs more cells than this.
PLANE_TERMS = 3
# derived: the columns of RegionGraph.sums behind those of PRODUCTS.
VARIANCE, NORMALS, NORMAL_X, NORMAL_Y, NORMAL_SQUARES, NORMALS_D = range(22, 28)
# derived: the columns of RegionGraph.borders.
PAIRS, PAIRS_X, PAIRS_Y, PAIRS_D, MIDDLES_XX, MIDDLES_XY, MIDDLES_YY = range(7)
# derived: the column of the product of each two of 1, x, y, xx, xy, yy and d. Of the 22 products
# the first ten are the moments, the others what a quadric needs in addition.
PRODUCTS = np.array([[0, 1, 2, 3, 4, 5, 6], [1, 3, 4, 10, 11, 12, 7], [2, 4, 5, 11, 12, 13, 8],
                     [3, 10, 11, 14, 15, 16, 19], [4, 11, 12, 15, 16, 17, 20],
                     [5, 12, 13, 16, 17, 18, 21], [6, 7, 8, 19, 20, 21, 9]])
# derived: the two factors of each product.
FACTORS = np.array([np.argwhere(column == PRODUCTS)[0] for column in range(PRODUCTS.max() + 1)])


@dataclass(frozen=True)
class RegionGraph:
    """Regions, sums over their planar cells and over the pairs of cells along their borders."""

    labels: np.ndarray  # (R, C) int32: region of each cell, -1 none
    # (K,) int64: the region that each was merged into, itself if it was not. Only these have cells
    owner: np.ndarray
    planes: np.ndarray  # (K, 3) float64: fitted to all pixels of the cells
    pixels: np.ndarray  # (K, 10) float64: moments of these pixels
    # (K, 28) float64: of the means of the cells: 22 products, and the variances; of the cells with
    # normals: their number, two slopes, the squares of these, and disparity
    sums: np.ndarray
    # (K, K, 7) float64: entry i, j: pairs of cells along the border of i and j, sums of x, y, d of
    # those in i, and of xx, xy, yy of the middles of the pairs
    borders: np.ndarray
    lens: np.ndarray  # (4,) float64: as in the grid of the cells

    @classmethod
    def of(cls, cells: WeightedCells, regions: PlaneRegions) -> RegionGraph:
        """Sum up the cells of regions."""
        labels, count = np.ascontiguousarray(regions.labels), len(regions.coefficients)
        sums = _sum_up(labels, cells.table, cells.grid.moments, cells.grid.normal_slope,
                       cells.is_planar, count)
        return cls(labels, np.arange(count), regions.coefficients, *sums, cells.grid.lens)

    def without_merged(self) -> RegionGraph:
        """Return the graph of the regions that were not merged into others."""
        return self.only(self.owner == np.arange(len(self.owner)))

    def only(self, is_kept: np.ndarray) -> RegionGraph:
        """Return the graph of some regions, ``is_kept`` (K,) bool, with consecutive labels."""
        if is_kept.all():
            return self
        kept = np.flatnonzero(is_kept)
        return RegionGraph(relabel_sequential(self.labels, kept, len(self.planes)),
                           np.arange(len(kept)), self.planes[kept], self.pixels[kept],
                           self.sums[kept], self.borders.take(kept, 0).take(kept, 1), self.lens)


def merge_pairs(graph: RegionGraph, misfit: Callable[[RegionGraph], np.ndarray],
                is_apart: Callable[[RegionGraph, int, int, float], bool],
                most: float = 1.0) -> RegionGraph:
    """
    Merge the pair of regions that fits best, until none fits.

    Parameters
    ----------
    graph : RegionGraph
    misfit : callable
        Returns (K, K) float64; entries i < j are at most 1 for a fit, all others infinite. NaN
        ends the merging.
    is_apart : callable
        Returns whether two regions with a misfit stay separate; called once per pair.
    most : float
        Largest misfit of pairs that may be merged.

    """
    refused: set[tuple[int, int]] = set()
    is_own = False
    while True:
        cost = misfit(graph)
        for pair in _fitting(cost, most):
            if pair in refused:
                continue
            if not is_apart(graph, *pair, float(cost[pair])):
                break
            refused.add(pair)
        else:
            return graph
        if not is_own:
            graph = RegionGraph(*(part.copy() for part in vars(graph).values()))
            is_own = True
        graph = _merged(graph, *pair)
        refused = {other for other in refused if not set(pair) & set(other)}


def _fitting(cost: np.ndarray, most: float) -> list[tuple[int, int]]:
    """Return the pairs that fit, the best first."""
    if np.isnan(cost.min(initial=np.inf)):
        return []
    rows, columns = (cost <= most).nonzero()
    order = cost[rows, columns].argsort(kind='stable')
    return list(zip(rows[order].tolist(), columns[order].tolist(), strict=True))


@kernel('Tuple((float64[:, ::1], float64[:, ::1], float64[:, :, ::1]))'
        '(int32[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], boolean[::1], int64)',
        is_short=True)
def _sum_up(labels, table, moments, slope, is_planar, count):
    (rows, columns), borders = labels.shape, np.zeros((count, count, 7))
    pixels, sums = np.zeros((count, 10)), np.zeros((count, 28))
    for row in range(rows):
        for column in range(columns):
            i, one = row * columns + column, labels[row, column]
            if one < 0 or not is_planar[i]:
                continue
            add_moments(pixels[one], moments[i])
            add_cell(table, slope, sums, i, one)
            for step in range(1, BORDER_REACH_CELLS + 1):
                for r, c in ((row + step, column), (row, column + step)):
                    if r >= rows or c >= columns or labels[r, c] < 0 or labels[r, c] == one:
                        continue
                    j, other = r * columns + c, labels[r, c]
                    if is_planar[j]:
                        borders[one, other, PAIRS] += 1
                        borders[other, one, PAIRS] += 1
                        for k in range(3):
                            borders[one, other, PAIRS_X + k] += table[i, k]
                            borders[other, one, PAIRS_X + k] += table[j, k]
                        x = (table[i, MEAN_X] + table[j, MEAN_X]) / 2
                        y = (table[i, MEAN_Y] + table[j, MEAN_Y]) / 2
                        for side in ((one, other), (other, one)):
                            borders[side[0], side[1], MIDDLES_XX] += x * x
                            borders[side[0], side[1], MIDDLES_XY] += x * y
                            borders[side[0], side[1], MIDDLES_YY] += y * y
    return pixels, sums, borders


# Not private, and so compiled separately: as part of its caller the loop over FACTORS is not
# unrolled, which takes .08 ms more.
@kernel('void(float64[:, ::1], float64[:, ::1], float64[:, ::1], int64, int64)')
def add_cell(table, slope, sums, i, k):
    """Add cell i to the sums of region k: numba takes longer to pass rows than to add them up."""
    x, y, d = table[i, MEAN_X], table[i, MEAN_Y], table[i, MEAN_D]
    terms = 1.0, x, y, x * x, x * y, y * y, d
    for column in range(len(FACTORS)):
        sums[k, column] += terms[FACTORS[column, 0]] * terms[FACTORS[column, 1]]
    sums[k, VARIANCE] += 1 / table[i, MEAN_WEIGHT]
    if len(slope) and np.isfinite(slope[i, 0]):
        sums[k, NORMALS] += 1
        sums[k, NORMAL_X] += slope[i, 0]
        sums[k, NORMAL_Y] += slope[i, 1]
        sums[k, NORMAL_SQUARES] += slope[i, 0] ** 2 + slope[i, 1] ** 2
        sums[k, NORMALS_D] += d


def _merged(graph: RegionGraph, target: int, source: int) -> RegionGraph:
    """Merge region ``source`` into ``target``: all but the labels in place."""
    labels = np.where(graph.labels == source, np.int32(target), graph.labels)
    _merge(graph.owner, graph.planes, graph.pixels, graph.sums, graph.borders, (target, source))
    return replace(graph, labels=labels)


@kernel('void(int64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], '
        'float64[:, :, ::1], UniTuple(int64, 2))', is_short=True)
def _merge(owner, planes, pixels, sums, borders, pair):
    (target, source), count = pair, len(owner)
    for k in range(count):
        owner[k] = target if owner[k] == source else owner[k]
    add_moments(pixels[target], pixels[source])
    planes[target, 0], planes[target, 1], planes[target, 2] = fit_plane(pixels[target])
    for column in range(sums.shape[1]):
        sums[target, column] += sums[source, column]
        sums[source, column] = 0.0
    for k in range(count):
        for column in range(borders.shape[2]):
            borders[target, k, column] += borders[source, k, column]
    for k in range(count):
        for column in range(borders.shape[2]):
            borders[k, target, column] += borders[k, source, column]
            borders[source, k, column] = borders[k, source, column] = 0.0
    for column in range(borders.shape[2]):
        borders[target, target, column] = 0.0


@kernel('UniTuple(float64, 2)(float64[:, ::1], float64[:, :, ::1], int64, int64)')
def _gaps(planes, borders, i, j):
    """Return plane i minus plane j, summed over the pairs along their border, in i and in j."""
    a, b, c = planes[i, 0] - planes[j, 0], planes[i, 1] - planes[j, 1], planes[i, 2] - planes[j, 2]
    return (a * borders[i, j, PAIRS_X] + b * borders[i, j, PAIRS_Y] + c * borders[i, j, PAIRS],
            a * borders[j, i, PAIRS_X] + b * borders[j, i, PAIRS_Y] + c * borders[j, i, PAIRS])


@kernel('int8[:, ::1](float64[:, ::1], float64[:, :, ::1])', is_short=True)
def intersections(planes, borders):
    """
    Find the pairs of regions whose planes intersect along their border, or do not touch.

    Returns
    -------
    (K, K) int8
        Entry i, j is the sign of 1/z of plane min(i, j) minus the other plane, on the side of
        min(i, j); 0 if one is in front of the other, APART if they do not touch.

    """
    signs = np.zeros((len(planes), len(planes)), np.int8)
    for i in range(len(planes)):
        for j in range(i + 1, len(planes)):
            if borders[i, j, PAIRS] == 0:
                signs[i, j] = signs[j, i] = APART
                continue
            here, there = _gaps(planes, borders, i, j)
            if here * there < 0:
                signs[i, j] = signs[j, i] = 1 if here > 0 else -1
    return signs


@kernel('UniTuple(float64, 3)(float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[::1], '
        'int64, int64)')
def fold(planes, sums, borders, lens, i, j):
    """
    Return the angle between two planes, degrees, and the gap at their border, in sigma.

    The gap is that of the middle of the border, where pieces of one bow meet, and its rms along
    the border, where a plane that is tilted along it does not.
    """
    here, there = _gaps(planes, borders, i, j)
    gap = abs(here + there) / (2 * borders[i, j, PAIRS])
    a, b, c = planes[i, 0] - planes[j, 0], planes[i, 1] - planes[j, 1], planes[i, 2] - planes[j, 2]
    x = borders[i, j, PAIRS_X] + borders[j, i, PAIRS_X]
    y = borders[i, j, PAIRS_Y] + borders[j, i, PAIRS_Y]
    square_gap = (a * a * borders[i, j, MIDDLES_XX] + 2 * a * b * borders[i, j, MIDDLES_XY]
                  + b * b * borders[i, j, MIDDLES_YY] + c * (a * x + b * y)) / (
                      borders[i, j, PAIRS]) + c * c
    variance = max(sums[i, VARIANCE] / max(sums[i, N], 1.0),
                   sums[j, VARIANCE] / max(sums[j, N], 1.0), MIN_VARIANCE)
    one = normal_of(planes[i, 0], planes[i, 1], planes[i, 2], lens)
    other = normal_of(planes[j, 0], planes[j, 1], planes[j, 2], lens)
    dot, square, of_other = 0.0, 0.0, 0.0
    for k in range(3):
        dot += one[k] * other[k]
        square += one[k] * one[k]
        of_other += other[k] * other[k]
    cosine = dot / np.sqrt(square * of_other)
    return (np.degrees(np.arccos(min(max(cosine, -1.0), 1.0))), gap / np.sqrt(variance),
            np.sqrt(max(square_gap, 0.0) / variance))
