# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Correlation of the errors of neighbouring cells, estimated from the image itself.

Smooth noise shifts whole neighbourhoods of cells. A test that treats cells as independent counts
the same error many times, and misses how little the error changes from one cell to the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, residual
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import XX, YY, N, X, Y

# The planes of smaller regions fit the noise itself, and their residuals are too small.
# tuned: on rooms and lived-in rooms below seed 9000; flat from 70 to 140.
MIN_REGION_CELLS = 100
# chosen: bounds of the share that is independent from cell to cell, and of the correlation of
# neighbouring cells.
MIN_SHARE = 0.01
# derived: 2 is a Gaussian, and with a larger power it is no covariance; sensors have about 1.
MIN_POWER, MAX_POWER = 0.5, 2.0
# The variance of the difference of two cells grows with a power of their distance. From 1 to 4
# cells blurred noise has 1.37 to 1.55, frames of Kinects, of an ABW scanner and of simulated
# sensors have 0.1 to 1.0; from 4 to 8 cells those of Kinects still have 0.36 to 1.3, stereo, whose
# errors have the length of its window, 0.1 to 0.45, noise blurred over less than a cell or two 0.
# tuned: eight NYU frames, two table tops and fifteen ABW images labelled by hand, simulated
# sensors, and rooms and lived-in rooms with blurred noise below seed 9000: flat from 1.4 to 1.5
# and from 2.5 to 3.5, largest 2.5 to 3: SC of the NYU frames .907 to .927; chosen on seven of
# them, the eighth has .931 in the mean. NYU -0.03 at 1.35; rooms of sensors -0.01 at 3.5.
ROUGHNESS_LAGS = 1, 4, 8, 12
SMOOTH_POWER, BENDING_PER_POWER, MAX_BENDING = 1.45, 2.5, 3.0
# The growth at which the systematic part begins to count, and that at which all of it counts.
# tuned: as above; flat from 0.2 to 0.3 and from 0.45 to 0.6; SC of lived-in rooms in simulated
# stereo -0.035 from 0 to 0.35, NYU frames -0.01 to 0.8.
MIN_GROWTH, FULL_GROWTH = 0.3, 0.6
# Depth that a driver or a phone has filtered is as smooth between near cells as blurred noise, but
# wanders over the image: its differences grow with a power of 1.2 of the distance from 4 to 8
# cells and of 1.0 from 8 to 12, those of blurred noise with .1 to .5, then -.5 to -.6. From the
# first of these powers on, in both, it has a systematic part, with the second all of it.
# chosen: between the two; the frame of a phone has SC .722 without, .965 with it.
# From the third on, in one of them, it is what surfaces that are bent or not yet apart leave in
# the largest planes: 1.7 in a workshop (stereo), where noise of 10 mm joined what 3 mm keep apart.
# tuned: 12 rooms of filtered depth of benchmark labelled: one is in pieces at 1.5, in one planes
# are joined at 1.7.
MIN_WANDERING, FULL_WANDERING, MAX_WANDERING = 0.6, 0.9, 1.6
# The least error of whole planes, by which every sensor bends them: time of flight cameras have 3
# to 11 mm, in waves over their range and in corners, which planes in pieces do not show any more.
# tuned: rooms, lived-in rooms and curved scenes below seed 9000, flat from 0.004 to 0.006: SC in
# simulated time of flight +.026, +.002 and +.054; at 0.008 .05 more of curved pixels get labels.
LEAST_ERROR_M = 0.005
# The share of the noise inside a region that a quadric takes for a curve, with three coefficients.
# tuned: curved scenes, rooms and lived-in rooms below seed 9000 in simulated sensors, flat from
# .05 to .1: in structured light .12 of the curved pixels have labels without, .07 with it. It
# changes nothing on 26 frames labelled by hand.
BEND_SHARE = 0.08
# A bow of the whole image is hidden from the density, which is of the residuals.
# tuned: as above; walls alone: without it one of twelve seen by stereo is curved; flat to 2.5.
BOW_SHARE = 1.5


@dataclass(frozen=True)
class Correlation:
    """
    Covariance of the errors of cells' means, a powered exponential (Diggle and Ribeiro 2007).

    The errors have a smooth part and a part that is independent from cell to cell. The power is 2
    for blurred noise and about 1 for the rougher noise of real sensors.
    """

    # variances of these parts, per square metre
    smooth: float
    own: float
    # the smooth parts of cells r sides apart correlate by exp(-decay * r**power)
    decay: float
    power: float
    shape: tuple[int, int]  # rows and columns of cells
    bending: float = 1.0  # of the noise; the variances contain it

    @classmethod
    def of(cls, model: WeightedCells, regions: PlaneRegions, noise: Noise) -> Correlation | None:
        """
        Estimate the covariance from the residuals of the largest regions.

        The systematic part of the noise, which these do not show, enlarges it. None if no region
        is large enough, or if no pixel noise hides the steps of quantised disparity.
        """
        labels, planes = np.ascontiguousarray(regions.labels), regions.coefficients
        is_used = in_large_regions(labels, len(planes)) & model.is_planar
        square, *at_lags = _covariances(labels, planes, model.table, is_used).tolist()
        if square <= 0 or noise.pixel_sigma < noise.disparity_floor:
            return None
        own = square * _bounded((noise.pixel_sigma / model.grid.size_px) ** 2 / square)
        smooth = square - own
        decay, at_two = (-math.log(_bounded(at_lag / smooth)) for at_lag in at_lags)
        power = min(max(math.log2(at_two / decay), MIN_POWER), MAX_POWER)
        unseen = noise.bending**2
        return cls(smooth * unseen, own * unseen, decay, power, model.grid.shape,
                   noise.bending)

    @cached_property
    def table(self) -> np.ndarray:
        """The covariance of two cells by their distance in rows and columns, (R, C)."""
        return self._by_distance(self.own, self.decay)

    @cached_property
    def of_neighbours(self) -> np.ndarray:
        """The covariance (R, C) of cells near each other, whose differences the residuals show."""
        return self._by_distance(*self._near)

    @property
    def _near(self) -> tuple[float, float]:
        """
        The variance of the own part and the decay of cells near each other.

        The systematic part of the noise enlarges the variance of their differences less than the
        variance, by its ratio instead of the square of it: it bends planes slowly.
        """
        # chosen: the residuals show the differences as they are, but some bends have edges.
        # tuned: eight NYU frames labelled by hand, and rooms and lived-in rooms below seed 9000 in
        # simulated sensors. With the square lived-in rooms in structured light and time of flight
        # lose .01 SC; with the differences as shown the fronts of cupboards of NYU are in pieces.
        return self.own / self.bending**2, self.decay / self.bending

    @cached_property
    def _powers(self) -> np.ndarray:
        """The power of the distance of cells by rows and columns (R, C), dearer than the rest."""
        square = np.add.outer(*(np.arange(float(side)) ** 2 for side in self.shape))
        return square ** (self.power / 2)

    def _by_distance(self, own: float, decay: float) -> np.ndarray:
        table = self._powers * -decay
        np.exp(table, out=table)
        table *= self.smooth
        table[0, 0] += own
        return table

    @cached_property
    def density(self) -> float:
        """The variance of a cell times the number of cells that share their noise."""
        table = self.table
        return float(4 * table.sum() - 2 * (table[0].sum() + table[:, 0].sum()) + table[0, 0])

    def density_within(self, sums: np.ndarray) -> np.ndarray:
        """
        Return the density (K,) with a bow, but no more than bends regions of their size by itself.

        Half across a region the noise has changed by its variogram (Matheron 1963); a quadric fits
        a share of that. ``sums`` (K, 28) are those of the region graph.
        """
        cells = np.maximum(sums[:, N], 1)
        spread = (sums[:, XX] + sums[:, YY] - (sums[:, X] ** 2 + sums[:, Y] ** 2) / cells) / cells
        # The variance along the side of a square is a twelfth of its square; x is in image widths.
        half_side = (1.5 * np.maximum(spread, 0)) ** 0.5 * self.shape[1]
        own, decay = self._near
        variogram = own - self.smooth * np.expm1(-decay * half_side**self.power)
        return np.minimum(BOW_SHARE * self.density, BEND_SHARE * cells * variogram)

    @property
    def correlated_cells(self) -> float:
        """The number of cells with the same smooth error: the integral of its correlation."""
        return (self.density - self.own) / self.smooth


@kernel('boolean[::1](int32[:, ::1], int64)', is_short=True)
def in_large_regions(labels, count):
    """Return which cells (R * C,) are in regions large enough to show their noise."""
    sizes, label = np.zeros(count + 1, np.int64), labels.reshape(-1)
    is_large = np.empty(len(label), np.bool_)
    for k in label:
        sizes[k] += 1  # the last are those of no region
    sizes[count] = 0
    for i in range(len(label)):
        is_large[i] = sizes[label[i]] > MIN_REGION_CELLS
    return is_large


def bending_of(model: WeightedCells, regions: PlaneRegions, noise: Noise) -> float:
    """
    Return how many times larger the errors of whole planes are than those about them.

    Parameters
    ----------
    model : WeightedCells
    regions : PlaneRegions
        The largest planes.
    noise : Noise
        Without a systematic part.

    Returns
    -------
    float
        1 if the errors are smooth over a fixed length, if they are stated for the source, or if
        no region is large enough; else it gives planes in metres LEAST_ERROR_M at least.

    """
    own = (noise.pixel_sigma / model.grid.size_px) ** 2
    if noise.source_sigma > 0 or noise.mean_sigma**2 <= own:
        return 1.0
    smooth_sigma = (noise.mean_sigma**2 - own) ** 0.5
    labels = np.ascontiguousarray(regions.labels)
    is_used = in_large_regions(labels, len(regions.coefficients)) & model.is_planar

    def log_variance(lag: int) -> float:
        """Return that of the differences without the cells' own noise; NaN if it is all."""
        moduli = _differences(labels, regions.coefficients, model.table, is_used, lag)
        variance = (SIGMA_PER_MEDIAN * median(moduli)) ** 2 - 2 * own if len(moduli) else 0.0
        return math.log2(variance) if variance > 0 else math.nan

    near, middle, far, farthest = ROUGHNESS_LAGS
    at_middle, at_far = log_variance(middle), log_variance(far)
    power = (at_middle - log_variance(near)) / math.log2(middle / near)
    growth = (at_far - at_middle) / math.log2(far / middle)
    excess, limits = BENDING_PER_POWER * (SMOOTH_POWER - power), (MIN_GROWTH, FULL_GROWTH)
    if power >= SMOOTH_POWER:
        beyond = (log_variance(farthest) - at_far) / math.log2(farthest / far)
        growth = min(growth, beyond) if max(growth, beyond) < MAX_WANDERING else 0.0
        excess, limits = MAX_BENDING - 1, (MIN_WANDERING, FULL_WANDERING)
    if math.isnan(power + growth) or (power >= SMOOTH_POWER and growth < limits[0]):
        return 1.0
    excess = min(excess, MAX_BENDING - 1)
    share = min(max((growth - limits[0]) / (limits[1] - limits[0]), 0.0), 1.0)
    of_smooth = 1 + excess * share
    if noise.is_metric:
        least = LEAST_ERROR_M * model.grid.typical_disparity**2 / smooth_sigma
        of_smooth = max(of_smooth, min(math.hypot(1, least * min(excess, 1.0)), MAX_BENDING))
    return (1 + (of_smooth**2 - 1) * (smooth_sigma / noise.mean_sigma) ** 2) ** 0.5


@kernel('float64[::1](int32[:, ::1], float64[:, ::1], float64[:, ::1], boolean[::1], int64)',
        is_short=True)
def _differences(labels, planes, table, is_used, lag):
    """Return moduli of the differences of residuals of cells of a region some cells apart."""
    (rows, columns), count = labels.shape, 0
    moduli, residuals = np.empty(2 * labels.size), np.full(labels.size, np.nan)
    for row in range(rows):
        for column in range(columns):
            i, label = row * columns + column, labels[row, column]
            if not is_used[i]:
                continue
            residuals[i] = residual(table, i, planes[label, 0], planes[label, 1],
                                    planes[label, 2])
            for r, c in ((row - lag, column), (row, column - lag)):
                if r >= 0 and c >= 0 and labels[r, c] == label:
                    difference = residuals[i] - residuals[r * columns + c]
                    if not np.isnan(difference):
                        moduli[count] = abs(difference)
                        count += 1
    return moduli[:count]


def _bounded(share: float) -> float:
    return min(max(share, MIN_SHARE), 1 - MIN_SHARE)


@kernel('float64[::1](int32[:, ::1], float64[:, ::1], float64[:, ::1], boolean[::1])',
        is_short=True)
def _covariances(labels, planes, table, is_used):
    """Return the mean product (3,) of residuals in a region 0, 1 and 2 cells apart."""
    (rows, columns), residuals = labels.shape, np.full(labels.size, np.nan)
    total, count, label = np.zeros(3), np.zeros(3), labels.reshape(-1)
    for i in range(labels.size):
        if is_used[i]:
            k = label[i]
            residuals[i] = residual(table, i, planes[k, 0], planes[k, 1], planes[k, 2])
    for row in range(rows):
        for column in range(columns):
            i = row * columns + column
            for lag in range(3):
                for step, left in ((lag * columns, rows - row), (lag, columns - column)):
                    if left > lag and label[i + step] == label[i]:
                        product = residuals[i + step] * residuals[i]
                        if not np.isnan(product):
                            total[lag] += product
                            count[lag] += 1
    for lag in range(3):
        total[lag] /= max(count[lag], 1.0)
    return total
