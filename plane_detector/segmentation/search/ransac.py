# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sequential RANSAC: hypotheses from windows of cells, all scored at once, the best one refined.

RANSAC (Fischler and Bolles 1981) with the truncated quadratic score of MSAC (Torr and Zisserman
2000) and local optimisation (Chum et al. 2003). The samples are windows of cells, not triples of
points: a window is on one plane far more often than three points are. A plane is refitted to the
largest density cluster of its inliers, so that it collects no streaks from surfaces that it
happens to cut.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.plane_fit import fit_plane, squared_error
from plane_detector.segmentation.search.dbscan import count_samples, grow_cluster, neighbourhood
from plane_detector.stopping import raise_if_stopped

# Rows and columns: small windows find small planes, long ones narrow planes, large ones planes
# under noise.
# tuned: on rooms and lived-in rooms of seeds below 9000; their range was not swept.
WINDOWS_CELLS = np.array([[3, 3], [2, 7], [7, 2], [9, 9]])
# tuned: rooms, lived-in rooms and real frames; flat from 0.5 to 0.7; at 1.0 precision of lived-in
# rooms -0.015.
WINDOW_MIN_FREE = 0.7
# derived: a window across a crease exceeds the mean of chi-squared, 1, by far.
WINDOW_MAX_VARIANCES = 2.5
# One draw finds, with the configured confidence, the planes with this share of the free cells.
# tuned: on rooms, lived-in rooms and real frames; flat from 0.05 to 0.1.
ROUND_PLANE_SHARE = 0.07
# derived: multiples of the golden ratio modulo 1 cover an interval evenly (Weyl 1916).
GOLDEN_RATIO = 0.6180339887498949
# A hypothesis that refines to nothing costs time; after this many in a row others are drawn.
# tuned: rooms, lived-in rooms and real frames; flat from 2 to 4.
MAX_FAILURES = 3
# tuned: as above; flat from 3 to 6.
REFINEMENTS = 4
# A plane has settled when its cells change by no more than this share.
# tuned: as above; flat from 0.02 to 0.043, where 1 % of the pixels of real frames lose a label.
SETTLED_SHARE = 0.03
# Types of kernels' arguments. Free cells: the number of each in a grid with a margin, else -1; the
# place in that grid and the index of each; and, a row each, what is tested: mean x, y, d, slope
# along x and y, inverse variances of mean and slope over the squared threshold, and pixels, 0 for
# those that belong to a plane by now.
FREE = 'Tuple((int32[::1], int64[::1], int64[::1], float32[:, ::1]))'
# Steps to the neighbours in the grid with a margin, and how many of them a core cell has.
NEAR = 'Tuple((int64[::1], int64))'


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
    raise_if_stopped()
    ransac, near = search.config.ransac, neighbourhood(search.config.dbscan)
    labels, first = regions.labels.copy(), len(regions.coefficients)
    wanted = math.ceil(math.log1p(-ransac.confidence) / math.log1p(-ROUND_PLANE_SHARE))
    counts = first, most, min(max(wanted, 1), ransac.max_iterations), ransac.max_iterations
    limits = search.min_pixels, ransac.inlier_threshold**2, search.rng.random()
    found = find_planes((cells.table, cells.grid.moments), cells.is_planar, labels,
                        (near.offsets, near.min_samples), counts, limits)
    return PlaneRegions(labels, np.vstack([regions.coefficients, found]))


@kernel('float64[:, ::1](UniTuple(float64[:, ::1], 2), boolean[::1], int32[:, ::1], '
        'Tuple((int64[:, ::1], int64)), UniTuple(int64, 4), UniTuple(float64, 3))')
def find_planes(cells, is_planar, labels, near, counts, limits):
    """Draw hypotheses and take the best until a draw yields none; return the planes (n, 3)."""
    (offsets, min_samples), (first, most, wanted, max_drawn) = near, counts
    min_pixels, threshold2, share = limits
    margin = max(offsets.max(), WINDOWS_CELLS.max() // 2)
    stride = labels.shape[1] + 2 * margin
    free = _free_cells(cells, is_planar, labels, margin, threshold2)
    near = offsets[:, 0] * stride + offsets[:, 1], min_samples
    planes, taken, drawn = np.empty((most - first, 3)), 0, 0
    while taken < len(planes) and drawn < max_drawn and free[3][7].sum() >= min_pixels:
        left, before = np.flatnonzero(free[3][7]), taken
        hypotheses = _draw(left, free, stride, cells,
                           (min(wanted, len(left)), share + GOLDEN_RATIO * drawn))
        taken += _take_best(hypotheses, (left, free, cells[1], near), labels, planes[taken:],
                            (first + taken, min_pixels))
        drawn += len(hypotheses)
        if taken == before or len(left) <= wanted:  # every free cell has been tried
            break
    return planes[:taken]


@kernel(f'{FREE}(UniTuple(float64[:, ::1], 2), boolean[::1], int32[:, ::1], int64, float64)')
def _free_cells(cells, is_planar, labels, margin, threshold2):
    """Return the cells that are planar and belong to no plane."""
    (table, moments), (rows, columns), n = cells, labels.shape, 0
    stride, per = columns + 2 * margin, 1 / threshold2
    number = np.full((rows + 2 * margin) * stride, np.int32(-1))
    place, index = np.empty(labels.size, np.int64), np.empty(labels.size, np.int64)
    for row in range(rows):
        for column in range(columns):
            i, p = row * columns + column, (row + margin) * stride + column + margin
            if is_planar[i] and labels[row, column] < 0:
                place[n], index[n], number[p] = p, i, n
                n += 1
    tested = np.empty((8, n), np.float32)
    for k in range(n):
        i = index[k]
        for j in range(5):
            tested[j, k] = table[i, j]
        tested[5, k], tested[6, k], tested[7, k] = (table[i, 5] * per, table[i, 6] * per,
                                                    moments[i, 0])
    return number, place[:n].copy(), index[:n].copy(), tested


@kernel(f'float64[:, ::1](int64[::1], {FREE}, int64, UniTuple(float64[:, ::1], 2), '
        'Tuple((int64, float64)))')
def _draw(left, free, stride, cells, draws):
    """Return the planes (h, 3) of windows that are flat, about some of the cells left."""
    (number, place, index, tested), (table, moments), (wanted, share) = free, cells, draws
    planes, total, n = np.empty((wanted * len(WINDOWS_CELLS), 3)), np.empty(10), 0
    for window in range(len(WINDOWS_CELLS)):
        height, width = WINDOWS_CELLS[window, 0], WINDOWS_CELLS[window, 1]
        for _ in range(wanted):
            share += GOLDEN_RATIO
            share -= int(share)
            corner = place[left[int(share * len(left))]] - height // 2 * stride - width // 2
            total[:], expected, filled = 0.0, 0.0, 0
            for left_end in range(corner, corner + height * stride, stride):
                for p in range(left_end, left_end + width):
                    if number[p] >= 0 and tested[7, number[p]] > 0:
                        i = index[number[p]]
                        for j in range(10):
                            total[j] += moments[i, j]
                        expected += table[i, 7]
                        filled += 1
            a, b, c = fit_plane(total)
            if (filled >= WINDOW_MIN_FREE * height * width
                    and squared_error(a, b, c, total) < WINDOW_MAX_VARIANCES * expected):
                planes[n, 0], planes[n, 1], planes[n, 2] = a, b, c
                n += 1
    return planes[:n]


@kernel(f'int64(float64[:, ::1], Tuple((int64[::1], {FREE}, float64[:, ::1], {NEAR})), '
        'int32[:, ::1], float64[:, ::1], Tuple((int64, float64)))')
def _take_best(hypotheses, search, labels, planes, limits):
    """Write the planes of most support to labels and planes; return how many."""
    (left, free, moments, near), (first, min_pixels) = search, limits
    _, _, index, tested = free
    gain, taken, failures = np.zeros(len(hypotheses), np.float32), 0, 0
    _add_support(gain, hypotheses, tested, left, 1)
    while taken < len(planes) and failures < MAX_FAILURES and len(gain):
        best = np.argmax(gain)
        if gain[best] < min_pixels / 2:
            break
        plane, members = _refine(hypotheses[best], free, moments, near)
        if tested[7][members].sum() < max(min_pixels, 1.0):
            gain[best] = 0
            failures += 1
            continue
        _add_support(gain, hypotheses, tested, members, -1)
        for k in members:
            i = index[k]
            labels[i // labels.shape[1], i % labels.shape[1]] = first + taken
            tested[7, k] = 0
        for i in range(3):  # an assignment of arrays would take a second more to compile
            planes[taken, i] = plane[i]
        taken, failures = taken + 1, 0
    return taken


@kernel('void(float32[::1], float64[:, ::1], float32[:, ::1], int64[::1], int64)')
def _add_support(gain, planes, tested, cells, sign):
    """Add the support of cells to gain (H,): pixels times 1 - (residual / threshold)**2 (MSAC)."""
    a, b, c = (planes[:, 0].astype(np.float32), planes[:, 1].astype(np.float32),
               planes[:, 2].astype(np.float32))
    zero, one = np.float32(0), np.float32(1)
    for k in cells:
        x, y, d, slope_x, slope_y = (tested[0, k], tested[1, k], tested[2, k], tested[3, k],
                                     tested[4, k])
        w, s, pixels = tested[5, k], tested[6, k], tested[7, k] * np.float32(sign)
        for h in range(len(gain)):
            residual = d - c[h] - a[h] * x - b[h] * y
            tilt_x, tilt_y = slope_x - a[h], slope_y - b[h]
            support = (one - w * residual * residual
                       - s * (tilt_x * tilt_x + tilt_y * tilt_y))
            gain[h] += pixels * max(support, zero)


@kernel(f'Tuple((float64[::1], int64[::1]))(float64[::1], {FREE}, float64[:, ::1], {NEAR})')
def _refine(plane, free, moments, near):
    """Refit a plane to a cluster of its inliers until they settle; return it and them."""
    members, index = np.flatnonzero(free[3][7]), free[2]
    for _ in range(REFINEMENTS):
        grown, kept = _cluster_about(members, plane, free, near)
        if len(grown) + len(members) - 2 * kept <= SETTLED_SHARE * len(grown):
            break
        total = np.zeros(10)
        for k in grown:
            for j in range(10):
                total[j] += moments[index[k], j]
        a, b, c = fit_plane(total)
        if np.isnan(a):
            return plane, grown[:0]
        plane, members = np.array([a, b, c]), grown
    return plane, members


@kernel(f'Tuple((int64[::1], int64))(int64[::1], float64[::1], {FREE}, {NEAR})')
def _cluster_about(members, plane, free, near):
    """Return the density cluster of inliers that holds most members, and how many it holds."""
    (number, place, _, _), (steps, min_samples) = free, near
    inliers, is_member = _inliers(plane, free), np.zeros(len(place), np.bool_)
    is_member[members] = True
    samples, queue = count_samples(inliers, steps), np.empty(len(place) + 1, np.int64)
    end = most = first = last = 0
    for k in members:
        if inliers[place[k]] < 0 or samples[place[k]] < min_samples:
            continue
        begin, held = end, 0
        end = grow_cluster(queue, begin, place[k], (inliers, samples), near)
        for m in range(begin, end):
            held += is_member[number[queue[m]]]
        if end > begin + 1 and held > most:
            most, first, last = held, begin, end
        if 2 * most >= len(members):  # no other can hold more
            break
    cluster = np.empty(last - first, np.int64)
    for m in range(len(cluster)):
        cluster[m] = number[queue[first + m]]
    return cluster, most


@kernel(f'int16[::1](float64[::1], {FREE})')
def _inliers(plane, free):
    """Return 0 at the places of free cells within the threshold of a plane, else -1."""
    number, place, _, tested = free
    a, b, c = np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2])
    x, y, d, slope_x, slope_y = tested[0], tested[1], tested[2], tested[3], tested[4]
    weight, slope_weight, pixels = tested[5], tested[6], tested[7]
    fits, inliers = np.empty(len(x), np.int16), np.full(len(number), np.int16(-1))
    for k in range(len(x)):
        residual = d[k] - c - a * x[k] - b * y[k]
        tilt_x, tilt_y = slope_x[k] - a, slope_y[k] - b
        misfit = (weight[k] * residual * residual
                  + slope_weight[k] * (tilt_x * tilt_x + tilt_y * tilt_y))
        fits[k] = 0 if (misfit < np.float32(1)) & (pixels[k] > np.float32(0)) else -1
    for k in range(len(x)):
        inliers[place[k]] = fits[k]
    return inliers
