# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Robust statistics, dilation and connected parts."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

# derived: ratio of the standard deviation of a normal variable to its median absolute deviation.
SIGMA_PER_MEDIAN = 1.4826


def median(values: np.ndarray) -> float:
    """
    Return the median of values (n,), without NaN; faster than numpy.median.

    Examples
    --------
    >>> median(np.array([4.0, 1.0, 2.0, 3.0]))
    2.5

    """
    middle, ordered = len(values) // 2, values.copy()
    ordered.partition(middle)  # both of the middle take three times as long
    low = ordered[middle] if len(values) % 2 else ordered[:middle].max()
    return float((low + ordered[middle]) / 2)


def quantiles(values: np.ndarray, shares: Sequence[float]) -> list[float]:
    """
    Return quantiles of values (n,), at least one, without NaN; faster than numpy.quantile.

    Examples
    --------
    >>> quantiles(np.array([4.0, 1.0, 3.0, 2.0, 5.0]), (0.0, 0.375, 1.0))
    [1.0, 2.5, 5.0]

    """
    ordered, found = np.sort(values), []
    for share in shares:
        place = share * (len(ordered) - 1)
        low = int(place)
        first, second = float(ordered[low]), float(ordered[min(low + 1, len(ordered) - 1)])
        found.append(first + (place - low) * (second - first))
    return found


def dilated(mask: np.ndarray, reach: int) -> np.ndarray:
    """
    Return a mask (H, W) bool dilated by a square that reaches this many pixels to each side.

    Examples
    --------
    >>> dilated(np.array([[True, False, False]]), 1)
    array([[ True,  True, False]])

    """
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.dilate(np.ascontiguousarray(mask).view(np.uint8), square).view(bool)


def touching(mask: np.ndarray, seeds: np.ndarray, connectivity: int) -> np.ndarray:
    """
    Return the parts of a mask (H, W) bool that contain a seed (H, W) bool.

    Examples
    --------
    >>> touching(np.array([[True, True, False, True]]), np.array([[True, False, True, False]]), 4)
    array([[ True,  True, False, False]])

    """
    count, parts = cv2.connectedComponents(mask.view(np.uint8), connectivity=connectivity)
    is_found = np.zeros(count, bool)
    is_found[parts[seeds]] = True
    is_found[0] = False
    return is_found[parts]
