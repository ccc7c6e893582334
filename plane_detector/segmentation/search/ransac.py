# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sequential RANSAC: hypotheses from windows of cells, all scored at once, the best one refined.

RANSAC (Fischler and Bolles 1981) with the truncated quadratic score of MSAC (Torr and Zisserman
2000) and local optimisation (Chum et al. 2003). The samples are windows of cells, not triples of
points: a window is on one plane far more often than three points are. A plane is refitted to the
density cluster of its inliers around its window, so that it collects no streaks from surfaces that
it happens to cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, chi_squared
from plane_detector.segmentation.cells.plane_fit import fit_plane, squared_error
from plane_detector.segmentation.search.dbscan import neighbourhood
from plane_detector.stopping import raise_if_stopped

# Rows and columns: small windows find small planes, long ones narrow planes, large ones planes
# under noise.
# tuned: on rooms and lived-in rooms of seeds below 9000; their range was not swept.
WINDOWS_CELLS = np.array([[3, 3], [2, 7], [7, 2], [9, 9]])
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
WINDOW_MIN_FREE = 0.7
# derived: a window across a crease exceeds the mean of chi-squared, 1, by far.
WINDOW_MAX_VARIANCES = 2.5
# One round finds, with the configured confidence, the planes with this share of the free cells.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
ROUND_PLANE_SHARE = 0.1
# A hypothesis that refines to nothing costs time; after this many in a row the round is over.
# tuned: on rooms, for time; compiled in, so its range was not swept.
MAX_FAILURES = 3
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
REFINEMENTS = 4
# A plane has settled when its cells change by no more than this share.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
SETTLED_SHARE = 0.03


@dataclass(frozen=True)
class Search:
    """Inputs of a search except the noise: grid, smallest plane, settings, random generator."""

    grid: CellGrid
    min_pixels: float
    config: Config
    rng: np.random.Generator


def no_planes(grid: CellGrid) -> PlaneRegions:
    """Return regions without any plane."""
    return PlaneRegions(np.full(grid.shape, -1, np.int32), np.zeros((0, 3)))


def add_planes(search: Search, cells: WeightedCells, regions: PlaneRegions,
               most: int) -> PlaneRegions:
    """
    Find planes among the cells that belong to none, one after the other.

    Parameters
    ----------
    search : Search
    cells : WeightedCells
    regions : PlaneRegions
        Planes found before.
    most : int
        Total number of planes at which the search ends.

    Returns
    -------
    PlaneRegions
        With the planes found before first.

    """
    ransac, near = search.config.ransac, neighbourhood(search.config.dbscan)
    labels, planes = regions.labels.copy(), regions.coefficients
    wanted = np.log1p(-ransac.confidence) / np.log1p(-ROUND_PLANE_SHARE)
    wanted = int(np.clip(np.ceil(wanted), 1, ransac.max_iterations))
    drawn = 0
    while len(planes) < most and drawn < ransac.max_iterations:
        raise_if_stopped()
        # More than needed, because windows with too few free cells are drawn again.
        chance = search.rng.random((len(WINDOWS_CELLS), len(WINDOWS_CELLS) * wanted))
        limits = np.array([search.min_pixels, ransac.inlier_threshold**2, most, len(planes)])
        found = find_in_one_round((cells.table, cells.grid.moments), cells.is_planar, labels,
                                  (near.offsets, near.min_samples),
                                  (WINDOWS_CELLS, chance, wanted), limits)
        if not len(found):
            break
        planes, drawn = np.vstack([planes, found]), drawn + wanted * len(WINDOWS_CELLS)
    return PlaneRegions(labels, planes)


@kernel('float64[:, ::1](UniTuple(float64[:, ::1], 2), boolean[::1], int32[:, ::1], '
        'Tuple((int64[:, ::1], int64)), Tuple((int64[:, ::1], float64[:, ::1], int64)), '
        'float64[::1])')
def find_in_one_round(cells, is_planar, labels, near, windows, limits):
    """Draw hypotheses, label the planes (n, 3) of the best ones and return them."""
    (table, moments), (offsets, min_samples) = cells, near
    min_pixels, threshold2, most, first = limits
    found, count, failures = np.empty((int(most - first), 3)), 0, 0
    listed, free, place = _free_cells(is_planar, labels, offsets.max())
    step = offsets[:, 0] * (labels.shape[1] + 2 * offsets.max()) + offsets[:, 1]
    left = 0.0
    for i in listed:
        left += moments[i, 0]
    if left < min_pixels:
        return found[:0]
    planes, seeds = _draw(listed, is_planar, labels, cells, windows)
    gain = np.zeros(len(planes), np.float32)
    add_support(gain, planes, table, moments, listed, 1 / threshold2)
    while count < len(found) and failures < MAX_FAILURES and len(gain):
        best = np.argmax(gain)
        if gain[best] < min_pixels / 2:
            break
        plane, members = _refine(planes[best], place[seeds[best]], threshold2, cells,
                                 (free, step, min_samples))
        pixels = 0.0
        for p in members:
            pixels += moments[-1 - free[p], 0]
        if pixels < max(min_pixels, 1.0):
            gain[best] = 0
            failures += 1
            continue
        for k, p in enumerate(members):
            i = -1 - free[p]
            labels[i // labels.shape[1], i % labels.shape[1]] = int(first) + count
            free[p], members[k] = 0, i
        add_support(gain, planes, table, moments, members, -1 / threshold2)
        found[count], failures = plane, 0
        count += 1
    return found[:count]


@kernel('Tuple((int64[::1], int32[::1], int64[::1]))(boolean[::1], int32[:, ::1], int64)')
def _free_cells(is_planar, labels, margin):
    """Return the free cells (n,), -1 - i at the place of free cell i, and the place of each."""
    (rows, columns), stride = labels.shape, labels.shape[1] + 2 * margin
    free, n = np.zeros((rows + 2 * margin) * stride, np.int32), 0
    listed, place = np.empty(labels.size, np.int64), np.empty(labels.size, np.int64)
    for i in range(labels.size):
        place[i] = (i // columns + margin) * stride + i % columns + margin
        if is_planar[i] and labels[i // columns, i % columns] < 0:
            listed[n], free[place[i]] = i, -1 - i
            n += 1
    return listed[:n], free, place


@kernel('Tuple((float64[:, ::1], int64[::1]))(int64[::1], boolean[::1], int32[:, ::1], '
        'UniTuple(float64[:, ::1], 2), Tuple((int64[:, ::1], float64[:, ::1], int64)))')
def _draw(listed, is_planar, labels, cells, windows):
    """Return the planes (h, 3) of random windows that are flat, and their middle cells (h,)."""
    (table, moments), (sizes, chance, wanted), (rows, columns) = cells, windows, labels.shape
    planes, seeds = np.empty((chance.size, 3)), np.empty(chance.size, np.int64)
    total, count = np.empty(10), 0
    for k in range(len(sizes)):
        height, width, drawn = sizes[k, 0], sizes[k, 1], 0
        for share in chance[k]:
            if drawn == min(wanted, len(listed)):
                break
            seed = listed[int(share * len(listed))]
            top, left = seed // columns - height // 2, seed % columns - width // 2
            total[:], expected, n = 0.0, 0.0, 0
            for row in range(max(top, 0), min(top + height, rows)):
                for column in range(max(left, 0), min(left + width, columns)):
                    cell = row * columns + column
                    if is_planar[cell] and labels[row, column] < 0:
                        for j in range(10):
                            total[j] += moments[cell, j]
                        expected += table[cell, 7]
                        n += 1
            if n < WINDOW_MIN_FREE * height * width:
                continue
            drawn += 1
            a, b, c = fit_plane(total)
            if squared_error(a, b, c, total) < WINDOW_MAX_VARIANCES * expected:
                planes[count, 0], planes[count, 1], planes[count, 2] = a, b, c
                seeds[count] = seed
                count += 1
    return planes[:count], seeds[:count]


@kernel('void(float32[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], int64[::1], '
        'float64)')
def add_support(gain, planes, table, moments, cell, weight):
    """
    Add the support of some cells to gain (H,): pixels times 1 - (residual / threshold)**2 (MSAC).

    ``weight`` is one over the squared threshold; a negative weight subtracts the support.
    """
    a, b, c = (planes[:, 0].astype(np.float32), planes[:, 1].astype(np.float32),
               planes[:, 2].astype(np.float32))
    zero, one = np.float32(0), np.float32(1)
    for i in cell:
        x, y, d = np.float32(table[i, 0]), np.float32(table[i, 1]), np.float32(table[i, 2])
        slope_x, slope_y = np.float32(table[i, 3]), np.float32(table[i, 4])
        w, s = np.float32(table[i, 5] * abs(weight)), np.float32(table[i, 6] * abs(weight))
        pixels = np.float32(moments[i, 0] if weight > 0 else -moments[i, 0])
        for h in range(len(gain)):
            residual = d - c[h] - a[h] * x - b[h] * y
            tilt_x, tilt_y = slope_x - a[h], slope_y - b[h]
            support = (one - w * residual * residual
                       - s * (tilt_x * tilt_x + tilt_y * tilt_y))
            gain[h] += pixels * max(support, zero)


@kernel('Tuple((float64[::1], int64[::1]))(float64[::1], int64, float64, '
        'UniTuple(float64[:, ::1], 2), Tuple((int32[::1], int64[::1], int64)))')
def _refine(plane, seed, threshold2, cells, near):
    """Refit a plane to its inliers about the seed until they settle; return it and them."""
    (table, moments), free = cells, near[0]
    members = np.array([seed])
    for _ in range(REFINEMENTS):
        grown, kept = _cluster_about(members, plane, threshold2, table, near)
        if len(grown) == 0:  # no member is in a cluster: the largest one of all
            grown, _ = _cluster_about(np.flatnonzero(free), plane, threshold2, table, near)
            kept = 0
        if len(grown) == 0:
            return plane, grown
        if len(grown) + len(members) - 2 * kept <= SETTLED_SHARE * len(grown):
            break
        total = np.zeros(10)
        for p in grown:
            for j in range(10):
                total[j] += moments[-1 - free[p], j]
        a, b, c = fit_plane(total)
        if np.isnan(a):
            return plane, grown[:0]
        plane, members = np.array([a, b, c]), grown
    return plane, members


@kernel('Tuple((int64[::1], int64))(int64[::1], float64[::1], float64, float64[:, ::1], '
        'Tuple((int32[::1], int64[::1], int64)))')
def _cluster_about(members, plane, threshold2, table, near):
    """Return the density cluster of inliers that holds most members, and how many it holds."""
    free, step, min_samples = near
    # Free cells that were not tested are below 0; 0: outlier, 1: inlier, then the cluster.
    marks, is_member, queue = free.copy(), np.zeros(len(free), np.bool_), np.empty(
        len(free) + len(step), np.int64)
    is_member[members] = True
    head, tail, cluster, most, first, last = 0, 0, 1, 0, 0, 0
    for start in members:
        if marks[start] > 1:
            continue
        begin, held, queue[tail] = tail, 0, start
        cluster, tail = cluster + 1, tail + 1
        marks[start] = cluster
        while head < tail:
            p, samples, fresh = queue[head], 0, tail
            head, held = head + 1, held + is_member[p]
            for k in range(len(step)):
                q = p + step[k]
                if marks[q] < 0:
                    marks[q] = chi_squared(table, -1 - marks[q], plane[0], plane[1],
                                           plane[2]) < threshold2
                samples += marks[q] > 0
                queue[fresh] = q
                fresh += marks[q] == 1
            if samples >= min_samples:  # a core cell
                for q in queue[tail:fresh]:
                    marks[q] = cluster
                tail = fresh
        if tail > begin + 1 and held > most:
            most, first, last = held, begin, tail
        if 2 * most >= len(members):  # no other can hold more
            break
    return queue[first:last].copy(), most
