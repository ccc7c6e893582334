# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Scale and shift of a disparity from measured depth of the same camera, sparse or dense.

D = alpha / z + beta is fitted with the measured 1/z as the exact variable, because the network
causes the error. The initial value is the median of slopes over distant pairs of points (after
Theil, Sen and Siegel; robust against a quarter of wrong points), refined by least squares with
Tukey's weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plane_detector.geometry.disparity import valid_depth
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN

MIN_POINTS = 5
MAX_POINTS = 20_000
TUKEY_SIGMAS = 4.685
ITERATIONS = 10
# Errors of a depth map are correlated: more points than this do not add precision.
INDEPENDENT_POINTS = 300
# Without near and far points the scale is more uncertain than this.
MAX_SCALE_SIGMA_SHARE = 0.1
# Lower bound of the weighted squares of 1/z about their mean, to avoid division by 0.
MIN_SPREAD = 1e-30


@dataclass(frozen=True)
class DepthFit:
    """1/z = scale * D + shift, from measured depth."""

    scale: float  # NaN if refused
    shift: float
    covariance: np.ndarray  # (2, 2) float64, of scale and shift
    point_count: int  # that agree
    refusal: str  # why there is no result; empty if there is one


def fit_measured_depth(disparity: np.ndarray, sensor_depth_m: np.ndarray, *,
                       has_shift: bool = True) -> DepthFit:
    """
    Fit scale and shift to measured depth, robustly.

    Parameters
    ----------
    disparity : (H, W) floating
        Of unknown scale and shift; not finite where invalid.
    sensor_depth_m : (H, W) floating
        Metres; not finite or not positive where not measured.
    has_shift : bool
        False: the shift is known to be 0.

    Returns
    -------
    DepthFit
        Refused if the points are too few, all at one depth, or contradictory.

    """
    both = valid_depth(sensor_depth_m) & np.isfinite(disparity)
    index = np.flatnonzero(both)
    if len(index) < MIN_POINTS:
        return _refused(f'{len(index)} points of measured depth, {MIN_POINTS} are needed')
    index = index[::math.ceil(len(index) / MAX_POINTS)]
    inverse_m = 1.0 / sensor_depth_m.ravel()[index].astype(np.float64)
    values = disparity.ravel()[index].astype(np.float64)
    alpha, beta = (_median_line(inverse_m, values) if has_shift
                   else (float(np.median(values / inverse_m)), 0.0))
    for _ in range(ITERATIONS):
        weights, sigma = _tukey(values - alpha * inverse_m - beta)
        alpha, beta, covariance = _weighted_line(inverse_m, values, weights, sigma,
                                                 has_shift)
    agree = weights > 0.1
    covariance = covariance * max(agree.sum() / INDEPENDENT_POINTS, 1.0)
    if agree.sum() < max(MIN_POINTS, 0.5 * len(index)):
        return _refused('more than half of the measured depth disagrees with the network')
    if not np.sqrt(covariance[0, 0]) < MAX_SCALE_SIGMA_SHARE * alpha:
        return _refused('measured depth varies too little to separate scale and shift')
    jacobian = np.array([[-1.0, 0.0], [beta, -alpha]]) / alpha**2
    return DepthFit(1.0 / alpha, -beta / alpha, jacobian @ covariance @ jacobian.T,
                    int(agree.sum()), '')


def _refused(reason: str) -> DepthFit:
    return DepthFit(np.nan, np.nan, np.full((2, 2), np.nan), 0, reason)


def _median_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return slope and intercept by medians over pairs half the sorted order apart."""
    order = np.argsort(x, kind='stable')
    x, y = x[order], y[order]
    half = len(x) // 2
    run = x[half:] - x[:-half]
    apart = run > 0
    if not apart.any():
        return 0.0, float(np.median(y))
    slope = np.median((y[half:] - y[:-half])[apart] / run[apart])
    return float(slope), float(np.median(y - slope * x))


def _tukey(residual: np.ndarray) -> tuple[np.ndarray, float]:
    """Return Tukey's biweights and the standard deviation of the residuals."""
    sigma = SIGMA_PER_MEDIAN * float(np.median(np.abs(residual)))
    sigma = max(sigma, 1e-9 * float(np.abs(residual).max()), 1e-12)
    ratio = residual / (TUKEY_SIGMAS * sigma)
    return np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0), sigma


def _weighted_line(x: np.ndarray, y: np.ndarray, weights: np.ndarray,
                   sigma: float, has_shift: bool) -> tuple[float, float, np.ndarray]:
    """Return slope, intercept and their covariance by weighted least squares."""
    total = weights.sum()
    mean_x, mean_y = (weights @ x / total, weights @ y / total) if has_shift else (0.0, 0.0)
    # Points at one depth have no spread: the variance becomes large, and the fit is refused.
    spread = max(weights @ (x - mean_x) ** 2, MIN_SPREAD)
    alpha = weights @ ((x - mean_x) * (y - mean_y)) / spread
    of_alpha = np.outer([1.0, -mean_x], [1.0, -mean_x]) / spread
    covariance = sigma**2 * (of_alpha + np.diag([0.0, has_shift / total]))
    return float(alpha), float(mean_y - alpha * mean_x), covariance
