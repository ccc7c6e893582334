# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sequential RANSAC: hypotheses from windows of cells, all scored at once, the best one refined.

RANSAC (Fischler and Bolles 1981) with the truncated quadratic score of MSAC (Torr and Zisserman
2000) and local optimisation (Chum et al. 2003). The samples are windows of cells, not triples of
points: a window is on one plane far more often than three points are. A plane is refitted to the
largest density cluster of its inliers (Ester et al. 1996, DBSCAN), so that it collects no streaks
from surfaces that it happens to cut.

Inliers of one plane that are neighbours in the image are neighbours in space too: the inlier
threshold bounds the gap in disparity between them. The grid gets a margin, so that all neighbours
of a cell are places in it, and is flat, so that they are a fixed number of steps away.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector._runtime.stopping import raise_if_stopped
from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells.grid import (
    CellGrid,
    N,
    add_moments,
    fit_plane,
    squared_error,
)
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    MAX_JOINT_VARIANCES,
    MEAN_D,
    MEAN_WEIGHT,
    MEAN_X,
    MEAN_Y,
    SLOPE_WEIGHT,
    SLOPE_X,
    SLOPE_Y,
    SQUARED_ERROR,
    Frame,
    PlaneRegions,
    chi_squared,
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
# Rows and columns: small windows find small planes, long ones narrow planes, large ones planes
# under noise.
# tuned: on rooms and lived-in rooms of seeds below 9000; their range was not swept.
WINDOWS_CELLS = np.array([[3, 3], [2, 7], [7, 2], [9, 9]])
WIDEST_WINDOW_CELLS = int(WINDOWS_CELLS.max())
# tuned: rooms, lived-in rooms and real frames; flat from 0.5 to 0.7; at 1.0 precision of lived-in
# rooms -0.015.
WINDOW_MIN_FREE = 0.7
# derived: multiples of the golden ratio modulo 1 cover an interval evenly (Weyl 1916).
GOLDEN_RATIO = 0.6180339887498949
# derived: float32 values in the widest vector register of a CPU.
VECTOR = 16
# Types of kernels' arguments. Cells: their table and their moments. Free cells: the index of the
# cell at each place of a grid with a margin, -1 where there is none that belongs to no plane; what
# follows are places in that grid.
CELLS = 'UniTuple(float64[:, ::1], 2)'
FREE = 'int32[::1]'
# Type of kernels' arguments: steps to the neighbours in a flat grid, and how many of them, itself
# included, a core cell has.
NEAR = 'Tuple((int64[::1], int64))'


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
    """Return the hypothesis with the most support, times the preference for it."""
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
        if trial > 0 and len(grown) + len(members) - 2 * kept <= SETTLED_SHARE * len(grown):
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


@kernel(f'Tuple((float64[:, ::1], float64))({FREE}, int64, {CELLS}, int64, float64, '
        'float64[:, ::1])')
def draw_planes(free, stride, cells, wanted, share, known):
    """
    Return the planes (h, 4) of windows that are flat, about some free cells, and the next share.

    The last column is what their support is multiplied by, 1. The known planes come first.

    The windows are at the places of an even sequence over the image. They do not move when cells
    elsewhere become free or are taken, so slight noise draws nearly the same planes.
    """
    table, moments = cells
    planes = np.ones((len(known) + wanted * len(WINDOWS_CELLS), 4))
    total, n = np.empty(10), len(known)
    for k in range(n):
        for column in range(4):
            planes[k, column] = known[k, column]
    for window in range(len(WINDOWS_CELLS)):
        height, width, drawn = WINDOWS_CELLS[window, 0], WINDOWS_CELLS[window, 1], 0
        for _ in range(len(free)):
            if drawn == wanted:
                break
            share += GOLDEN_RATIO
            share -= int(share)
            place, filled = int(share * len(free)), 0
            if free[place] < 0:
                continue
            drawn += 1
            corner = place - height // 2 * stride - width // 2
            for left_end in range(corner, corner + height * stride, stride):
                for p in range(left_end, left_end + width):
                    filled += free[np.uint64(p)] >= 0  # unsigned: no wrap-around check
            if filled < WINDOW_MIN_FREE * height * width:
                continue
            expected = 0.0
            for j in range(10):
                total[j] = 0.0
            for left_end in range(corner, corner + height * stride, stride):
                for p in range(left_end, left_end + width):
                    if free[p] >= 0:
                        add_moments(total, moments[free[p]])
                        expected += table[free[p], SQUARED_ERROR]
            a, b, c = fit_plane(total)
            if squared_error(a, b, c, total) < MAX_JOINT_VARIANCES * expected:
                planes[n, 0], planes[n, 1], planes[n, 2] = a, b, c
                n += 1
    return planes[:n], share


@kernel('Tuple((float64[:, ::1], float32[::1]))(float64[:, ::1], float32[::1], float64)')
def supported(planes, gain, least):
    """Keep hypotheses with enough support: the support of the others can only fall."""
    n = 0
    for h in range(len(gain)):
        if gain[h] >= least:
            for column in range(4 if n < h else 0):
                planes[n, column] = planes[h, column]
            gain[n] = gain[h]
            n += 1
    return planes[:n], gain[:n]


@kernel(f'void(float32[::1], float64[:, ::1], {CELLS}, {FREE}, int64[::1], '
        'Tuple((int64, float64)))')
def add_support(gain, planes, cells, free, places, limits):
    """
    Add the support of cells to gain (H,): pixels times 1 - (residual / threshold)**2 (MSAC).

    Every second cell, as on a checkerboard, stands for two.
    """
    # Whole vectors: the loop over the rest of the planes would take as long as over all others.
    work = np.zeros((4, -(-len(gain) // VECTOR) * VECTOR), np.float32)
    for h in range(len(gain)):
        work[0, h], work[1, h], work[2, h] = planes[h, 0], planes[h, 1], planes[h, 2]
        work[3, h] = gain[h]
    a, b, c, total = work[0], work[1], work[2], work[3]
    (table, moments), (sign, threshold2) = cells, limits
    zero, one, per = np.float32(0), np.float32(1), 1 / threshold2
    for p in places:
        if p & 1:
            continue
        i = free[p]
        x, y = np.float32(table[i, MEAN_X]), np.float32(table[i, MEAN_Y])
        d = np.float32(table[i, MEAN_D])
        slope_x, slope_y = np.float32(table[i, SLOPE_X]), np.float32(table[i, SLOPE_Y])
        w, s = np.float32(table[i, MEAN_WEIGHT] * per), np.float32(table[i, SLOPE_WEIGHT] * per)
        pixels = np.float32(2 * sign * moments[i, N])
        for h in range(len(total)):
            residual = d - c[h] - a[h] * x - b[h] * y
            tilt_x, tilt_y = slope_x - a[h], slope_y - b[h]
            support = (one - w * residual * residual
                       - s * (tilt_x * tilt_x + tilt_y * tilt_y))
            total[h] += pixels * max(support, zero)
    for h in range(len(gain)):
        gain[h] = total[h]


def _stride(columns: int, margin: int) -> int:
    """Return the length of rows with a margin: odd, so that one parity is a checkerboard."""
    return columns + 2 * margin + 1 - columns % 2


@lru_cache(maxsize=8)
def cell_places(shape: tuple[int, int], margin: int) -> np.ndarray:
    """Return the index of the cell at each place of a grid with a margin of -1."""
    right = _stride(shape[1], margin) - shape[1] - margin
    return cv2.copyMakeBorder(np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape),
                              margin, margin, margin, right, cv2.BORDER_CONSTANT, value=-1)


@lru_cache(maxsize=8)
def neighbour_steps(eps: float, stride: int) -> np.ndarray:
    """Return the steps (m,) to the cells within ``eps`` in a flat grid with rows of a length."""
    reach = range(-int(eps), int(eps) + 1)
    return np.array([i * stride + j for i in reach for j in reach if i * i + j * j <= eps**2])


def label_clusters(labels: np.ndarray, dbscan: DbscanConfig
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Cluster the cells of each label separately.

    Parameters
    ----------
    labels : (R, C) int32
        -1 none; below 2**15.
    dbscan : DbscanConfig

    Returns
    -------
    clusters : (R, C) int32
        Cluster of each cell, -1 for noise and where there is no label; no cluster has two labels.
    cells : (N,) int32
        Cells of the clusters, one cluster after the other.
    starts : (K + 1,) int64
        Where each begins in ``cells``, and the end.

    """
    margin, stride = int(dbscan.eps), _stride(labels.shape[1], int(dbscan.eps))
    return _cluster(np.ascontiguousarray(labels), margin,
                    (neighbour_steps(dbscan.eps, stride), dbscan.min_samples), stride)


@kernel(f'Tuple((int32[:, ::1], int32[::1], int64[::1]))(int32[:, ::1], int64, {NEAR}, int64)',
        is_short=True)
def _cluster(labels, margin, near, stride):
    """Return the cluster of each cell, the cells cluster by cluster, where each starts."""
    (rows, columns), clusters = labels.shape, np.full(labels.shape, np.int32(-1))
    wide = np.full((rows + 2 * margin) * stride, np.int16(-1))
    for row in range(rows):
        first = (row + margin) * stride + margin
        for column in range(columns):
            wide[first + column] = labels[row, column]
    queue, is_taken = np.empty(len(wide), np.int64), np.zeros(len(wide), np.bool_)
    cells, starts = np.empty(labels.size, np.int32), np.zeros(labels.size + 1, np.int64)
    count, end = 0, 0
    for start in range(len(wide)):
        if wide[start] >= 0 and not is_taken[start]:
            begin, end = end, grow_cluster(queue, end, start, (wide, is_taken), near)
            for k in range(begin, end):
                row, column = queue[k] // stride - margin, queue[k] % stride - margin
                clusters[row, column], cells[k] = count, row * columns + column
            count += end > begin
            starts[count] = end
    return clusters, cells[:end].copy(), starts[:count + 1].copy()


@kernel(f'int64(int64[::1], int64, int64, Tuple((int16[::1], boolean[::1])), {NEAR})')
def grow_cluster(queue, end, start, grids, near):
    """
    Append the density cluster of a core to a queue of places; return where the queue ends.

    Its cells are marked as taken, because a cell is in one cluster. If the start is not a core,
    nothing is appended.
    """
    (labels, is_taken), (steps, min_samples), head, here = grids, near, end, start
    label = labels[start]
    while True:
        samples, k = 0, 0
        while samples < min_samples and k < len(steps):
            samples += labels[np.uint64(here + steps[k])] == label  # unsigned: no wrap-around
            k += 1
        for k in range(len(steps) if samples >= min_samples else 0):
            p = np.uint64(here + steps[k])
            if labels[p] == label and not is_taken[p]:
                queue[end], is_taken[p] = p, True
                end += 1
        if head == end:
            return end
        here, head = queue[head], head + 1
