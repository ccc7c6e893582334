# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
How the errors of neighbouring cells go together, read off the picture itself.

Smooth noise moves whole neighbourhoods of cells alike. Whoever takes cells one by one counts the
same error many times where they agree, and misses how little may change from one to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise

# Smaller patches fit themselves to the noise.
MIN_PATCH_CELLS = 100
# Residuals are cut off at this many deviations.
MAX_RESIDUAL = 3.0
# What differs from cell to cell is at least this share of the variance, and at most all but it.
LEAST_SHARE = 1e-3
CORRELATION_RANGE = (0.02, 0.98)
POWER_RANGE = (0.5, 2.0)


@dataclass(frozen=True)
class Correlation:
    """
    Covariance of the errors of cells' means, a powered exponential (Diggle and Ribeiro 2007).

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


def residuals(model: CellModel, planes: np.ndarray, cell: np.ndarray, label: np.ndarray,
              limit: float) -> np.ndarray:
    """
    Return how far cells are off the planes of labels, 0 where that says nothing.

    Parameters
    ----------
    model : CellModel
    planes : (K, 3) float64
    cell, label : (...) int
        Broadcast against each other; label -1 is no plane.
    limit : float
        Cuts them off, per metre.

    """
    x, y, d = model.grid.mean.T[:, cell]
    a, b, c = np.append(planes, np.zeros((1, 3)), axis=0).T[:, label]
    residual = np.clip(d - (a * x + b * y + c), -limit, limit)
    return np.where(model.planar[cell] & (label >= 0), residual, 0)


def _covariances(model: CellModel, patches: Patches, limit: float) -> list[float]:
    """Return the mean product of the residuals of cells of a patch 0, 1 and 2 cells apart."""
    labels = patches.labels
    size = np.bincount(labels.ravel() + 1, minlength=len(patches.planes) + 1)
    size[0] = 0
    used = (size[labels + 1] > MIN_PATCH_CELLS) & model.planar.reshape(labels.shape)
    labels = np.where(used, labels, -1)
    residual = residuals(model, patches.planes, np.arange(labels.size), labels.ravel(), limit)
    return [_mean_product(residual.reshape(labels.shape), labels, lag) for lag in range(3)]


def _mean_product(residual: np.ndarray, labels: np.ndarray, lag: int) -> float:
    """Return it for cells (R, C) of one label that are so far apart in a row or column."""
    total = count = 0
    for first, second in ((np.s_[lag:], np.s_[:len(labels) - lag]),
                          (np.s_[:, lag:], np.s_[:, :labels.shape[1] - lag])):
        same = (labels[first] == labels[second]) & (labels[first] >= 0)
        total += (residual[first] * residual[second])[same].sum()
        count += np.count_nonzero(same)
    return total / max(count, 1)
