# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Hypotheses of the search: planes fitted to windows of free cells, and their support."""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.model import (
    MAX_JOINT_VARIANCES,
    MEAN_D,
    MEAN_WEIGHT,
    MEAN_X,
    MEAN_Y,
    SLOPE_WEIGHT,
    SLOPE_X,
    SLOPE_Y,
    SQUARED_ERROR,
)
from plane_detector.segmentation.cells.plane_fit import N, add_moments, fit_plane, squared_error

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


@kernel(f'Tuple((float64[:, ::1], float64))({FREE}, int64, {CELLS}, int64, float64, '
        'float64[:, ::1])')
def draw_planes(free, stride, cells, wanted, share, known):
    """
    Return the planes (h, 4) of windows that are flat, about some free cells, and the next share.

    The last column is what their support is multiplied by, 1. The known planes come first.

    The windows are at places of an even sequence over the image. They stay where they are when
    cells elsewhere become free or are taken, so that slight noise draws nearly the same planes.
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
    """Keep hypotheses with enough support: that of the others will only fall."""
    n = 0
    for h in range(len(gain)):
        for column in range(4):
            planes[n, column] = planes[h, column]
        gain[n] = gain[h]
        n += gain[h] >= least
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
