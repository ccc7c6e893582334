# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Depth, disparity, and their valid values.

Disparity is any value affine in 1/z: 1/z itself in 1/metres, or the output of a network in its own
unit. Invalid values are NaN in both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import quantiles

# chosen: nearer than any camera measures; the inverse of smaller depths exceeds the precision of
# float32 for the rest of the image.
MIN_DEPTH_M = 1e-3
# Quantiles between which the range is measured, so that outliers do not widen it; the median.
_RANGE_QUANTILES = (0.02, 0.5, 0.98)
# chosen: below the values of rooms and streets, 0.5 to 2.7 times their median disparity, so that
# it only applies if one surface fills the image.
_MIN_RANGE_OF_LEVEL = 0.25
DEPTHS = ('metric_depth', 'relative_depth')
"""Kinds of a prediction that are depth; the others are disparity."""
UNITLESS = ('relative_disparity', 'relative_depth')
"""Kinds of a prediction in an unknown unit."""
_SMALLEST, _LARGEST = (float(value) for value in (np.finfo(np.float32).tiny,
                                                   np.finfo(np.float32).max))


def valid_depth(depth_m: np.ndarray) -> np.ndarray:
    """
    Return where depth is valid: finite and at least 1 mm.

    Examples
    --------
    >>> valid_depth(np.array([2.0, 0.0, -1.0, np.inf, np.nan]))
    array([ True, False, False, False, False])

    """
    return (depth_m >= MIN_DEPTH_M) & (depth_m < np.inf)


def limited_depth(depth_m: np.ndarray, max_depth_m: float = np.inf) -> np.ndarray:
    """
    Return depth (H, W) float32, NaN where it is invalid or larger than `max_depth_m`.

    Examples
    --------
    >>> limited_depth(np.array([[2.0, 0.0, 9.0]]), max_depth_m=8.0)
    array([[ 2., nan, nan]], dtype=float32)

    """
    return _valid(_float32(depth_m), MIN_DEPTH_M, min(max_depth_m, _LARGEST), False)


def limited_disparity(disparity: np.ndarray, max_depth_m: float) -> np.ndarray:
    """Return 1/z (H, W) float32, NaN where it is not finite or the depth is larger."""
    return _valid(_float32(disparity), 1 / max_depth_m, _LARGEST, False)


def to_disparity(depth_m: np.ndarray) -> np.ndarray:
    """
    Return 1/z (H, W) float32 of depth (H, W), in 1/metres, NaN where the depth is invalid.

    Examples
    --------
    >>> to_disparity(np.array([[2.0, 0.0]]))
    array([[0.5, nan]], dtype=float32)

    """
    return _valid(_float32(depth_m), MIN_DEPTH_M, _LARGEST, True)


def to_depth(disparity: np.ndarray, max_depth_m: float = np.inf) -> np.ndarray:
    """
    Return z (H, W) float32 of 1/z (H, W), NaN where it is invalid or larger than ``max_depth_m``.

    The unit is the metre, or the inverse of the unit of the disparity.

    Examples
    --------
    >>> to_depth(np.array([[0.5, 0.0, 0.01]]), max_depth_m=80.0)
    array([[ 2., nan, nan]], dtype=float32)

    """
    return _valid(_float32(disparity), max(1 / max_depth_m, _SMALLEST), 1 / MIN_DEPTH_M, True)


def _float32(values: np.ndarray) -> np.ndarray:
    """Return the values in the form that kernels take."""
    if values.dtype == np.float32:
        return np.ascontiguousarray(values)
    with np.errstate(over='ignore'):  # beyond float32 is infinite
        return np.ascontiguousarray(values, np.float32)


@kernel("float32[:, ::1](Array(float32, 2, 'C', readonly=True), float32, float32, boolean)")
def _valid(values, least, most, is_inverted):
    """Return the values, or 1 / values, NaN unless from the least to the most."""
    result = np.empty(values.shape, np.float32)
    for v in range(values.shape[0]):
        for u in range(values.shape[1]):
            value = values[v, u]
            is_valid = (value >= least) & (value <= most)
            result[v, u] = np.float32(np.nan) if not is_valid else (
                np.float32(1) / value if is_inverted else value)
    return result


def zero_filled(disparity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return disparity (H, W) float32 with 0 where it is not finite, and where it is finite."""
    return _fill_with_zero(np.ascontiguousarray(disparity, np.float32))


@kernel('Tuple((float32[:, ::1], boolean[:, ::1]))(float32[:, ::1])')
def _fill_with_zero(disparity):
    filled, valid = np.empty_like(disparity), np.empty(disparity.shape, np.bool_)
    for v in range(disparity.shape[0]):
        for u in range(disparity.shape[1]):
            valid[v, u] = abs(disparity[v, u]) < np.float32(np.inf)
            filled[v, u] = disparity[v, u] if valid[v, u] else np.float32(0)
    return filled, valid


def noise_reference(disparity: np.ndarray) -> float:
    """
    Return the range of the disparities of an image, the unit of a network's noise.

    The errors of networks scale with the disparities of the scene. A level in 1/m that suits a
    room, with disparities of 0.2 to 1, is far too high for a street, with 0.01 to 0.06. The range
    scales with the unit and does not depend on the shift. A surface that fills the image has
    hardly any range, so the lower bound is a quarter of its median.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/z, in any unit; not finite where invalid.

    Returns
    -------
    float
        In the unit of the disparity, above 0.

    Examples
    --------
    >>> street = np.linspace(0.01, 0.06, 100 * 100).reshape(100, 100)
    >>> round(noise_reference(street), 3), round(noise_reference(20 * street), 2)
    (0.048, 0.96)
    >>> round(noise_reference(np.full((100, 100), 0.5)), 3)
    0.125

    """
    return noise_unit(*range_and_median(disparity))


def noise_unit(extent: float, level: float) -> float:
    """Return the :func:`noise_reference` of disparities of a known range and median."""
    return max(extent, _MIN_RANGE_OF_LEVEL * abs(level))


def disparity_range(disparity: np.ndarray) -> float:
    """Return the range, above 0, of finite values without the outermost 2 % on either side."""
    return range_and_median(disparity)[0]


def range_and_median(disparity: np.ndarray) -> tuple[float, float]:
    """Return the :func:`disparity_range` and the median of finite values."""
    low, level, high = sampled_quantiles(disparity, _RANGE_QUANTILES)
    return max(high - low, _SMALLEST), level


def sampled_quantiles(disparity: np.ndarray, shares: Sequence[float]) -> list[float]:
    """Return quantiles of the finite values in every fourth row and column; 0 without any."""
    sample = disparity[::4, ::4]
    sample = sample[np.isfinite(sample)]
    return quantiles(sample, shares) if sample.size else [0.0] * len(shares)
