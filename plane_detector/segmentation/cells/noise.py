# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Noise of the disparity, estimated from differences between neighbouring cells.

Noise has four parts. The pixel noise is independent from pixel to pixel. So is the lateral noise,
which grows with the slope, because a pixel samples a neighbouring ray (Nguyen et al. 2012). The
smooth noise shifts and tilts whole cells. The systematic part bends whole planes. Second
differences of the means of cells in a row or column, and first differences of their slopes, are
zero on every plane. Edges and curved surfaces make them large, so a low quantile estimates the
noise (Donoho and Johnstone 1994 use the median for signals with few edges). One estimator serves
depth of any noise level, exact or not.

The systematic part differs from the smooth part in how the errors grow with distance. A blurred
field has one length scale: up to it the variance of differences grows with the square of the
distance, beyond it it does not grow. The errors of real sensors have no such scale: the variance
of their differences is about proportional to the distance over the whole image, as in a random
walk. Filters of drivers and phones leave errors that are smooth, wander over the image and have no
pixel noise. The residuals about a plane are smaller than the errors that bend it, because the
least-squares plane absorbs the longest waves.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from enum import Enum
from statistics import NormalDist

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import median, order_statistics
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage

# derived: the median of this many is accurate to 4 %.
MAX_SAMPLES = 1000
# Distance of the cells of a second difference: smooth noise is correlated in nearer cells.
# chosen: blur of a standard deviation of 12 px is uncorrelated four cells of 8 px apart.
LAG_CELLS = 4
# tuned: benchmark sensitivity of bb08c3e; flat to 1.4 times; at 0.7 times precision -0.017.
QUANTILE = 0.25
# Tangent of the angle between the ray and the normal: steeper cells straddle a step.
# tuned: eight NYU frames with 12 seeds, ABW, simulated sensors: flat from 3 to no bound, but for
# the recall of the NYU frames, -0.01 without.
MAX_STEEPNESS = 5.0
# chosen: sensors have 0.3 to 0.8 px (Nguyen et al. 2012); larger values are measured where no
# plane is steep.
MAX_LATERAL_PX = 1.0
# derived: the quantiles of a normal variable and of its modulus.
NORMAL_QUANTILE = NormalDist().inv_cdf(QUANTILE)
MODULUS_QUANTILE = NormalDist().inv_cdf((1 + QUANTILE) / 2)
# Disparity counts as quantised if it takes as many values as there are lines sampled in either
# direction, and these shares of the neighbours are equal and of the steps between values even. A
# wall seen from the front takes a few values only.
# tuned: walls and rooms rounded to .001 to .01 1/m, and exact, curved, millimetre and sensor depth
# that are not: flat from 3 to 4 lines, .07 to .4 and .6 to .7.
ROUNDING_LINES, MIN_EQUAL_SHARE, MIN_EVEN_SHARE = 4, 0.2, 0.6
# Depth this close to whole millimetres, in millimetres, is in millimetres.
# derived: float32 of 1/z at 100 m is as coarse.
WHOLE_MM = 0.02
# Lower bound of the error of depth that is finer than millimetres.
# chosen: the rounding error of the finest unit that drivers use, 0.05 mm.
FINE_FLOOR_M = 2.5e-5
# Noise specified for a network tilts cells by about this much per unit of image width.
# tuned: 14 real frames through FastDepth and rooms with rounded disparity, all the same from 0 to
# 1.4 times; walls with smooth bows, which no cell shows, are in pieces at 0.
SLOPE_PER_NOISE = 8.0
# ... and bends the surface inside a cell by this share of it.
# tuned: 14 real frames through FastDepth, SC with the planes of the sensor's depth; flat from 0.7
# to 1.4 times, -0.028 at 0.
GRAIN_PER_NOISE = 0.25
# Noise is local if this share of the cells has this many times the variance of the image's noise.
# tuned: 20 frames of today's sensors, NYU and ABW frames, simulated sensors: .20 with a dark
# carpet in time of flight, .23 to .63 in simulated ones, up to .36 on grazing floors, else at most
# .07. In all images SC of the frames of today's sensors -.002, NYU -.003, recall -.007.
LOCAL_RATIO, MIN_LOCAL_SHARE = 10.0, 0.12
# The roughness of smaller cells is that of 3 x 3 of them.
# chosen: of 3 x 3 pixels two pairs are compared, and the least of several such values is far below
# their mean; of 4 x 4 pixels it is six.
MIN_ROUGH_SIDE_PX = 4
# chosen: avoids division by 0; less than one cell of nine.
MIN_COUNT = 0.1
# Where neighbouring pixels share nearly all their error, their difference is rounding.
# tuned: 488 frames of sensors, real, simulated, rounded and of half the size: flat from .02 to
# .12; without it four of 46 with filtered depth change, one of them from SC .978 to .912.
MIN_OWN_SHARE = 0.12
# Cells with the same smooth noise where no region of the image is large enough to measure it.
# chosen: a cell and its eight neighbours.
CORRELATED_CELLS = 9.0


class DepthKind(Enum):
    """
    Kind of the depth errors; it decides which stages of the segmentation run.

    EXACT: the errors are below the noise floor. MEASURED: pixel noise and smooth noise, as of a
    sensor. NETWORK: the noise level is specified for the source, and the errors contain bends and
    steps, as those of networks do.
    """

    EXACT = 'exact'
    MEASURED = 'measured'
    NETWORK = 'network'


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the disparity."""

    # lower bound for the depth of a pixel: its rounding error
    depth_floor_m: float
    disparity_floor: float = 0.0  # lower bound for the disparity of a pixel, 1/m
    # noise stated for a network, 1/m; 0 if none. ``mean_sigma`` is at least this, because the
    # errors of a network are too smooth to be visible in any window
    source_sigma: float = 0.0
    mean_sigma: float = 0.0  # of the mean of a full cell about its plane, 1/m
    slope_sigma: float = 0.0  # of each component of a full cell's slope, 1/m per image width
    pixel_sigma: float = 0.0  # of a pixel about its cell's own plane, 1/m
    # ratio of the errors of a plane as a whole to those about its least-squares plane. The
    # deviations of means and slopes contain it
    bending: float = 1.0
    # of the position in the image that a pixel samples. Times the slope of the surface, it adds to
    # the error of a pixel
    lateral_px: float = 0.0
    # the share of its variance that neighbouring pixels have in common
    lateral_shared: float = 0.0
    # the share of a pixel's variance that its neighbour does not share; 0: the noise is not local
    own_share: float = 0.0
    # the disparity is 1/metres, so lengths and angles are meaningful
    is_metric: bool = True
    least_sigma: float = 0.0  # noise stated for a sensor, 1/m: ``mean_sigma`` is at least this

    @property
    def systematic_sigma(self) -> float:
        """The part of ``mean_sigma`` that bends whole planes, 1/m."""
        return self.mean_sigma * (1 - self.bending**-2) ** 0.5

    @property
    def density(self) -> float:
        """Variance of a cell times the number of cells that share its error, if not measured."""
        return CORRELATED_CELLS * self.mean_sigma**2

    def variance_floor(self, disparity: np.ndarray) -> np.ndarray:
        """Return the lower bound of the variance of pixels of this disparity."""
        return (self.depth_floor_m * disparity * disparity) ** 2 + self.disparity_floor**2

    def kind(self, disparity: float) -> DepthKind:
        """Return the kind of depth at this disparity."""
        if self.source_sigma > 0:
            return DepthKind.NETWORK
        is_exact = self.mean_sigma**2 < self.variance_floor(disparity)
        return DepthKind.EXACT if is_exact else DepthKind.MEASURED

    def with_smooth_part(self, mean_sigma: float, slope_sigma: float, **others: float) -> Noise:
        """Return the noise with these deviations, the first two at least those of the source."""
        least = max(self.source_sigma, self.least_sigma)
        return replace(self, mean_sigma=max(float(mean_sigma), least),
                       slope_sigma=max(float(slope_sigma), SLOPE_PER_NOISE * self.source_sigma),
                       **others)

    def with_bending(self, bending: float) -> Noise:
        """Return the noise of a sensor that bends planes; this noise does not include bending."""
        return self.with_smooth_part(bending * self.mean_sigma, bending * self.slope_sigma,
                                     bending=bending)

    def from_cells(self, deviations: tuple[float, float, float], sparsity: np.ndarray) -> Noise:
        """
        Return the noise from standard deviations of the means, slopes and pixels of cells.

        The noise of missing pixels, by the ``sparsity`` (n, 2) of these cells, is not part of it.
        """
        mean_sigma, slope_sigma, pixel_sigma = deviations
        pixel_sigma = max(pixel_sigma, GRAIN_PER_NOISE * self.source_sigma)
        if 2 * np.count_nonzero(sparsity[:, 0]) >= len(sparsity):  # else the median is 0
            mean_sigma, slope_sigma = (
                max(sigma**2 - pixel_sigma**2 * median(added), 0.0) ** 0.5
                for sigma, added in zip((mean_sigma, slope_sigma), sparsity.T, strict=True))
        return self.with_smooth_part(mean_sigma, slope_sigma, pixel_sigma=pixel_sigma)

    def rescaled(self, scale: float) -> Noise:
        """
        Return the noise of scale * disparity + shift, for any shift.

        The floor of the depth depends on the shift. It is far below the noise of any source whose
        shift is unknown, so only its size is converted to the new unit.
        """
        return Noise(self.depth_floor_m / scale, *(scale * sigma for sigma in (
            self.disparity_floor, self.source_sigma, self.mean_sigma, self.slope_sigma,
            self.pixel_sigma)), bending=self.bending, lateral_px=self.lateral_px,
            lateral_shared=self.lateral_shared, own_share=self.own_share,
            is_metric=self.is_metric, least_sigma=scale * self.least_sigma)

    def at_cell_size(self, size_px: int, smaller_px: int) -> Noise:
        """
        Return the noise of smaller cells.

        Pixel noise adds 1/n of its variance to the mean of n = s * s pixels, 12/n per s**2 to a
        slope.
        """
        added = 1 / smaller_px**2 - 1 / size_px**2
        mean_sigma = np.sqrt(self.mean_sigma**2 + self.pixel_sigma**2 * added)
        return self.with_smooth_part(mean_sigma, self.slope_sigma * (size_px / smaller_px) ** 2)


def estimate_noise(grid: CellGrid, noise_floor: Noise) -> Noise:
    """
    Estimate the noise of an image before any plane is known.

    The floors and the ``source_sigma`` of ``noise_floor`` bound the estimate from below.
    """
    lag = min(LAG_CELLS, (max(grid.shape) - 1) // 2)  # with few cells, the first and the last
    curvature, bend = _differences(grid.mean, grid.slope, grid.usable, grid.shape[1], lag)
    if not len(curvature) or not len(bend):
        return noise_floor.with_smooth_part(0.0, 0.0)
    # The variance of a - 2 b + c is 6 times that of each, that of a difference 2 times; the
    # quantile of chi-squared with 2 degrees of freedom is -2 log(1 - QUANTILE).
    mean_sigma = _quantile(curvature) / MODULUS_QUANTILE / 6**0.5
    slope_sigma = (_quantile(bend) / (-4 * np.log(1 - QUANTILE))) ** 0.5
    # Smooth noise changes by at most its slopes times the distance of the cells; a step does not.
    mean_sigma = min(mean_sigma, slope_sigma * 2 * lag * grid.size_px / grid.width_px)
    cells = sample_cells(grid.usable)
    pixel_sigma = _quantile(grid.residual_rms[cells]) / _rms_quantile(grid.size_px**2 - 3)
    sparsity = grid.sparsity.take(cells, 0)
    return noise_floor.from_cells((mean_sigma, slope_sigma, pixel_sigma), sparsity)


def with_lateral_noise(noise: Noise, grid: CellGrid, roughness: np.ndarray) -> Noise:
    """
    Return the noise with its lateral part, from the excess variation of steep cells.

    By comparing groups (Wald 1940). The steepest cells are those whose noise depends most on the
    slope, relative to a frontal cell, and whose neighbours have the same slope. A low quantile of
    the steep cells is used, because many straddle an edge. Neighbouring pixels along the contours
    of the slope differ by the noise that they do not share; curvature hardly matters there.
    """
    if noise.source_sigma > 0:
        return noise
    usable, columns = grid.usable.reshape(grid.shape), grid.shape[1]
    is_inner = np.zeros_like(usable)
    is_inner[1:-1, 1:-1] = (usable[1:-1, 1:-1] & usable[:-2, 1:-1] & usable[2:, 1:-1]
                            & usable[1:-1, :-2] & usable[1:-1, 2:])
    cells = sample_cells(is_inner)
    right, down = (grid.mean.take(cells + step, 0) - grid.mean.take(cells - step, 0)
                   for step in (1, columns))
    around2 = (right[:, 2] / right[:, 0]) ** 2 + (down[:, 2] / down[:, 1]) ** 2
    slope2 = grid.slope.take(cells, 0) ** 2
    square = np.minimum(slope2[:, 0] + slope2[:, 1], around2)
    is_seen = square < (MAX_STEEPNESS / grid.lens[0] * grid.mean[cells, 2]) ** 2
    cells, square = cells[is_seen], square[is_seen] / grid.width_px**2
    third, floor = len(cells) // 3, noise.variance_floor(grid.mean[cells, 2])
    if third == 0:
        return noise
    order = np.argpartition(square / (floor + max(noise.pixel_sigma**2, sys.float_info.min)),
                            (third, len(cells) - third))
    ends = np.concatenate([order[:third], order[-third:]])
    steep2 = np.maximum(square[order[-third:]], sys.float_info.min)

    def lateral2(variance: np.ndarray) -> float:
        """Return the variance of the place by that of the disparity of flat and steep cells."""
        excess = variance - floor[ends]
        return max(_quantile((excess[third:] - max(median(excess[:third]), 0.0)) / steep2), 0.0)

    whole = lateral2(grid.residual_rms[cells[ends]] ** 2)
    if whole == 0:
        return noise
    own = lateral2(roughness[cells[ends]])
    return replace(noise, lateral_px=min(whole**0.5, MAX_LATERAL_PX),
                   lateral_shared=1 - min(own / whole, 1.0))


def with_local_noise(noise: Noise, grid: CellGrid,
                     roughness: np.ndarray) -> tuple[Noise, CellGrid]:
    """
    Return the noise and the grid with the roughness of its cells, if the noise is local.

    Noise is a property of surfaces, so a low value among neighbouring cells is used: the pixels of
    an edge differ too.
    """
    usable = grid.usable
    cells = sample_cells(usable & (grid.residual_rms > 0))
    if noise.source_sigma > 0 or not len(cells):
        return noise, grid
    if grid.size_px < MIN_ROUGH_SIDE_PX:
        roughness = _mean_around(roughness, usable, grid.shape)
    share = min(median(roughness[cells] / grid.residual_rms[cells] ** 2), 1.0)
    least = share * LOCAL_RATIO * (noise.pixel_sigma**2 + noise.variance_floor(grid.mean[:, 2]))
    fewest = MIN_LOCAL_SHARE * np.count_nonzero(usable)
    if share < MIN_OWN_SHARE or np.count_nonzero(usable & (roughness > least)) < fewest:
        return noise, grid  # neighbours can only lower it
    around = least_around(roughness, usable, grid.shape[1])
    if np.count_nonzero(around > least) < fewest:
        return noise, grid
    return replace(noise, own_share=share), replace(grid, roughness=around)


def _mean_around(values: np.ndarray, usable: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the mean of the values (R * C,) of the usable ones of 3 x 3 cells."""
    total, count = (cv2.blur(part.reshape(shape).astype(float), (3, 3)).ravel()
                    for part in (values * usable, usable))
    return total / np.maximum(count, MIN_COUNT)


@kernel('float64[::1](float32[:, ::1], boolean[:, ::1], float64[:, ::1], int64, int64)')
def roughness_of(disparity, valid, slope, size, width_px):
    """
    Return half the mean squared difference of neighbouring pixels in each cell, (R * C,).

    Along the contours of its slope, in every other row: sensor noise is rough from pixel to pixel,
    clutter is smooth there, and edges hardly cross their own contour.
    """
    (height, width), half_square = disparity.shape, np.zeros(len(slope))
    columns = -(-width // size)
    sums = np.empty((4, columns * size), np.float32)  # squared differences and pairs, right, down
    for row in range(len(slope) // columns):
        sums[:] = 0
        for v in range(row * size, min(row * size + size, height) - 1, 2):
            _add_differences(disparity[v], disparity[v + 1], valid[v], valid[v + 1], sums)
        for column in range(columns):
            i, left = row * columns + column, column * size
            axis = 0 if abs(slope[i, 0]) <= abs(slope[i, 1]) else 1
            square = pairs = 0.0
            for u in range(left, left + size - 1 + axis):
                square += sums[2 * axis, u]
                pairs += sums[2 * axis + 1, u]
            of_slope = (slope[i, axis] / width_px) ** 2
            half_square[i] = max(square / max(pairs, 1.0) - of_slope, 0.0) / 2
    return half_square


@kernel('void(float32[::1], float32[::1], boolean[::1], boolean[::1], float32[:, ::1])')
def _add_differences(here, below, is_here, is_below, sums):
    """Add squared differences and numbers of pairs of a row with its right, then with the next."""
    right, right_pairs, down, down_pairs = sums[0], sums[1], sums[2], sums[3]
    for u in range(len(here) - 1):
        pair = np.float32(is_here[u] & is_here[u + 1])
        difference = (here[u + 1] - here[u]) * pair
        right[u] += difference * difference
        right_pairs[u] += pair
    for u in range(len(here)):
        pair = np.float32(is_here[u] & is_below[u])
        difference = (below[u] - here[u]) * pair
        down[u] += difference * difference
        down_pairs[u] += pair


@kernel('float64[::1](float64[::1], boolean[::1], int64)', is_short=True)
def least_around(values, usable, columns):
    """Return the third smallest value of each usable cell and its neighbours, or its own."""
    rows, least = len(values) // columns, np.zeros(len(values))
    for i in range(len(values)):
        if not usable[i]:
            continue
        one = two = three = np.inf
        row, column = i // columns, i % columns
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                k = r * columns + c
                if usable[k] and values[k] < three:
                    three = values[k]
                    if three < two:
                        two, three = three, two
                    if two < one:
                        one, two = two, one
        least[i] = min(three, values[i])
    return least


def sample_cells(is_wanted: np.ndarray) -> np.ndarray:
    """Return evenly spaced ones (n,) of the wanted cells, ``is_wanted`` (R * C,) bool."""
    wanted = np.flatnonzero(is_wanted)
    return wanted[::len(wanted) // MAX_SAMPLES + 1]


def _quantile(values: np.ndarray) -> float:
    return order_statistics(values, int(QUANTILE * (len(values) - 1)))[1]


def _rms_quantile(freedom: int) -> float:
    """Return QUANTILE of the rms about a fitted plane, over the deviation (Wilson-Hilferty)."""
    freedom = max(freedom, 1)
    spread = 2 / (9 * freedom)
    return ((1 - spread + NORMAL_QUANTILE * spread**0.5) ** 3 * freedom / (freedom + 3)) ** 0.5


@kernel('UniTuple(float64[::1], 2)(float64[:, ::1], float64[:, ::1], boolean[::1], int64, int64)')
def _differences(mean, slope, usable, columns, lag):
    """Return moduli of second differences of means, and squared differences of slopes."""
    rows, curved, bent, i = len(usable) // columns, 0, 0, 0
    curvatures, bends = np.empty(2 * len(usable)), np.empty(2 * len(usable))
    for row in range(rows):
        for column in range(columns):
            for step, left in ((lag, columns - column), (lag * columns, rows - row)):
                j, k = np.uint64(i + step), np.uint64(i + 2 * step)  # no wrap-around check
                if left > lag and usable[i] and usable[j]:
                    bends[bent] = (slope[j, 0] - slope[i, 0])**2 + (slope[j, 1] - slope[i, 1])**2
                    bent += 1
                    if left > 2 * lag and usable[k]:
                        curvatures[curved] = abs(mean[i, 2] - 2 * mean[j, 2] + mean[k, 2])
                        curved += 1
            i += 1
    return curvatures[:curved], bends[:bent]


def with_quantisation(noise_floor: Noise, image: DisparityImage) -> Noise:
    """
    Return the noise floor with the quantisation error of the disparity or of the depth.

    Stereo matching by whole pixels quantises disparity: a slanted wall is a staircase, and each
    step is an exact plane. Depth of 8 bit or in whole centimetres is quantised in even steps of
    depth.
    """
    # Whole rows and columns are sampled, so that no value of a slope is missed. Both must have
    # equal neighbours: along the columns of a vertical wall they are equal without quantisation.
    lines = []
    for rows in (image.values, image.values.T):
        line = rows[np.arange(1, ROUNDING_LINES + 1) * (len(rows) - 1) // (ROUNDING_LINES + 1)]
        is_equal = line[:, 1:] == line[:, :-1]
        if np.count_nonzero(is_equal) < max(MIN_EQUAL_SHARE * is_equal.size, 1):
            return noise_floor
        lines.append(line)
    values = np.unique(np.concatenate(lines, axis=None)).astype(float)
    values = values[values != 0]  # invalid pixels
    if len(values) < ROUNDING_LINES:
        return noise_floor
    # The quantisation error is uniform over one step.
    step = _even_step(values)
    if step / 2 >= 2 * noise_floor.variance_floor(median(values)) ** 0.5:
        return replace(noise_floor,
                       disparity_floor=max(noise_floor.disparity_floor, step / 12**0.5))
    return replace(noise_floor, depth_floor_m=max(noise_floor.depth_floor_m,
                                                  _even_step(1 / values[::-1]) / 12**0.5))


def with_fine_depth(noise_floor: Noise, image: DisparityImage, grid: CellGrid) -> Noise:
    """
    Return the noise floor of depth that is finer than whole millimetres, as its noise shows.

    Without noise the floor stays: exact depth of a simulator shows a surface of triangles. It also
    stays if the noise exceeds it, because it then hides nothing: SC of rooms in simulated time of
    flight .937 with the finer floor, .973 without; filtered depth, whose noise is in its cells and
    not in its pixels, has .80 of a floor in one plane with it, .99 without.
    """
    if not noise_floor.is_metric or noise_floor.source_sigma > 0:
        return noise_floor
    rows = image.values[np.arange(1, ROUNDING_LINES + 1) * (len(image.values) - 1)
                        // (ROUNDING_LINES + 1)]
    depth_m = 1 / np.unique(rows[rows > 0]).astype(float)[::-1]
    of_millimetre = 1000 * depth_m - np.rint(1000 * depth_m)
    if 2 * np.count_nonzero(abs(of_millimetre) > WHOLE_MM) < max(len(depth_m), 1):
        return noise_floor
    steps_m = np.diff(depth_m)
    step_m = float(steps_m[steps_m > FINE_FLOOR_M / 2].min(initial=np.inf))
    floor_m = max(FINE_FLOOR_M, step_m / 2)
    if floor_m >= noise_floor.depth_floor_m:
        return noise_floor
    finer = replace(noise_floor, depth_floor_m=floor_m)
    found, typical = estimate_noise(grid, finer), grid.typical_disparity
    is_hidden = max(found.pixel_sigma, found.mean_sigma) ** 2 < noise_floor.variance_floor(typical)
    is_noise = found.pixel_sigma**2 > finer.variance_floor(typical)
    return finer if is_hidden and is_noise else noise_floor


def _even_step(values: np.ndarray) -> float:
    """Return the step between sorted values, 0 if they are not evenly spaced."""
    gaps = np.diff(values)
    step = median(gaps)
    is_even = np.count_nonzero(np.abs(gaps - step) < 0.05 * step) >= MIN_EVEN_SHARE * len(gaps)
    return step if is_even else 0.0
