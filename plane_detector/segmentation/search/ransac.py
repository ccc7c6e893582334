# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sequential RANSAC: hypotheses from windows of cells, all scored at once, the best one refined.

RANSAC (Fischler and Bolles 1981) with the truncated quadratic score of MSAC (Torr and Zisserman
2000) and local optimisation (Chum et al. 2003). The samples are windows of cells, not triples of
points: a window is on one plane far more often than three points are.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import RansacConfig
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.plane_fit import fit_plane, squared_error
from plane_detector.segmentation.search.dbscan import Neighbourhood
from plane_detector.segmentation.search.plane_growth import places, refine
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


class SequentialRansac:
    """
    Find planes among the cells one after the other, each time among the cells that are left.

    Parameters
    ----------
    cells : WeightedCells
    min_pixels : float
        Smallest plane.
    config : RansacConfig
    near : Neighbourhood
        Decides which inliers form one cluster.
    rng : numpy.random.Generator
        Draws the windows.
    start : PlaneRegions, optional
        Planes found before; default: none.

    """

    def __init__(self, cells: WeightedCells, min_pixels: float, config: RansacConfig,
                 near: Neighbourhood, rng: np.random.Generator,
                 start: PlaneRegions | None = None) -> None:
        self._cells, self._min_pixels, self._config = cells, min_pixels, config
        self._near, self._rng = near, rng
        self._labels = np.full(cells.is_planar.shape, -1, np.int32)
        self._planes = np.zeros((0, 3))
        if start is not None:
            self._labels, self._planes = start.labels.ravel().copy(), start.coefficients
        self._free = cells.is_planar & (self._labels < 0)
        self._drawn, self._is_exhausted = 0, False
        self._batch: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def find(self, most: int) -> PlaneRegions:
        """Return all planes found so far, at most ``most``; a later call continues the search."""
        while len(self._planes) < most and not self._is_exhausted:
            raise_if_stopped()
            if self._batch is None:
                self._batch = self._draw()
            before = len(self._planes)
            self._peel(most - before)
            if len(self._planes) < most:  # else the batch may hold more
                self._batch = None
                self._is_exhausted |= (len(self._planes) == self._before_batch
                                       or self._drawn >= self._config.max_iterations)
        labels = np.where(self._labels < most, self._labels, -1).reshape(self._cells.grid.shape)
        return PlaneRegions(labels, self._planes[:most])

    def _draw(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return new hypotheses (H, 3), their seed cells (H,) and their support (H,)."""
        cells, config = self._cells, self._config
        self._before_batch = len(self._planes)
        pixels = cells.grid.moments[self._free, 0].sum()
        if pixels < self._min_pixels:
            self._drawn = config.max_iterations
            return np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.float32)
        share = max(ROUND_PLANE_SHARE, self._min_pixels / max(pixels, 1))
        wanted = np.log1p(-config.confidence) / np.log1p(-min(share, 0.99))
        wanted = int(np.clip(np.ceil(wanted), 1, config.max_iterations))
        chance = self._rng.random((len(WINDOWS_CELLS), wanted))
        planes, seeds = _window_planes(self._free.reshape(cells.grid.shape), cells.grid.moments,
                                       cells.table, WINDOWS_CELLS, chance)
        self._drawn += max(len(planes), 1)
        gain = np.zeros(len(planes), np.float32)
        add_support(gain, planes, cells.table, cells.grid.moments,
                    np.flatnonzero(self._free), config.inlier_threshold**-2)
        return planes, seeds, gain

    def _peel(self, most: int) -> None:
        """Move the planes of the best hypotheses from the free cells to the result."""
        cells, config = self._cells, self._config
        limits = np.array([self._min_pixels, config.inlier_threshold**2, most,
                           len(self._planes)], float)
        found = _peel(self._batch, limits, (cells.table, cells.grid.moments),
                      self._free.reshape(cells.grid.shape), self._labels,
                      (self._near.offsets, self._near.min_samples))
        self._planes = np.vstack([self._planes, found])


@kernel('Tuple((float64[:, ::1], int64[::1]))'
        '(boolean[:, ::1], float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[:, ::1])')
def _window_planes(free, moments, table, windows, chance):
    """Return the planes (h, 3) of random windows that are flat, and their middle cells (h,)."""
    rows, columns = free.shape
    integral = np.zeros((rows + 1, columns + 1), np.int64)
    for i in range(rows):
        for j in range(columns):
            integral[i + 1, j + 1] = (integral[i, j + 1] + integral[i + 1, j] - integral[i, j]
                                      + free[i, j])
    planes, seeds = np.empty((chance.size, 3)), np.empty(chance.size, np.int64)
    starts, count = np.empty(rows * columns, np.int64), 0
    total = np.empty(10)
    for k in range(len(windows)):
        height, width, n = windows[k, 0], windows[k, 1], 0
        for i in range(rows - height + 1):
            for j in range(columns - width + 1):
                if (integral[i + height, j + width] - integral[i, j + width]
                        - integral[i + height, j] + integral[i, j]
                        >= WINDOW_MIN_FREE * height * width):
                    starts[n] = i * columns + j
                    n += 1
        for draw in range(min(n, chance.shape[1])):
            start = starts[int(chance[k, draw] * n) if n > chance.shape[1] else draw]
            total[:], expected = 0.0, 0.0
            for i in range(height):
                for j in range(width):
                    cell = start + i * columns + j
                    if free[cell // columns, cell % columns]:
                        total += moments[cell]
                        expected += table[cell, 7]
            a, b, c = fit_plane(total)
            if squared_error(a, b, c, total) < WINDOW_MAX_VARIANCES * expected:
                planes[count, 0], planes[count, 1], planes[count, 2] = a, b, c
                seeds[count] = start + height // 2 * columns + width // 2
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


@kernel('float64[:, ::1](Tuple((float64[:, ::1], int64[::1], float32[::1])), float64[::1], '
        'UniTuple(float64[:, ::1], 2), boolean[:, ::1], int32[::1], '
        'Tuple((int64[:, ::1], int64)))')
def _peel(batch, limits, sums, free, labels, near):
    """Label the planes of the best hypotheses, clear ``free`` there, return the planes (n, 3)."""
    (planes, seeds, gain), (table, moments) = batch, sums
    min_pixels, threshold2, most, first = limits
    found, count, failures = np.empty((int(most), 3)), 0, 0
    listed = places(free, near[0])
    while count < most and failures < MAX_FAILURES and len(gain):
        best = np.argmax(gain)
        if gain[best] < min_pixels / 2:
            break
        plane, members = refine(planes[best], seeds[best], threshold2, table, moments,
                                (free, near[0], near[1], listed))
        pixels = 0.0
        for i in members:
            pixels += moments[i, 0]
        if pixels < max(min_pixels, 1.0):
            gain[best] = 0
            failures += 1
            continue
        failures = 0
        for i in members:
            labels[i] = int(first) + count
            free[i // free.shape[1], i % free.shape[1]] = False
        listed = places(free, near[0])
        add_support(gain, planes, table, moments, members, -1 / threshold2)
        found[count] = plane
        count += 1
    if count < most:
        gain[:] = 0
    return found[:count]
