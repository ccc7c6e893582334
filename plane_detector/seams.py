# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether two patches that lie within the noise of each other are two planes all the same.

The smooth part of the noise moves whole patches, but it neither jumps nor bends sharply: from one
cell to the next it changes by far less than its standard deviation. Generalised least squares
(Aitken 1936) makes use of that. Given how the errors of cells go together, it tells how much
better the cells about a border are explained by two planes than by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.fits import least_squares
from plane_detector.noise import Noise
from plane_detector.ransac import CellModel, Patches

# How far from the smaller patch the cells of the larger one are looked at.
REACH_CELLS = 3
# More cells than these, the nearest to the border, only cost time.
MAX_CELLS = 300
# A patch of fewer is no evidence.
MIN_CELLS = 4
# Twice the gain in log-likelihood that blurred noise hardly ever gives, times its power, 2:
# rougher noise has more edges of its own.
MIN_GAIN_TIMES_POWER = 24.0
# A cell that the border cuts anywhere is off by this share of the step, squared, on average.
CUT_VARIANCE = 1 / 12
# Smaller patches fit themselves to the noise.
MIN_PATCH_CELLS = 100
# Residuals are cut off at this many deviations.
MAX_RESIDUAL = 3.0
# What differs from cell to cell is at least this share of the variance, and at most all but it.
LEAST_SHARE = 1e-3
CORRELATION_RANGE = (0.02, 0.98)
POWER_RANGE = (0.5, 2.0)
# Of a torus of cells that stands for the endless plane.
PERIOD = 32


@dataclass(frozen=True)
class Correlation:
    """
    How the errors of cells' means go together.

    They have a smooth part and one that is different from cell to cell. The power is 2 for noise
    that was blurred and about 1 for the rougher one of real sensors.

    Attributes
    ----------
    smooth, own : float
        Variances of these parts, per square metre.
    decay, power : float
        The smooth parts of cells r sides apart correlate by exp(-decay * r**power).

    """

    smooth: float
    own: float
    decay: float
    power: float

    @classmethod
    def of(cls, model: CellModel, patches: Patches, noise: Noise) -> Correlation | None:
        """
        Read it off the residuals of the largest patches.

        None where it tells nothing: on exact depth, on that of a network, whose errors have
        steps and creases of their own, and where no patch is large.
        """
        if noise.known > 0 or noise.is_exact(model.grid.typical_disparity):
            return None
        square, *at_lags = _covariances(model, patches, MAX_RESIDUAL * noise.mean)
        if square <= 0:
            return None
        own = square * np.clip((noise.grain / model.grid.size_px) ** 2 / square,
                               LEAST_SHARE, 1 - LEAST_SHARE)
        smooth = square - own
        decay, at_two = -np.log(np.clip(np.array(at_lags) / smooth, *CORRELATION_RANGE))
        power = np.clip(np.log2(at_two / decay), *POWER_RANGE)
        return cls(float(smooth), float(own), float(decay), float(power))

    def covariance(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return that of cells so many rows and columns apart, broadcast."""
        apart = np.hypot(rows, columns)
        return self.smooth * np.exp(-self.decay * apart**self.power) + self.own * (apart == 0)

    def matrix(self, model: CellModel, cell: np.ndarray) -> np.ndarray:
        """Return the covariance (n, n) of some cells (n,)."""
        rows, columns = (np.abs(at[:, None] - at) for at in np.divmod(cell, model.grid.shape[1]))
        table = self.covariance(np.arange(rows.max() + 1.0)[:, None],
                                np.arange(columns.max() + 1.0))
        matrix = table[rows, columns]
        # Where the floor of the noise rises, that of the depth, cells tell less.
        variance = model.variances.mean[cell]
        matrix[np.diag_indices(len(cell))] += variance - variance.min()
        return matrix

    def precision(self, reach: int) -> np.ndarray:
        """Return the inverse of the covariance as a filter (2 * reach + 1, 2 * reach + 1)."""
        apart = np.minimum(np.arange(PERIOD), PERIOD - np.arange(PERIOD))
        spectrum = np.fft.fft2(self.covariance(apart[:, None], apart)).real
        inverse = np.fft.fftshift(np.fft.ifft2(1 / np.maximum(spectrum, self.own)).real)
        middle = slice(PERIOD // 2 - reach, PERIOD // 2 + reach + 1)
        return np.ascontiguousarray(inverse[middle, middle])


def _covariances(model: CellModel, patches: Patches, limit: float) -> list[float]:
    """Return the mean product of the residuals of cells of a patch 0, 1 and 2 cells apart."""
    labels, (x, y, d) = patches.labels, model.grid.mean.T
    size = np.bincount(labels.ravel() + 1, minlength=len(patches.planes) + 1)
    size[0] = 0
    used = (size[labels + 1] > MIN_PATCH_CELLS) & model.planar.reshape(labels.shape)
    labels = np.where(used, labels, -1)
    a, b, c = np.append(patches.planes, np.zeros((1, 3)), axis=0)[labels.ravel()].T
    residual = np.clip(d - (a * x + b * y + c), -limit, limit).reshape(labels.shape)
    return [_mean_product(residual, labels, lag) for lag in range(3)]


def _mean_product(residual: np.ndarray, labels: np.ndarray, lag: int) -> float:
    """Return it for cells (R, C) of one label that are so far apart in a row or column."""
    total = count = 0
    for first, second in ((np.s_[lag:], np.s_[:len(labels) - lag]),
                          (np.s_[:, lag:], np.s_[:, :labels.shape[1] - lag])):
        same = (labels[first] == labels[second]) & (labels[first] >= 0)
        total += (residual[first] * residual[second])[same].sum()
        count += np.count_nonzero(same)
    return total / max(count, 1)


def are_two(model: CellModel, labels: np.ndarray, correlation: Correlation | None,
            first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """
    Say which pairs of patches a step or a crease along their border keeps apart.

    Parameters
    ----------
    model : CellModel
    labels : (R, C) int32
        Patch of each cell, -1 none.
    correlation : Correlation or None
        None: nothing is kept apart.
    first, second : (P,) int
        The pairs.

    Returns
    -------
    (P,) bool
        False where they do not touch.

    """
    if correlation is None:
        return np.zeros(len(first), bool)
    gain = [_gain(model, labels, correlation, i, j) for i, j in zip(first, second, strict=True)]
    return np.array(gain) > MIN_GAIN_TIMES_POWER / correlation.power


def _gain(model: CellModel, labels: np.ndarray, correlation: Correlation, first: int,
          second: int) -> float:
    """Return twice the gain in log-likelihood of two planes over one."""
    cell, small, cut = _cells_about(model, labels, first, second)
    if min(np.count_nonzero(small), np.count_nonzero(~small)) < MIN_CELLS:
        return 0.0
    x, y, d = (model.grid.mean[cell] - model.grid.mean[cell].mean(axis=0)).T
    plane = np.stack([np.ones_like(x), x, y], axis=1)
    basis = np.column_stack([plane, plane * small[:, None], d])
    solved = np.linalg.solve(correlation.matrix(model, cell),
                             np.hstack([basis, np.eye(len(cell))[:, cut]]))
    weighted, inverse = solved[:, :7], solved[cut, 7:]
    products = basis.T @ weighted
    (one,), _ = least_squares(products[None], 3)
    _, (two_planes,) = least_squares(products[None], 6)
    # Cells that the border cuts have the disparity of neither plane (Woodbury's identity).
    variance = CUT_VARIANCE * (plane[cut] @ two_planes[3:]) ** 2
    scaled = np.eye(len(cut)) + inverse * variance
    projected = weighted[cut]
    products -= projected.T @ (variance[:, None] * np.linalg.solve(scaled, projected))
    (two,), _ = least_squares(products[None], 6)
    return float(one - two - np.linalg.slogdet(scaled)[1])


def _cells_about(model: CellModel, labels: np.ndarray, first: int,
                 second: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return cells (n,), which are in the smaller patch (n,) bool, which are cut (m,) int."""
    sides = labels == first, labels == second
    small, large = sorted(sides, key=np.count_nonzero)
    image = small.view(np.uint8)
    reach = cv2.dilate(image, np.ones((2 * REACH_CELLS + 1,) * 2, np.uint8)).view(bool)
    cell = np.flatnonzero((small | large & reach).ravel() & model.planar)
    if len(cell) > MAX_CELLS:
        to_border = np.where(small, cv2.distanceTransform(image, cv2.DIST_C, 3),
                             cv2.distanceTransform(1 - image, cv2.DIST_C, 3)).ravel()[cell]
        cell = np.sort(cell[np.argsort(to_border, kind='stable')[:MAX_CELLS]])
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    at_border = (small & cv2.dilate(large.view(np.uint8), cross).view(bool)
                 | large & cv2.dilate(image, cross).view(bool)).ravel()[cell]
    return cell, small.ravel()[cell], np.flatnonzero(at_border)
