# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Correlation of the errors of neighbouring cells, estimated from the image itself.

Smooth noise shifts whole neighbourhoods of cells. A test that treats cells as independent counts
the same error many times, and misses how little the error changes from one cell to the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import Noise

# The planes of smaller regions fit the noise itself.
# tuned: on rooms below seed 9000; compiled in, so the range was not swept.
MIN_REGION_CELLS = 100
# Residuals are cut off at this many deviations.
# after: the usual three deviations of a normal distribution.
MAX_RESIDUAL = 3.0
# derived: bound of the share that is independent from cell to cell, and of the smooth share.
MIN_SHARE = 1e-3
# derived: bounds of the correlation of neighbouring cells.
CORRELATION_RANGE = (0.02, 0.98)
# derived: about 1, exponential, and 2, Gaussian.
POWER_RANGE = (0.5, 2.0)
# derived: errors correlated over a larger distance are a bend, not noise.
MAX_LAG_CELLS = 20


@dataclass(frozen=True)
class Correlation:
    """
    Covariance of the errors of cells' means, a powered exponential (Diggle and Ribeiro 2007).

    The errors have a smooth part and a part that is independent from cell to cell. The power is 2
    for blurred noise and about 1 for the rougher noise of real sensors.

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
    def of(cls, model: WeightedCells, regions: PlaneRegions, noise: Noise) -> Correlation | None:
        """
        Estimate the covariance from the residuals of the largest regions.

        None if no region is large enough.
        """
        square, *at_lags = _covariances(model, regions, MAX_RESIDUAL * noise.mean_sigma)
        if square <= 0:
            return None
        own = square * np.clip((noise.pixel_sigma / model.grid.size_px) ** 2 / square,
                               MIN_SHARE, 1 - MIN_SHARE)
        smooth = square - own
        decay, at_two = -np.log(np.clip(np.array(at_lags) / smooth, *CORRELATION_RANGE))
        power = np.clip(np.log2(at_two / decay), *POWER_RANGE)
        return cls(float(smooth), float(own), float(decay), float(power))

    def covariance(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the covariance of cells at these distances in rows and columns, broadcast."""
        apart = np.hypot(rows, columns)
        return self.smooth * np.exp(-self.decay * apart**self.power) + self.own * (apart == 0)

    @cached_property
    def density(self) -> float:
        """The variance of a cell times the number of cells that share their noise."""
        apart = np.arange(-MAX_LAG_CELLS, MAX_LAG_CELLS + 1.0)
        return float(self.covariance(apart[:, None], apart).sum())

    def table(self, shape: tuple[int, int]) -> np.ndarray:
        """Return the covariance of two cells by their distance in rows and columns, (R, C)."""
        return _table(self, shape)


@lru_cache(maxsize=4)
def _table(correlation: Correlation, shape: tuple[int, int]) -> np.ndarray:
    return correlation.covariance(np.arange(float(shape[0]))[:, None], np.arange(float(shape[1])))


def _covariances(model: WeightedCells, regions: PlaneRegions, limit: float) -> list[float]:
    """Return the mean product of the residuals of cells of a region 0, 1 and 2 cells apart."""
    labels, planes, table = regions.labels, regions.coefficients, model.table
    size = np.bincount(labels.ravel() + 1, minlength=len(planes) + 1)[1:]
    used = (np.append(size > MIN_REGION_CELLS, False)[labels]
            & model.is_planar.reshape(labels.shape))
    if not used.any():
        return [0.0, 0.0, 0.0]
    a, b, c = planes[labels].transpose(2, 0, 1)
    x, y, d = table[:, :3].T.reshape(3, *labels.shape)
    residual = np.clip(d - (a * x + b * y + c), -limit, limit)
    means = []
    for lag in range(3):
        total = count = 0
        for near, far in ((np.s_[:, :labels.shape[1] - lag], np.s_[:, lag:]),
                          (np.s_[:labels.shape[0] - lag], np.s_[lag:])):
            both = used[near] & used[far] & (labels[near] == labels[far])
            total += (residual[near] * residual[far])[both].sum()
            count += both.sum()
        means.append(float(total / max(count, 1)))
    return means
