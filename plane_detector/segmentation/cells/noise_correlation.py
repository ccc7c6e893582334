# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Correlation of the errors of neighbouring cells, estimated from the image itself.

Smooth noise shifts whole neighbourhoods of cells. A test that treats cells as independent counts
the same error many times, and ignores how little the error changes between neighbouring cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.grid import solve_least_squares
from plane_detector.segmentation.cells.model import (
    LOCAL_RATIO,
    MEAN_X,
    MEAN_Y,
    PlaneRegions,
    WeightedCells,
    residual,
)
from plane_detector.segmentation.cells.noise import Noise

# The planes of smaller regions fit the noise itself, and their residuals are too small.
# tuned: on rooms and lived-in rooms below seed 9000; flat from 70 to 140.
MIN_REGION_CELLS = 100
# chosen: bounds of the share that is independent from cell to cell, and of the correlation of
# neighbouring cells.
MIN_SHARE = 0.01
# derived: 2 is a Gaussian; with a larger power it is not a covariance; sensors have about 1.
MIN_POWER, MAX_POWER = 0.5, 2.0
# The variance of the difference of two cells grows with a power of their distance. From 1 to 4
# cells blurred noise has 1.37 to 1.55, frames of Kinects, of an ABW scanner and of simulated
# sensors have 0.1 to 1.0; from 4 to 8 cells those of Kinects still have 0.36 to 1.3, stereo, whose
# errors have the length of its window, 0.1 to 0.45, noise blurred over less than a cell or two 0.
# tuned: eight NYU frames, two table tops and fifteen ABW images labelled by hand, simulated
# sensors, and rooms and lived-in rooms with blurred noise below seed 9000: flat from 1.4 to 1.5
# and from 2.5 to 3.5, largest 2.5 to 3: SC of the NYU frames .907 to .927; chosen on seven of
# them, the eighth has .931 in the mean. NYU -0.03 at 1.35; rooms of sensors -0.01 at 3.5.
SMOOTH_POWER, BENDING_PER_POWER, MAX_BENDING = 1.45, 2.5, 3.0
# The growth at which the systematic part begins to count, and that at which all of it counts.
# tuned: as above; flat from 0.2 to 0.3 and from 0.45 to 0.6; SC of lived-in rooms in simulated
# stereo -0.035 from 0 to 0.35, NYU frames -0.01 to 0.8.
MIN_GROWTH, FULL_GROWTH = 0.3, 0.6
# Depth that a driver or a phone has filtered is as smooth between near cells as blurred noise, but
# wanders over the image. Filtering has taken its grain, the noise of the pixels: it is .01 of what
# neighbouring cells differ by in simulated phones, .5 to .8 in frames of today's, and 3 to 7 in
# blurred noise. To the first of these shares its errors have a systematic part if they grow, from
# the second on none. They must grow about a quadric in each region, as bows do not.
# tuned: 16 rooms of filtered depth of benchmark labelled, walls, floors and rooms with noise
# blurred over 4 to 24 px, lived-in rooms with noise of .0001 to .001, frames of today's sensors:
# the same from .7 to 1.2 times; neighbours of blurred noise are 3 at the nearest
MIN_GRAIN, MAX_GRAIN = 1.5, 2.5
# From the first of these powers of the distance on, about planes from 2 to 8 cells, growth counts
# the less, from the second on not at all: it is what surfaces leave that are not yet apart. These
# have 1.76 to 1.92 in a workshop (stereo), by the draw; noise of 10 mm joined there what 3 mm keep
# apart. Filtered rooms have 1.1 to 1.7 in 62 of 64 draws, at most 1.81; phones .7 to 1.4.
# tuned: as above; of 64 filtered rooms those two gain .006 and .014 SC, the others are the same.
MIN_WANDERING, MAX_WANDERING = 1.65, 1.8
# It counts the less the rougher the noise is, up to this excess: then the walk of rough noise
# decides.
# tuned: 16 frames of today's sensors: a wall and a door are one at 1, in four of 20 draws of noise
# the noise of the phone is a third of that in the others at 0.
MAX_ROUGHNESS = 0.5
# The least error of whole planes, by which every sensor bends them: time of flight cameras have 3
# to 11 mm, in waves over their range and in corners, which planes in pieces do not show any more.
# tuned: rooms, lived-in rooms and curved scenes below seed 9000, flat from 0.004 to 0.006: SC in
# simulated time of flight +.026, +.002 and +.054; at 0.008 .05 more of curved pixels get labels.
LEAST_ERROR_M = 0.005
# Waves show between cells 2 and 8 apart: the difference of independent errors does not grow. From
# the first growth on they count, from the second on whole.
# tuned: boxes on a pallet in stereo blurred over 2 and 4 px have -.09 to .12, frames of today's
# sensors from .22, rooms in simulated time of flight from .49; a wall in time of flight without
# any growth (curved scene 0) is then in pieces.
WAVES_GROWTH = 0.1, 0.2
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
        residuals = _residuals(labels, planes, model.table, is_used)
        square, *at_lags = _covariances(labels, residuals).tolist()
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

    @property
    def of_bows(self) -> tuple[float, float, float, float, float, float]:
        """
        Return the bounds on bows of regions: a density, and the variogram (Matheron 1963).

        At a distance of h image widths that is t[1] + t[2] (1 - exp(-t[3] (t[5] h)**t[4])).
        """
        own, decay = self._near
        return (BOW_SHARE * self.density, own, self.smooth, decay, self.power,
                float(self.shape[1]))

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
    Return the ratio of the errors of whole planes to the residuals about them.

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
        1 if the errors are smooth over a fixed length, if they are stated for the source, or if no
        region is large enough; otherwise at least such that planes in metres have LEAST_ERROR_M.

    """
    own = (noise.pixel_sigma / model.grid.size_px) ** 2
    if noise.source_sigma > 0 or noise.mean_sigma**2 <= own:
        return 1.0
    smooth_sigma = (noise.mean_sigma**2 - own) ** 0.5
    labels = np.ascontiguousarray(regions.labels)
    is_used = in_large_regions(labels, len(regions.coefficients)) & model.is_planar
    residuals = _residuals(labels, regions.coefficients, model.table, is_used)

    def log_variance(lag: int) -> float:
        """Return that of the differences without the cells' own noise; NaN if it is all."""
        moduli = _differences(labels, residuals, lag)
        variance = (SIGMA_PER_MEDIAN * median(moduli)) ** 2 - 2 * own if len(moduli) else 0.0
        return math.log2(variance) if variance > 0 else math.nan

    at_one, at_two, at_four, at_eight = (log_variance(lag) for lag in (1, 2, 4, 8))
    power, growth = (at_four - at_one) / 2, at_eight - at_four
    if math.isnan(power + growth):
        return 1.0
    roughness = min(max(BENDING_PER_POWER * (SMOOTH_POWER - power), 0.0), MAX_BENDING - 1)
    excess = roughness * _share_between(growth, MIN_GROWTH, FULL_GROWTH)
    grain = noise.pixel_sigma / 2 ** ((at_one - 1) / 2)  # a difference has twice the variance
    filtered = 1 - _share_between(grain, MIN_GRAIN, MAX_GRAIN)
    filtered *= 1 - _share_between((at_eight - at_two) / 2, MIN_WANDERING, MAX_WANDERING)
    if filtered > 0 and roughness < MAX_ROUGHNESS:
        _remove_bows(labels, residuals, model.table, len(regions.coefficients))
        wandering = _share_between(log_variance(8) - log_variance(4), MIN_GROWTH, FULL_GROWTH)
        excess = max(excess, (MAX_BENDING - 1) * filtered * wandering
                     * (1 - roughness / MAX_ROUGHNESS))
    of_smooth = 1 + excess
    if noise.is_metric:
        least = LEAST_ERROR_M * model.grid.typical_disparity**2 / smooth_sigma
        least *= min(max(roughness, excess), 1.0)
        least *= _share_between(at_eight - at_two, *WAVES_GROWTH)
        of_smooth = max(of_smooth, min(math.hypot(1, least), MAX_BENDING))
    return (1 + (of_smooth**2 - 1) * (smooth_sigma / noise.mean_sigma) ** 2) ** 0.5


@kernel('float64[::1](int32[:, ::1], float64[:, ::1], float64[:, ::1], boolean[::1])',
        is_short=True)
def _residuals(labels, planes, table, is_used):
    """Return the residuals about the planes of their regions, NaN for unused cells."""
    residuals, label = np.full(labels.size, np.nan), labels.reshape(-1)
    for i in range(labels.size):
        if is_used[i]:
            k = label[i]
            residuals[i] = (residual(table, i, planes[k, 0], planes[k, 1], planes[k, 2])
                            * table[i, LOCAL_RATIO] ** -0.5)
    return residuals


@kernel('void(int32[:, ::1], float64[::1], float64[:, ::1], int64)', is_short=True)
def _remove_bows(labels, residuals, table, count):
    """Subtract from the residuals of each region the quadric that fits them."""
    products, label, quadric = np.zeros((count, 7, 7)), labels.reshape(-1), np.empty((count, 7))
    for i in range(labels.size):
        if not np.isnan(residuals[i]):
            k, x, y = label[i], table[i, MEAN_X], table[i, MEAN_Y]
            terms = 1.0, x, y, x * x, x * y, y * y, residuals[i]
            for row in range(7):
                for column in range(7):
                    products[k, row, column] += terms[row] * terms[column]
    for k in range(count):
        solve_least_squares(products[k], 6, quadric[k])
    for i in range(labels.size):
        if not np.isnan(residuals[i]):
            k, x, y = label[i], table[i, MEAN_X], table[i, MEAN_Y]
            terms = 1.0, x, y, x * x, x * y, y * y
            for row in range(6):
                residuals[i] -= quadric[k, row] * terms[row]


@kernel('float64[::1](int32[:, ::1], float64[::1], int64)', is_short=True)
def _differences(labels, residuals, lag):
    """Return moduli of the differences of residuals some cells apart in a region."""
    (rows, columns), count, moduli = labels.shape, 0, np.empty(2 * labels.size)
    for row in range(rows):
        for column in range(columns):
            here = residuals[row * columns + column]
            if np.isnan(here):
                continue
            for r, c in ((row - lag, column), (row, column - lag)):
                if r >= 0 and c >= 0 and labels[r, c] == labels[row, column]:
                    difference = here - residuals[r * columns + c]
                    if not np.isnan(difference):
                        moduli[count] = abs(difference)
                        count += 1
    return moduli[:count]


def _share_between(value: float, low: float, high: float) -> float:
    """Return where a value lies between two others, from 0 to 1; 0 for NaN."""
    return min(max(0.0, (value - low) / (high - low)), 1.0)


def _bounded(share: float) -> float:
    return min(max(share, MIN_SHARE), 1 - MIN_SHARE)


@kernel('float64[::1](int32[:, ::1], float64[::1])', is_short=True)
def _covariances(labels, residuals):
    """Return the mean product (3,) of residuals in a region 0, 1 and 2 cells apart."""
    (rows, columns), label = labels.shape, labels.reshape(-1)
    total, count = np.zeros(3), np.zeros(3)
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
