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


@kernel('Tuple((float64[::1], int64[::1]))'
        '(float64[::1], int64, float64, float64[:, ::1], float64[:, ::1], '
        'Tuple((boolean[:, ::1], int64[:, ::1], int64, int64[:, ::1])))')
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
    near : (R, C) bool, (m, 2) int64, int, (n, 2) int64
        Free cells, the neighbourhood of a core cell, and :func:`places` of the free cells.

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
        'Tuple((boolean[:, ::1], int64[:, ::1], int64, int64[:, ::1])))')
def _cluster_of(plane, members, threshold2, table, near):
    """
    Return the cells of the density cluster of inliers that holds most members.

    If no member is in a cluster, the largest cluster is returned.
    """
    free, offsets, min_samples, listed = near
    reach = _reach(offsets)
    columns, stride = free.shape[1], free.shape[1] + 2 * reach
    # Per cell, with a margin: 0 outlier, 1 inlier, then the cluster.
    marks = np.zeros((free.shape[0] + 2 * reach) * stride, np.int32)
    for n in range(len(listed)):
        marks[listed[n, 1]] = chi_squared(table, listed[n, 0], plane[0], plane[1],
                                          plane[2]) < threshold2
    if len(offsets) > 0:
        is_member, starts = np.zeros(len(marks), np.bool_), np.empty(len(members), np.int64)
        for k, i in enumerate(members):
            starts[k] = (i // columns + reach) * stride + i % columns + reach
            is_member[starts[k]] = True
        step = offsets[:, 0] * stride + offsets[:, 1]
        best = _best_cluster(marks, starts, is_member, step, min_samples)
        if best == 0:
            is_member[:] = True
            best = _best_cluster(marks, listed[:, 1].copy(), is_member, step, min_samples)
    else:
        best = 1
    found, n = np.empty(len(listed), np.int64), 0
    for k in range(len(listed) if best > 0 else 0):
        if marks[listed[k, 1]] == best:
            found[n] = listed[k, 0]
            n += 1
    return found[:n].copy()


@kernel('int64(int64[:, ::1])')
def _reach(offsets):
    """Return how far a neighbourhood reaches in rows or columns."""
    reach = 0
    for k in range(len(offsets)):
        reach = max(reach, abs(offsets[k, 0]), abs(offsets[k, 1]))
    return reach


@kernel('int64[:, ::1](boolean[:, ::1], int64[:, ::1])')
def places(free, offsets):
    """Return the free cells (n, 2) and their places in an array with a margin for the offsets."""
    reach, (rows, columns) = _reach(offsets), free.shape
    found, n = np.empty((free.size, 2), np.int64), 0
    for row in range(rows):
        for column in range(columns):
            if free[row, column]:
                found[n, 0] = row * columns + column
                found[n, 1] = (row + reach) * (columns + 2 * reach) + column + reach
                n += 1
    return found[:n].copy()


@kernel('int32(int32[::1], int64[::1], boolean[::1], int64[::1], int64)')
def _best_cluster(marks, starts, is_member, step, min_samples):
    """Mark the clusters around the starts; return the one with most members, 0 for none."""
    queue = np.empty(len(marks), np.int64)
    best, most, cluster = 0, 0, 1
    for start in starts:
        if marks[start] != 1 or not _is_core(marks, start, step, min_samples):
            continue
        cluster += 1
        queue[0], marks[start] = start, cluster
        head, tail, size = 0, 1, 0
        while head < tail:
            i = queue[head]
            head += 1
            size += is_member[i]
            if not _is_core(marks, i, step, min_samples):
                continue
            for k in range(len(step)):
                if marks[i + step[k]] == 1:
                    marks[i + step[k]] = cluster
                    queue[tail] = i + step[k]
                    tail += 1
        if size > most:
            best, most = cluster, size
        if 2 * most >= len(starts):  # no other can have more
            break
    return best


@kernel('boolean(int32[::1], int64, int64[::1], int64)')
def _is_core(marks, i, step, min_samples):
    """Say whether enough inliers are in the neighbourhood of inlier i."""
    found = 0
    for k in range(len(step)):
        found += marks[i + step[k]] > 0
        if found >= min_samples:
            return True
    return False
