# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Local optimisation of one plane: it is refitted to the density cluster of its inliers.

Only the cluster around the seed counts, so that a plane collects no streaks from surfaces that it
happens to cut. Cells are tested when the cluster reaches them.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import chi_squared
from plane_detector.segmentation.cells.plane_fit import fit_plane

# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
REFINEMENTS = 4
# A plane has settled when its cells change by no more than this share.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
SETTLED_SHARE = 0.03
# States of a cell.
UNKNOWN, OUTLIER, INLIER = 0, 1, 2


@kernel('Tuple((float64[::1], int64[::1]))'
        '(float64[::1], int64, float64, float64[:, ::1], float64[:, ::1], '
        'Tuple((boolean[:, ::1], int64[:, ::1], int64)))')
def refine(plane, seed, threshold2, table, moments, near):
    """
    Refit a plane to its inliers until they settle.

    Parameters
    ----------
    plane : (3,) float64
    seed : int
        A cell of the hypothesis.
    threshold2 : float
        Squared threshold, in deviations.
    table, moments : (n, 7), (n, 10) float64
    near : (R, C) bool, (m, 2) int64, int
        Free cells, and the neighbourhood of a core cell.

    Returns
    -------
    plane : (3,) float64
    members : (k,) int64
        Empty if the plane has no inlier cluster.

    """
    members = np.array([seed])
    for _ in range(REFINEMENTS):
        grown = _cluster_of(plane, members, threshold2, table, near)
        if len(grown) == 0:
            return plane, grown
        was_member = np.zeros(len(table), np.bool_)
        was_member[members] = True
        common = 0
        total = np.zeros(10)
        for i in grown:
            common += was_member[i]
            total += moments[i]
        if len(grown) + len(members) - 2 * common <= SETTLED_SHARE * len(grown):
            break
        a, b, c = fit_plane(total)
        if np.isnan(a):
            return plane, grown[:0]
        plane, members = np.array([a, b, c]), grown
    return plane, members


@kernel('int64[::1](float64[::1], int64[::1], float64, float64[:, ::1], '
        'Tuple((boolean[:, ::1], int64[:, ::1], int64)))')
def _cluster_of(plane, members, threshold2, table, near):
    """
    Return the cells of the density cluster of inliers that holds most members.

    If no member is in a cluster, the largest cluster is returned.
    """
    free, offsets, min_samples = near
    state, is_taken = np.zeros(free.shape, np.uint8), np.zeros(free.shape, np.bool_)
    cluster = np.empty(free.size, np.int64)
    if len(offsets) == 0:
        n = 0
        for i in range(free.size):
            if _is_inlier(plane, i, threshold2, table, free, state):
                cluster[n] = i
                n += 1
        return cluster[:n]
    is_member = np.zeros(free.size, np.bool_)
    is_member[members] = True
    best_start, best_end, most, tail = 0, 0, 0, 0
    for turn in range(2):
        for k in range(len(members) if turn == 0 else free.size):
            i = members[k] if turn == 0 else k
            row, column = i // free.shape[1], i % free.shape[1]
            if is_taken[row, column] or not _is_core(plane, i, threshold2, table, near, state):
                continue
            start = tail
            tail = _grow(plane, i, threshold2, table, near, (state, is_taken), cluster, start)
            size = tail - start
            if turn == 0:
                size = 0
                for m in range(start, tail):
                    size += is_member[cluster[m]]
            if size > most:
                best_start, best_end, most = start, tail, size
            if turn == 0 and 2 * most >= len(members):
                break
        if most > 0:
            break
    return cluster[best_start:best_end].copy()


@kernel('boolean(float64[::1], int64, float64, float64[:, ::1], boolean[:, ::1], uint8[:, ::1])')
def _is_inlier(plane, i, threshold2, table, free, state):
    row, column = i // free.shape[1], i % free.shape[1]
    if state[row, column] == UNKNOWN:
        fits = free[row, column] and chi_squared(table, i, plane[0], plane[1],
                                                 plane[2]) < threshold2
        state[row, column] = INLIER if fits else OUTLIER
    return state[row, column] == INLIER


@kernel('boolean(float64[::1], int64, float64, float64[:, ::1], '
        'Tuple((boolean[:, ::1], int64[:, ::1], int64)), uint8[:, ::1])')
def _is_core(plane, i, threshold2, table, near, state):
    free, offsets, min_samples = near
    rows, columns = free.shape
    if not _is_inlier(plane, i, threshold2, table, free, state):
        return False
    row, column, found = i // columns, i % columns, 0
    for k in range(len(offsets)):
        r, c = row + offsets[k, 0], column + offsets[k, 1]
        if 0 <= r < rows and 0 <= c < columns:
            found += _is_inlier(plane, r * columns + c, threshold2, table, free, state)
            if found >= min_samples:
                return True
    return False


@kernel('int64(float64[::1], int64, float64, float64[:, ::1], '
        'Tuple((boolean[:, ::1], int64[:, ::1], int64)), '
        'Tuple((uint8[:, ::1], boolean[:, ::1])), int64[::1], int64)')
def _grow(plane, seed, threshold2, table, near, states, cluster, start):
    """Write the cluster of a core cell to ``cluster`` from ``start``; return its end."""
    (free, offsets, _), (state, is_taken) = near, states
    rows, columns = free.shape
    cluster[start] = seed
    is_taken[seed // columns, seed % columns] = True
    head, tail = start, start + 1
    while head < tail:
        i = cluster[head]
        head += 1
        if not _is_core(plane, i, threshold2, table, near, state):
            continue
        row, column = i // columns, i % columns
        for k in range(len(offsets)):
            r, c = row + offsets[k, 0], column + offsets[k, 1]
            if (0 <= r < rows and 0 <= c < columns and not is_taken[r, c]
                    and _is_inlier(plane, r * columns + c, threshold2, table, free, state)):
                is_taken[r, c] = True
                cluster[tail] = r * columns + c
                tail += 1
    return tail
