# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
How noisy the disparity is, read off the picture itself.

Noise has a grainy part, different from pixel to pixel, and a smooth part that moves whole cells
and tilts them. Each is measured where it matters: the grain within a cell, the smooth part on the
means and slopes of cells about the plane of a larger window. Most windows of a scene made of
planes lie on one plane, so a low quantile over all windows is noise and not structure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.grid import CellGrid

WINDOW_CELLS = 9
WINDOW_QUANTILE = 0.15
# Cells without depth may be as many.
WINDOW_MIN_SHARE = 0.4
# Rounded are disparities of few values, evenly spaced, that neighbours share.
ROUNDING_LINES = 4
MIN_VALUES, MAX_VALUES_SHARE, MIN_EVEN_SHARE, MIN_EQUAL_SHARE = 8, 0.3, 0.5, 0.2
# Known noise of a network tilts cells by about this much per unit of picture width.
SLOPE_PER_NOISE = 8.0
# ... and bends them within by this share of it.
GRAIN_PER_NOISE = 0.25
# Sums in float32 leave this much of the variance that the slope makes within a cell.
ROUNDING = 1e-6


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

    def for_smaller_cells(self, size_px: int, smaller_px: int) -> Noise:
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
    Estimate the noise of a picture.

    Parameters
    ----------
    grid : CellGrid
    least : Noise
        Its floors and what is known bound the estimate from below.

    Returns
    -------
    Noise

    """
    windows = _window_statistics(grid)
    mean, slope, grain = (
        np.quantile(windows, WINDOW_QUANTILE, axis=0) if len(windows) else np.zeros(3))
    grain = max(float(grain), GRAIN_PER_NOISE * least.known)
    return replace(least, grain=grain).with_smooth_part(mean, slope)


def with_rounding(least: Noise, disparity: np.ndarray, valid: np.ndarray) -> Noise:
    """
    Return the noise with what rounded disparities leave, as matching by whole pixels gives them.

    A slanted wall is then a staircase, each step of it an exact plane. Depth in millimetres is
    rounded too, but its disparities are not evenly spaced, and the floor covers it.

    Parameters
    ----------
    least : Noise
    disparity : (H, W) float32
    valid : (H, W) bool

    """
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
    return replace(least, known=max(least.known, step / 2))


def _window_statistics(grid: CellGrid) -> np.ndarray:
    """Return the rms of means, slopes and pixels in each window of enough cells, (n, 3)."""
    usable = grid.usable[:, None].astype(float)
    slope_square = (grid.slope**2).sum(axis=1, keepdims=True)
    values = np.hstack([grid.mean_moments, grid.slope, slope_square,
                        grid.inner_rms[:, None] ** 2]) * usable
    side = min(WINDOW_CELLS, *grid.shape)
    rows, columns = grid.shape[0] // side, grid.shape[1] // side
    tiles = values.reshape(*grid.shape, -1)[:rows * side, :columns * side]
    sums = tiles.reshape(rows, side, columns * side, -1).sum(axis=1)
    sums = sums.reshape(rows, columns, side, -1).sum(axis=2).reshape(rows * columns, -1)
    sums = sums[sums[:, cells.N] > max(WINDOW_MIN_SHARE * side**2, 3)]
    planes, count = cells.fit_planes(sums), sums[:, cells.N]
    mean = cells.squared_error(planes, sums) / (count - 3)
    slope = (sums[:, 12] - 2 * (planes[:, :2] * sums[:, 10:12]).sum(axis=1)
             + count * (planes[:, :2] ** 2).sum(axis=1)) / (2 * count)
    statistics = np.stack([mean, slope, sums[:, 13] / count], axis=1)
    return np.sqrt(np.maximum(statistics[np.isfinite(mean)], 0))


def cell_variances(grid: CellGrid, noise: Noise) -> CellVariances:
    """
    Return the variances that each cell's statistics are tested with.

    The noise floor of the depth is one of the disparity that falls with 1/z**2; over a cell of
    n = s * s pixels it tilts a least-squares plane by sqrt(12 / n) / s per pixel.
    """
    floor, (slope_x, slope_y) = noise.floor(grid.mean[:, 2]), grid.slope.T
    span = (grid.size_px / grid.width_px) ** 2 / 12 * (slope_x**2 + slope_y**2)
    tilt = 12 * (grid.width_px / grid.size_px**2) ** 2
    return CellVariances(noise.mean**2 + floor, noise.slope**2 + floor * tilt,
                         noise.grain**2 + floor + ROUNDING * span)
