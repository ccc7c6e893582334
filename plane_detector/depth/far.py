# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Detection of pixels without a surface: depth beyond the network's range, and sky.

A disparity within its noise of 0 is compatible with any distance up to infinity. Networks trained
indoors give the sky a finite depth, so the sky is found in the image: a smooth, bright and bluish
region at the upper border, in the farther half of the depth, that becomes whiter and not darker
downwards. Rayleigh scattering causes this in a clear sky; a wall keeps its colour when its
brightness changes. The smooth white region between it and the horizon belongs to the sky. An
overcast sky is found if the camera overexposes it: a white region without texture at the upper
border that is the farthest part of the image. A grey or cloudy sky is found in the depth: networks
of relative disparity give it the lowest values of the image, without the gradient that walls have.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.geometry.robust import dilated, median, quantiles, touching

FAR_DEVIATIONS = 3.0
"""A disparity below this many standard deviations does not determine a distance."""
_SMALL_WIDTH_PX = 160
_MOST_SMALL_HEIGHT_PX = 640  # chosen: 9:16 has 284; an image of 3 x 4000 would have 213000
# For a reduced image with values of 0 to 255.
_TEXTURE_WINDOW_PX, _MOST_TEXTURE = 5, 6.0
_MIN_GREY, _MIN_BLUE_MINUS_RED = 110.0, 4.0
_MIN_SHARE = 0.02  # of the image; fewer pixels do not determine the colours
_MIN_FAR_SHARE = 0.6
# Decrease of blue over red from the upper to the lower tenth of the region. Measured: 0.12 and
# 0.19 for skies (KITTI, a photograph of a temple), 0.03 to 0.06 for a bluish wall in 60 images.
_MIN_WHITENING = 0.09
_MOST_DARKENING = 5.0
# An overexposed region: all channels above the first; at least the second of it among the farthest
# quarter of the image, or as much as it covers. Measured: 0.78 to 0.92 for the skies of three
# streets (KITTI), 0.11 to 0.58 for the white curtain of a rendered living room in 14 images; other
# indoor images have no such region. Its disparity, 0.75 of that of the rest, is at most the third.
_OVEREXPOSED, _MIN_FARTHEST_SHARE, _MOST_OF_REST = 245.0, 0.68, 0.9
# Near the horizon the sky may be darker by this, and redder than blue by this.
_HORIZON_DARKER, _HORIZON_REDDER = 15.0, 5.0
# A flat region: within the first share of the spread of the disparity (2 to 90 %) above its least,
# brighter than the second value and, by the third, than the rest, not reddish, with at most the
# fourth as its slope over the width of the image. Measured: slopes of .001 to .003 for three skies
# (DPT; with four times that share one of them has .17, as networks blur its lower border), above
# .08 for water and for the bright regions of 134 indoor images.
_LEAST_SHARE, _MIN_FLAT_GREY, _MIN_BRIGHTER, _MOST_SLOPE = 0.01, 140.0, 30.0, 0.015
_BORDER_PX = 3  # the texture window reaches this far beyond the region


def has_usable_distance(disparity: np.ndarray, noise: float, rgb: np.ndarray,
                        has_shift: bool = False) -> tuple[np.ndarray, bool]:
    """
    Return the pixels (H, W) bool whose disparity determines a distance, and whether there is sky.

    Parameters
    ----------
    disparity : (H, W) floating
        NaN invalid.
    noise : float
        Its standard deviation; 0: unknown.
    rgb : (H, W, 3) uint8
    has_shift : bool
        The disparity of unknown shift is affine in 1/z: 0 is infinitely far only under a sky, and
        not if some values are negative.

    """
    sky = find_sky(rgb, disparity, has_shift)
    least = np.fmin.reduce(disparity, axis=None)
    farthest = FAR_DEVIATIONS * noise
    if has_shift and (sky is None or least < 0):
        farthest = -np.inf
    known = (~(disparity < farthest) if least < farthest else np.ones(disparity.shape, bool))
    return (known, False) if sky is None else (known & ~sky, True)


def find_sky(rgb: np.ndarray, disparity: np.ndarray,
             has_shift: bool = False) -> np.ndarray | None:
    """
    Return the sky, (H, W) bool, clear, overexposed or, if the shift is unknown, flat; else None.

    Invalid pixels of the disparity (H, W), which are not finite, count as far.
    """
    height, width = rgb.shape[:2]
    small_height = round(height * _SMALL_WIDTH_PX / width)
    size = _SMALL_WIDTH_PX, min(max(2, small_height), _MOST_SMALL_HEIGHT_PX)
    # Channels (3, h, w): their sums and comparisons take a fifth of those with a stride.
    small = np.array(cv2.split(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)), np.float32)
    reduced = cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST)
    far = np.nan_to_num(reduced, nan=0.0, posinf=0.0).astype(np.float32, copy=False)
    is_even = _is_even(small)
    region = _clear_sky(small, far, is_even)
    region = _overexposed_sky(small, far, is_even) if region is None else region
    flat = _flat_sky(small, reduced) if region is None and has_shift else None
    if region is None and flat is None:
        return None
    region = flat if region is None else region
    least_grey = float(np.quantile(small[:, region].mean(axis=0), 0.1)) - _HORIZON_DARKER
    if flat is None:
        near_horizon = is_even & _is_bright(small, least_grey, -_HORIZON_REDDER)
        region = touching(near_horizon | region, region, connectivity=4)
    wide = cv2.resize(dilated(region, _BORDER_PX).view(np.uint8), (width, height),
                      interpolation=cv2.INTER_NEAREST) > 0
    channels = np.array(cv2.split(rgb), np.float32)
    return wide & _is_bright(channels, least_grey, -_HORIZON_REDDER)


def _is_bright(rgb: np.ndarray, least_grey: float, least_blue_minus_red: float) -> np.ndarray:
    return (_grey(rgb) > least_grey) & (rgb[2] - rgb[0] >= least_blue_minus_red)


def _grey(rgb: np.ndarray) -> np.ndarray:
    """Return the mean of the channels (3, H, W) float32, ten times as fast as its method."""
    return (rgb[0] + rgb[1] + rgb[2]) / np.float32(3)


def _is_even(small: np.ndarray) -> np.ndarray:
    grey, window = _grey(small), (_TEXTURE_WINDOW_PX,) * 2
    mean = cv2.blur(grey, window)
    return cv2.blur(grey * grey, window) - mean * mean < _MOST_TEXTURE**2


def _clear_sky(small: np.ndarray, far: np.ndarray, is_even: np.ndarray) -> np.ndarray | None:
    region = _at_the_top(is_even & _is_bright(small, _MIN_GREY, _MIN_BLUE_MINUS_RED))
    if region is None or not _whitens_downwards(small, region):
        return None
    return region if np.mean(far[region] <= median(far.ravel())) >= _MIN_FAR_SHARE else None


def _overexposed_sky(small: np.ndarray, far: np.ndarray, is_even: np.ndarray) -> np.ndarray | None:
    darkest = np.minimum(np.minimum(small[0], small[1]), small[2])
    region = _at_the_top(is_even & (darkest >= _OVEREXPOSED))
    if region is None or region.all():
        return None
    if not median(far[region]) < _MOST_OF_REST * median(far[~region]):
        return None
    (limit,) = quantiles(far.ravel(), (max(0.25, _share(region)),))
    return region if np.mean(far[region] <= limit) >= _MIN_FARTHEST_SHARE else None


def _flat_sky(small: np.ndarray, disparity: np.ndarray) -> np.ndarray | None:
    known = np.isfinite(disparity)
    if not known.any():
        return None
    least, most = np.quantile(disparity[known], (0.02, 0.9))
    spread = max(float(most - least), 1e-12)
    is_least = known & (np.where(known, disparity, np.inf) < least + _LEAST_SHARE * spread)
    region = _at_the_top(is_least & _is_bright(small, _MIN_FLAT_GREY, 0.0))
    if region is None or region.all():
        return None
    v, u = np.nonzero(region)
    design = np.stack([u / _SMALL_WIDTH_PX, v / _SMALL_WIDTH_PX, np.ones(len(u))], axis=1)
    slopes = np.linalg.lstsq(design, disparity[region] / spread, rcond=None)[0][:2]
    grey = _grey(small)
    is_flat = (np.hypot(*slopes) < _MOST_SLOPE
               and np.median(grey[region]) > grey[~region].mean() + _MIN_BRIGHTER)
    return region if is_flat else None


def _share(region: np.ndarray) -> float:
    """Return the share of the image that a region covers."""
    return np.count_nonzero(region) / region.size


def _at_the_top(candidates: np.ndarray) -> np.ndarray | None:
    """Return the candidates that are connected to the upper border; None if they are too few."""
    if not candidates[0].any() or _share(candidates) < _MIN_SHARE:
        return None
    top = np.zeros_like(candidates)
    top[0] = candidates[0]
    region = touching(candidates, top, connectivity=4)
    return None if _share(region) < _MIN_SHARE else region


def _whitens_downwards(small: np.ndarray, region: np.ndarray) -> bool:
    rows = np.nonzero(region)[0]
    colours = small[:, region].T
    upper, lower = (colours[part] for part in (
        rows <= np.quantile(rows, 0.1), rows >= np.quantile(rows, 0.9)))
    blue_over_red = [np.median((part[:, 2] + 1) / (part[:, 0] + 1)) for part in (upper, lower)]
    grey = [np.median(part.mean(axis=1)) for part in (upper, lower)]
    return (blue_over_red[0] - blue_over_red[1] >= _MIN_WHITENING
            and grey[0] - grey[1] <= _MOST_DARKENING)
