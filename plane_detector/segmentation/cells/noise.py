# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
How noisy the disparity is, estimated from differences between neighbouring cells.

Noise has a grainy part, different from pixel to pixel, and a smooth part that moves and tilts
whole cells. Second differences of the means of cells in a row or column, and first differences of
their slopes, are zero on every plane. Edges and curved surfaces make them large, so a low
quantile tells the noise (Donoho and Johnstone 1994 take the median for signals with few edges).
The same estimator serves depth of any noise, so that there is no gap between exact and noisy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage

# Cells between those of a second difference: smooth noise is alike in nearer ones.
# derived: blur of a standard deviation of 12 px is uncorrelated four cells of 8 px apart.
LAG_CELLS = 4
# tuned: benchmark sensitivity; flat to 1.4 times; at 0.7 times precision -0.017.
QUANTILE = 0.25
# derived: that quantile of the modulus of a normal deviate, and of chi-squared with 2 degrees.
NORMAL_QUANTILE, CHI_SQUARED_QUANTILE = 0.3186, 0.5754
# Cells that differ from their neighbours by less than this share of the noise: smoother noise is
# found from the planes.
MIN_STEP_SHARE = 0.2
# Rounded are disparities of few values, evenly spaced, that neighbours share.
ROUNDING_LINES = 4
MIN_VALUES, MAX_VALUES_SHARE, MIN_EVEN_SHARE, MIN_EQUAL_SHARE = 8, 0.3, 0.5, 0.2
# Known noise of a network tilts cells by about this much per unit of picture width.
SLOPE_PER_NOISE = 8.0
# ... and bends them within by this share of it.
GRAIN_PER_NOISE = 0.25
# Sums in float32 leave this much of the variance that the slope makes within a cell.
ROUNDING = 1e-6


class DepthKind(Enum):
    """
    What is known of the errors of depth: which stages of the segmentation serve it.

    EXACT: smaller than the floor; whatever is there can be seen. MEASURED: grain and smooth noise,
    as of a sensor. NETWORK: specified for its source; with bends and steps of their own, as those
    of networks and of rounded disparity.
    """

    EXACT = 'exact'
    MEASURED = 'measured'
    NETWORK = 'network'


@dataclass(frozen=True)
class Noise:
    """
    Standard deviations of the disparity.

    Attributes
    ----------
    depth_floor_m : float
        Of the depth of a pixel, at least; what 16-bit millimetres leave of an exact plane.
    disparity_floor : float
        Of the disparity of a pixel, at least, per metre.
    known : float
        What the source of the depth is known for, per metre; ``mean`` is at least this, since the
        errors of a network are smooth and hide from every window.
    mean : float
        Of a cell's mean about its plane, per metre.
    slope : float
        Of each component of a cell's slope, per metre and picture width.
    grain : float
        Of a pixel about its cell's own plane, per metre.

    """

    depth_floor_m: float
    disparity_floor: float = 0.0
    known: float = 0.0
    mean: float = 0.0
    slope: float = 0.0
    grain: float = 0.0

    def floor(self, disparity: np.ndarray) -> np.ndarray:
        """Return the variance that pixels of this disparity have at least."""
        return (self.depth_floor_m * disparity * disparity) ** 2 + self.disparity_floor**2

    def is_exact(self, disparity: float) -> bool:
        """Say whether at this disparity the smooth part is less than the floor."""
        return self.mean**2 < self.floor(disparity)

    def kind(self, disparity: float) -> DepthKind:
        """Return the kind of depth at this disparity."""
        if self.known > 0:
            return DepthKind.NETWORK
        return DepthKind.EXACT if self.is_exact(disparity) else DepthKind.MEASURED

    def with_smooth_part(self, mean: float, slope: float) -> Noise:
        """Return the noise with another smooth part, at least what is known."""
        return replace(self, mean=max(float(mean), self.known),
                       slope=max(float(slope), SLOPE_PER_NOISE * self.known))

    def rescaled(self, scale: float) -> Noise:
        """
        Return the noise of scale * disparity, with any shift.

        A shift would change the form of the floor of depth; that floor is far below the noise of
        any source whose shift is unknown, so only its size is brought to the new unit.
        """
        return Noise(self.depth_floor_m / scale, *(scale * sigma for sigma in (
            self.disparity_floor, self.known, self.mean, self.slope, self.grain)))

    def at_cell_size(self, size_px: int, smaller_px: int) -> Noise:
        """
        Return the noise of smaller cells.

        A mean takes part in the grain of n = s * s pixels with 1/n, a slope with 12/n per s.
        """
        added = 1 / smaller_px**2 - 1 / size_px**2
        mean = np.sqrt(self.mean**2 + self.grain**2 * added)
        return self.with_smooth_part(mean, self.slope * (size_px / smaller_px) ** 2)


@dataclass(frozen=True)
class CellVariances:
    """Variances (R * C,) of each cell's mean and slope and of its pixels, the floor included."""

    mean: np.ndarray
    slope: np.ndarray
    grain: np.ndarray


def estimate_noise(grid: CellGrid, least: Noise) -> Noise:
    """
    Estimate the noise of an image before any plane is known.

    Parameters
    ----------
    grid : CellGrid
    least : Noise
        Its floors and what is known bound the estimate from below.

    Returns
    -------
    Noise

    """
    inner = grid.inner_rms[grid.usable]
    step, bend = _neighbour_differences(grid)
    curvature = _second_differences(grid)
    if not len(curvature) or not len(bend):
        return least.with_smooth_part(least.mean, least.slope)
    # The variance of a - 2 b + c is 6 times that of each, that of a difference 2 times.
    mean, change = (np.quantile(values, QUANTILE) / NORMAL_QUANTILE / factor**0.5
                    for values, factor in ((curvature, 6), (step, 2)))
    slope = np.sqrt(np.quantile(bend, QUANTILE) / CHI_SQUARED_QUANTILE / 2)
    grain = np.quantile(inner, QUANTILE) / _inner_rms_quantile(grid.size_px**2 - 3)
    return replace(least, grain=max(float(grain), GRAIN_PER_NOISE * least.known)
                   ).with_smooth_part(min(mean, change / MIN_STEP_SHARE), slope)


def _inner_rms_quantile(freedom: int) -> float:
    """Return QUANTILE of the rms about a fitted plane, over the deviation (Wilson-Hilferty)."""
    freedom = max(freedom, 1)
    spread = 2 / (9 * freedom)
    return ((1 - spread - 0.6745 * spread**0.5) ** 3 * freedom / (freedom + 3)) ** 0.5


def _second_differences(grid: CellGrid) -> np.ndarray:
    """Return the moduli (n,) of second differences of means along rows and columns."""
    disparity, usable = (values.reshape(grid.shape)
                         for values in (grid.mean[:, 2], grid.usable))
    found = []
    for d, u in ((disparity, usable), (disparity.T, usable.T)):
        lag = min(LAG_CELLS, (d.shape[1] - 1) // 2)
        if lag < 1:
            continue
        near, middle, far = np.s_[:, :-2 * lag], np.s_[:, lag:-lag], np.s_[:, 2 * lag:]
        found.append(np.abs(d[near] - 2 * d[middle] + d[far])[u[near] & u[middle] & u[far]])
    return np.concatenate(found) if found else np.zeros(0)


def _neighbour_differences(grid: CellGrid) -> tuple[np.ndarray, np.ndarray]:
    """Return steps and squared bends, (n,) each, from cells to their neighbours."""
    mean, slope = grid.mean.reshape(*grid.shape, 3), grid.slope.reshape(*grid.shape, 2)
    usable = grid.usable.reshape(grid.shape)
    steps, bends = [], []
    for near, far in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        both = usable[near] & usable[far]
        gap, middle = (mean[far] - mean[near])[both], (slope[near] + slope[far])[both] / 2
        steps.append(np.abs(gap[:, 2] - (gap[:, :2] * middle).sum(axis=1)))
        bends.append(((slope[far] - slope[near])[both] ** 2).sum(axis=1))
    return np.concatenate(steps), np.concatenate(bends)


def with_quantisation(least: Noise, image: DisparityImage) -> Noise:
    """
    Return the noise with what rounded disparities leave, as matching by whole pixels gives them.

    A slanted wall is then a staircase, each step of it an exact plane. Depth in millimetres is
    rounded too, but its disparities are not evenly spaced, and the floor covers it.

    Parameters
    ----------
    least : Noise
    image : DisparityImage

    """
    disparity, valid = image.values, image.valid
    if min(disparity.shape) < 2:
        return least
    # Along whole lines no step of a slope is left out.
    rows, columns = (np.arange(1, ROUNDING_LINES + 1) * (side - 1) // (ROUNDING_LINES + 1)
                     for side in disparity.shape)
    lines = disparity[rows], disparity[:, columns].T
    # An upright wall is even along its columns too, but not along its rows.
    if any(np.mean(line[:, 1:] == line[:, :-1]) < MIN_EQUAL_SHARE for line in lines):
        return least
    sample = np.concatenate([lines[0][valid[rows]], lines[1][valid[:, columns].T]])
    values = np.unique(sample)
    if not MIN_VALUES <= len(values) < MAX_VALUES_SHARE * len(sample):
        return least
    gaps = np.diff(values.astype(float))
    step = float(np.median(gaps))
    floor = np.sqrt(least.floor(float(np.median(values))))
    if np.mean(np.abs(gaps - step) < 0.05 * step) < MIN_EVEN_SHARE or step / 2 < 2 * floor:
        return least
    # The error of rounding is uniform over one step.
    return replace(least, known=max(least.known, step / 2),
                   disparity_floor=max(least.disparity_floor, step / 12**0.5))


def cell_variances(grid: CellGrid, noise: Noise) -> CellVariances:
    """
    Return the variances that each cell's statistics are tested with.

    The noise floor of the depth is one of the disparity that falls with 1/z**2; over a cell of
    n = s * s pixels it tilts a least-squares plane by sqrt(12 / n) / s per pixel.
    """
    floor, (slope_x, slope_y) = noise.floor(grid.mean[:, 2]), grid.slope.T
    span = (grid.size_px / grid.width_px) ** 2 / 12 * (slope_x**2 + slope_y**2)
    tilt = 12 * (grid.width_px / grid.size_px**2) ** 2
    # Rounding is alike in neighbouring pixels: it tilts a cell as a whole.
    rounding = (noise.disparity_floor * grid.width_px / grid.size_px) ** 2
    return CellVariances(noise.mean**2 + floor, noise.slope**2 + floor * tilt + rounding,
                         noise.grain**2 + floor + ROUNDING * span)
