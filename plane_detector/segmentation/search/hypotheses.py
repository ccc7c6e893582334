# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Hypotheses of the search: planes fitted to windows of cells that belong to no plane yet."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import MAX_JOINT_VARIANCES
from plane_detector.segmentation.cells.plane_fit import add_moments, fit_plane, squared_error

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
# Types of kernels' arguments. Cells: their table and their moments. Free cells: the index of the
# cell at each place of a grid with a margin, -1 where there is none that belongs to no plane; what
# follows are places in that grid.
CELLS = 'UniTuple(float64[:, ::1], 2)'
FREE = 'int32[::1]'


@kernel(f'float64[:, ::1](int64[::1], {FREE}, int64, {CELLS}, Tuple((int64, float64)))')
def draw_planes(left, free, stride, cells, draws):
    """Return the planes (h, 3) of windows that are flat, about some of the cells left."""
    (table, moments), (wanted, share) = cells, draws
    planes, total, n = np.empty((wanted * len(WINDOWS_CELLS), 3)), np.empty(10), 0
    for window in range(len(WINDOWS_CELLS)):
        height, width = WINDOWS_CELLS[window, 0], WINDOWS_CELLS[window, 1]
        for _ in range(wanted):
            share += GOLDEN_RATIO
            share -= int(share)
            corner, filled = left[int(share * len(left))] - height // 2 * stride - width // 2, 0
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
                        expected += table[free[p], 7]
            a, b, c = fit_plane(total)
            if squared_error(a, b, c, total) < MAX_JOINT_VARIANCES * expected:
                planes[n, 0], planes[n, 1], planes[n, 2] = a, b, c
                n += 1
    return planes[:n]
