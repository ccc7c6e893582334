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

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector._runtime.stopping import raise_if_stopped
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    Frame,
    PlaneRegions,
    chi_squared,
)
from plane_detector.segmentation.cells.plane_fit import N, add_moments, fit_plane
from plane_detector.segmentation.search.dbscan import (
    NEAR,
    cell_places,
    grow_cluster,
    neighbour_steps,
)
from plane_detector.segmentation.search.hypotheses import (
    CELLS,
    FREE,
    WIDEST_WINDOW_CELLS,
    add_support,
    draw_planes,
    supported,
)

# One draw finds a plane with this share of the free cells with this probability.
# tuned: on rooms, lived-in rooms and real frames; flat from 0.05 to 0.1 at a probability of .99.
ROUND_PLANE_SHARE, CONFIDENCE = 0.07, 0.99
# What is repeated until it settles: refinements of a plane, estimates of the noise, and hypotheses
# in a row that refine to nothing.
# tuned: rooms, lived-in rooms and real frames; flat from 3 to 9, from 2 to 4 and from 2 to 4;
# walls under smooth noise are in pieces after 3 refinements or fewer than 3 estimates.
MAX_TRIALS = 4
# A plane has settled when its cells change by no more than this share.
# tuned: as above; flat from 0.02 to 0.043, where 1 % of the pixels of real frames lose a label.
SETTLED_SHARE = 0.03


def no_planes(grid: CellGrid) -> PlaneRegions:
    """Return regions without any plane."""
    return PlaneRegions(np.full(grid.shape, -1, np.int32), np.zeros((0, 3)))


def add_planes(frame: Frame, regions: PlaneRegions, most: int) -> PlaneRegions:
    """
    Find planes among the cells that belong to none, one after the other.

    The search ends when ``most`` planes are found. Those found before, ``regions``, count; they
    are the first of the planes returned.
    """
    raise_if_stopped()
    cells, dbscan = frame.cells, frame.config.dbscan
    max_drawn = frame.config.ransac.max_iterations
    labels, first = regions.labels.copy(), len(regions.coefficients)
    places = cell_places(labels.shape, max(int(dbscan.eps), WIDEST_WINDOW_CELLS // 2))
    wanted = math.ceil(math.log1p(-CONFIDENCE) / math.log1p(-ROUND_PLANE_SHARE))
    counts = first, most, min(wanted, max_drawn), max_drawn
    limits = frame.min_pixels, MAX_DEVIATIONS**2, frame.rng.random()
    near = neighbour_steps(dbscan.eps, places.shape[1]), dbscan.min_samples
    found = find_planes((cells.table, cells.grid.moments), (places, cells.is_planar), labels, near,
                        counts, limits, frame.known)
    return PlaneRegions(labels, np.concatenate([regions.coefficients, found]))


@kernel(f'float64[:, ::1]({CELLS}, Tuple((int32[:, ::1], boolean[::1])), int32[:, ::1], {NEAR}, '
        'UniTuple(int64, 4), UniTuple(float64, 3), float64[:, ::1])')
def find_planes(cells, grid, labels, near, counts, limits, known):
    """
    Draw hypotheses and take the best until a draw yields none; return the planes (n, 3).

    Known planes are hypotheses of the first draw.
    """
    (first, most, wanted, max_drawn), (min_pixels, threshold2, share) = counts, limits
    (places, is_planar), label = grid, labels.reshape(-1)
    stride, free = places.shape[1], places.copy().reshape(-1)
    left, n = np.empty(len(label), np.int64), 0
    for p in range(len(free)):
        if free[p] >= 0 and (label[free[p]] >= 0 or not is_planar[free[p]]):
            free[p] = -1
        if free[p] >= 0:
            left[n] = p
            n += 1
    left = left[:n].copy()
    planes, taken, drawn = np.empty((most - first, 3)), 0, 0
    while taken < len(planes) and drawn < max_drawn and _pixels(left, free, cells) >= min_pixels:
        hypotheses, share = draw_planes(free, stride, cells, min(wanted, len(left)), share, known)
        known = known[:0]
        before, all_drawn = taken, len(left) <= wanted
        new, left = _take_best(hypotheses, (left, free, cells, near), labels, planes[taken:],
                               (first + taken, min_pixels, threshold2))
        taken, drawn = taken + new, drawn + len(hypotheses)
        if taken == before or all_drawn:  # every free cell has been tried
            break
    return planes[:taken]


@kernel(f'float64(int64[::1], {FREE}, {CELLS})')
def _pixels(places, free, cells):
    """Return the number of pixels of some free cells."""
    pixels = 0.0
    for k in range(len(places)):
        pixels += cells[1][free[places[k]], N]
    return pixels


@kernel(f'Tuple((int64, int64[::1]))(float64[:, ::1], Tuple((int64[::1], {FREE}, {CELLS}, '
        f'{NEAR})), int32[:, ::1], float64[:, ::1], Tuple((int64, float64, float64)))')
def _take_best(hypotheses, search, labels, planes, limits):
    """Write the planes of most support to labels and planes; return how many, the cells left."""
    (left, free, cells, near), (first, min_pixels, threshold2) = search, limits
    gain, label = np.zeros(len(hypotheses), np.float32), labels.reshape(-1)
    taken = failures = 0
    add_support(gain, hypotheses, cells, free, left, (1, threshold2))
    while taken < len(planes) and failures < MAX_TRIALS:
        hypotheses, gain = supported(hypotheses, gain, min_pixels / 2)
        if not len(gain):
            break
        best = _preferred(gain, hypotheses)
        plane, members = _refine(hypotheses[best, :3], (left, free, cells, near), threshold2)
        if _pixels(members, free, cells) < max(min_pixels, 1.0):
            gain[best] = 0
            failures += 1
            continue
        if taken + 1 < len(planes):
            add_support(gain, hypotheses, cells, free, members, (-1, threshold2))
        for p in members:
            label[free[p]], free[p] = first + taken, -1
        n = 0
        for k in range(len(left)):
            left[n] = left[k]
            n += free[left[k]] >= 0
        for axis in range(3):  # an assignment of an array takes a second to compile
            planes[taken, axis] = plane[axis]
        left, failures, taken = left[:n], 0, taken + 1
    return taken, left


@kernel('int64(float32[::1], float64[:, ::1])')
def _preferred(gain, planes):
    """Return the hypothesis of most support, times the preference for it."""
    best = 0
    for h in range(1, len(gain)):
        if gain[h] * planes[h, 3] > gain[best] * planes[best, 3]:
            best = h
    return best


@kernel(f'Tuple((float64[::1], int64[::1]))(float64[::1], Tuple((int64[::1], {FREE}, {CELLS}, '
        f'{NEAR})), float64)')
def _refine(plane, search, threshold2):
    """Refit a plane to a cluster of its inliers until they settle; return it and them."""
    (left, free, (table, moments), near), total = search, np.empty(10)
    inliers, members = np.full(len(free), np.int16(-1)), left
    for trial in range(MAX_TRIALS):
        changes = _find_inliers(inliers, left, plane, free, table, threshold2)
        if changes == 0 and trial > 0:  # the same cluster
            break
        grown, kept = _cluster_about(members, inliers, near)
        if len(grown) + len(members) - 2 * kept <= SETTLED_SHARE * len(grown):
            break
        for j in range(10):
            total[j] = 0.0
        for k in range(len(grown)):
            add_moments(total, moments[free[grown[k]]])
        a, b, c = fit_plane(total)
        if np.isnan(a):
            return plane, grown[:0]
        plane, members = np.empty(3), grown
        plane[0], plane[1], plane[2] = a, b, c
    return plane, members


@kernel(f'int64(int16[::1], int64[::1], float64[::1], {FREE}, float64[:, ::1], float64)')
def _find_inliers(inliers, left, plane, free, table, threshold2):
    """Write 0 at the places of inliers, -1 at other free cells; return how many have changed."""
    a, b, c, changes = plane[0], plane[1], plane[2], 0
    for k in range(len(left)):
        p = np.uint64(left[k])  # unsigned: no wrap-around check
        is_inlier = chi_squared(table, np.uint64(free[p]), a, b, c) < threshold2
        label = np.int16(0) if is_inlier else np.int16(-1)
        changes += np.int64(inliers[p] != label)
        inliers[p] = label
    return changes


@kernel(f'Tuple((int64[::1], int64))(int64[::1], int16[::1], {NEAR})')
def _cluster_about(members, inliers, near):
    """Return the density cluster of inliers that holds most members, and how many it holds."""
    end = most = first = last = 0
    is_member, is_taken = np.zeros(len(inliers), np.bool_), np.zeros(len(inliers), np.bool_)
    queue = np.empty(len(inliers), np.int64)
    for k in range(len(members)):
        is_member[members[k]] = True
    for p in members:
        if inliers[p] < 0 or is_taken[p]:
            continue
        begin, held = end, 0
        end = grow_cluster(queue, begin, p, (inliers, is_taken), near)
        for k in range(begin, end):
            held += is_member[queue[k]]
        if held > most:
            most, first, last = held, begin, end
        if 2 * most >= len(members):  # no other can hold more
            break
    return queue[first:last].copy(), most
