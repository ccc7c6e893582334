# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Adjacency of regions, sums over the cells along their borders, and merging of regions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, region_moments
from plane_detector.segmentation.cells.plane_fit import fit_planes, squared_errors

# derived: cells this far apart still touch, as between them may lie one that straddles the border.
BORDER_REACH_CELLS = 2
# derived: one normal deviate in 370 is larger.
MAX_DEVIATIONS = 3.0
# derived: four cells for the three terms of a plane.
MIN_PLANE_CELLS = 4
# derived: one pair of cells may touch by chance.
MIN_BORDER_PAIRS = 2
# The mean of chi-squared of either piece about a joint plane is 1 if they are coplanar.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MAX_JOINT_VARIANCES = 2.0


@dataclass(frozen=True)
class RegionAdjacency:
    """
    Pairs of regions that touch, i < j, with sums over the pairs of cells along their borders.

    Attributes
    ----------
    first, second : (P,) int
        The regions.
    count : (P,) float64
        Pairs of cells.
    mean_first, mean_second : (P, 3) float64
        Mean x, y, d of the cells on the side of ``first`` and of ``second``.

    """

    first: np.ndarray
    second: np.ndarray
    count: np.ndarray
    mean_first: np.ndarray
    mean_second: np.ndarray

    def step(self, planes: np.ndarray) -> np.ndarray:
        """Return the mean step (P,) across each border, measured against planes (P, 3)."""
        gap = self.mean_first - self.mean_second
        return np.abs(gap[:, 2] - (planes[:, :2] * gap[:, :2]).sum(axis=1))

    def gap(self, planes: np.ndarray) -> np.ndarray:
        """Return the mean gap (P,) at each border from the plane of ``first`` to ``second``'s."""
        return np.abs(_at(planes[self.first] - planes[self.second],
                          (self.mean_first + self.mean_second) / 2))

    def sides(self, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return plane ``first`` minus ``second`` on the side of each of them, (P,) both."""
        difference = planes[self.first] - planes[self.second]
        return _at(difference, self.mean_first), _at(difference, self.mean_second)


def _at(planes: np.ndarray, places: np.ndarray) -> np.ndarray:
    return planes[:, 2] + (planes[:, :2] * places[:, :2]).sum(axis=1)


def find_adjacency(cells: WeightedCells, labels: np.ndarray) -> RegionAdjacency:
    """Find which regions of labels (R, C) touch along rows or columns of planar cells."""
    count = int(labels.max(initial=-1)) + 1
    sums = _border_sums(np.ascontiguousarray(labels), cells.table, cells.is_planar, count)
    first, second = np.nonzero(sums[:, :, 0] >= MIN_BORDER_PAIRS)
    found = sums[first, second]
    return RegionAdjacency(first, second, found[:, 0], found[:, 1:4] / found[:, :1],
                           found[:, 4:] / found[:, :1])


@kernel('float64[:, :, ::1](int32[:, ::1], float64[:, ::1], boolean[::1], int64)')
def _border_sums(labels, table, is_planar, count):
    """Return the number of pairs of cells of regions i < j and the sums of their x, y, d."""
    rows, columns = labels.shape
    sums = np.zeros((count, count, 7))
    for i in range(labels.size):
        row, column = i // columns, i % columns
        if labels[row, column] < 0 or not is_planar[i]:
            continue
        for step in range(1, BORDER_REACH_CELLS + 1):
            for down in range(2):
                r, c = row + step * down, column + step * (1 - down)
                if r >= rows or c >= columns:
                    continue
                j = r * columns + c
                one, other = labels[row, column], labels[r, c]
                if other < 0 or other == one or not is_planar[j]:
                    continue
                here, there = (i, j) if one < other else (j, i)
                total = sums[min(one, other), max(one, other)]
                total[0] += 1
                for k in range(3):
                    total[1 + k] += table[here, k]
                    total[4 + k] += table[there, k]
    return sums


def best_pairs(adjacency: RegionAdjacency, misfit: np.ndarray) -> np.ndarray:
    """Return the pairs with misfit (P,) up to 1, best first; each region is used once."""
    chosen, used = [], set()
    for k in np.argsort(misfit, kind='stable'):
        if misfit[k] > 1:
            break
        pair = {adjacency.first[k], adjacency.second[k]}
        if not pair & used:
            chosen.append(k)
        used |= pair
    return np.array(chosen, int)


def merge(cells: WeightedCells, regions: PlaneRegions, target: np.ndarray,
          source: np.ndarray) -> PlaneRegions:
    """Return the regions with each ``source`` (n,) merged into its ``target`` (n,), refitted."""
    count = len(regions.coefficients)
    owner = np.arange(count)
    owner[source] = target
    kept = owner == np.arange(count)
    index = np.append((np.cumsum(kept) - 1)[owner], -1).astype(np.int32)
    labels, planes = index[regions.labels], regions.coefficients[kept]
    changed = index[target]
    planes[changed] = fit_planes(region_moments(cells, labels, len(planes)))[changed]
    return PlaneRegions(labels, planes)


@dataclass(frozen=True)
class RegionSums:
    """Moments (K, 10) of the means of each region's planar cells, their number, mean variance."""

    moments: np.ndarray
    count: np.ndarray
    variance: np.ndarray


def sum_up_regions(cells: WeightedCells, regions: PlaneRegions) -> RegionSums:
    """Sum the cells of each region, each cell as one pixel."""
    sums = _sums_of_means(np.ascontiguousarray(regions.labels).reshape(-1), cells.table,
                          cells.is_planar, len(regions.coefficients))
    count = np.maximum(sums[:, 0], 1)
    return RegionSums(np.ascontiguousarray(sums[:, :10]), count, sums[:, 10] / count)


@kernel('float64[:, ::1](int32[::1], float64[:, ::1], boolean[::1], int64)')
def _sums_of_means(labels, table, is_planar, count):
    sums = np.zeros((count, 11))
    for i in range(len(labels)):
        if labels[i] < 0 or not is_planar[i]:
            continue
        x, y, d = table[i, 0], table[i, 1], table[i, 2]
        for k, value in enumerate((1.0, x, y, x * x, x * y, y * y, d, x * d, y * d, d * d,
                                   1 / table[i, 5])):
            sums[labels[i], k] += value
    return sums


def joint_misfit(cells: WeightedCells, regions: PlaneRegions, first: np.ndarray,
                 second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the misfit (P,) of one plane to each pair, at most 1 for a fit; planes (P, 3)."""
    sums = sum_up_regions(cells, regions)
    joint = fit_planes(sums.moments[first] + sums.moments[second])
    error = [squared_errors(joint, sums.moments[side]) / sums.count[side] / sums.variance[side]
             for side in (first, second)]
    return np.fmax(*error) / MAX_JOINT_VARIANCES, joint
