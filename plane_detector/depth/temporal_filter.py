# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Temporal filter that reduces the flicker of a network's disparity while the scene is static.

Sensor noise changes the output of a network in each frame, even if the camera does not move. While
nothing moves, the disparity is averaged over time. As soon as anything moves, the whole new image
is used unfiltered: a lag would bend planes, and filtering only a part of the image would create
two noise levels, whereas the segmentation estimates one. Image and disparity are compared with
their averages, so that slow motion is detected too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, dilated, median, quantiles

# Standard deviation of the blur, and how far OpenCV's kernel for it reaches.
_BLUR_PX, _BLUR_REACH_PX = 1.5, 6
# Brightness has changed if it differs by this many standard deviations of its noise; the noise is
# clipped to this range of grey levels.
_GREY_SIGMAS, _GREY_NOISE = 5.0, (0.4, 1.5)
# The same for the mean disparity of a block, which must also differ by more than this share of the
# range in the image: networks flicker ten times more at edges than elsewhere.
_DEPTH_SIGMAS, _DEPTH_SHARE, _BLOCK_PX = 4.0, 0.1, 8
# Something moves if the brightness or disparity of more than this share of the pixels has changed;
# a smaller share is noise or, with its surroundings, too small for a plane.
_GREY_MOVING, _DEPTH_MOVING, _SPREAD_PX = 0.0005, 0.005, 8
_STEP_PX = 4  # statistics use every fourth row and column
# With a moving camera most images change almost everywhere, so bands of rows suffice.
# chosen: a seventh of an image of 480 rows.
_BANDS, _BAND_PX = 4, 16
# With fewer edge pixels a static camera cannot be recognised.
_EDGE_GREY_PER_PX, _FEWEST_ON_EDGES = 6.0, 50
_FIT_ROUNDS, _FEWEST_FITTED = 3, 100


@dataclass(frozen=True)
class FilteredDisparity:
    """Averages up to and including an image."""

    disparity: np.ndarray  # (H, W) float32, not finite where that of the last image is not
    brightness: np.ndarray  # (H, W) uint8: of the last image
    average_grey: np.ndarray | None = None  # as ``grey``, of more than one image
    image_count: int = 1

    @cached_property
    def grey(self) -> np.ndarray:
        """Blurred brightness (H, W) float32."""
        return _blurred(self.brightness) if self.average_grey is None else self.average_grey

    def band(self, k: int) -> np.ndarray:
        """Return rows (n, W) float32 of the blurred brightness, one of the bands of an image."""
        top = (k + 1) * max(len(self.brightness) - _BAND_PX, 0) // (_BANDS + 1)
        return _blurred(self.brightness[max(top - _BLUR_REACH_PX, 0):
                                        top + _BAND_PX + _BLUR_REACH_PX]
                        )[min(top, _BLUR_REACH_PX):][:_BAND_PX]


def filter_disparity(previous: FilteredDisparity | None, disparity: np.ndarray, rgb: np.ndarray,
                     keep: float, *, same_scale: bool) -> FilteredDisparity:
    """
    Average the disparity of an image with the previous ones, if nothing has changed.

    Parameters
    ----------
    previous : FilteredDisparity or None
        Averages up to the previous image; if None or of another size, a new average starts.
    disparity : (H, W) floating
        Not finite where invalid.
    rgb : (H, W, 3) uint8
    keep : float
        Weight of the old average at each image, 0 to below 1. The first images have equal
        weights.
    same_scale : bool
        False for relative disparity, whose scale and shift may change with each image: the
        average is converted to those of the new image.

    """
    brightness = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    alone = FilteredDisparity(disparity.astype(np.float32, copy=False), brightness)
    if (previous is None or previous.brightness.shape != brightness.shape
            or (previous.image_count == 1 and _surely_moves(previous, alone))
            or not _shows_motion(alone.grey)):
        return alone
    return _averaged(previous, alone, keep, same_scale) or alone


def _blurred(brightness: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), _BLUR_PX)


def _surely_moves(previous: FilteredDisparity, alone: FilteredDisparity) -> bool:
    """Return whether some rows alone change in too many pixels, assuming the largest noise."""
    changed = 0
    for k in range(_BANDS):
        difference = cv2.absdiff(previous.band(k), alone.band(k))
        changed += np.count_nonzero(difference > _GREY_SIGMAS * _GREY_NOISE[1])
        if changed > _GREY_MOVING * alone.brightness.size:
            return True
    return False


def _averaged(previous: FilteredDisparity, alone: FilteredDisparity, keep: float,
              same_scale: bool) -> FilteredDisparity | None:
    """Return the average with a new image; None if something moved or the scale is uncertain."""
    disparity, grey = alone.disparity, alone.grey
    changed = _has_changed(previous.grey, grey)
    if np.count_nonzero(changed) > _GREY_MOVING * changed.size:
        return None
    known = np.isfinite(disparity) & np.isfinite(previous.disparity)
    expected = previous.disparity
    if not same_scale:
        expected = _in_scale_of(disparity, expected, known & ~changed)
        if expected is None:
            return None
    differs = _differs(disparity, expected, known)
    if np.count_nonzero(differs) > _DEPTH_MOVING * differs.size:
        return None
    weight = min(keep, previous.image_count / (previous.image_count + 1))
    moving = changed | differs
    still = ~dilated(moving, _SPREAD_PX) if moving.any() else ~moving
    return FilteredDisparity(_mixed(expected, disparity, weight, still & known),
                             alone.brightness, _mixed(previous.grey, grey, weight, still),
                             previous.image_count + 1)


def _mixed(old: np.ndarray, new: np.ndarray, weight: float, where: np.ndarray) -> np.ndarray:
    """Return the average of images (H, W) float32; the new image elsewhere."""
    mixed = cv2.addWeighted(old, weight, new, 1 - weight, 0)
    if not where.all():
        np.copyto(mixed, new, where=~where)
    return mixed


def _shows_motion(grey: np.ndarray) -> bool:
    """Return whether the image has enough edges to reveal camera motion."""
    on_edges = sum(np.count_nonzero(np.abs(np.diff(lines, axis=axis)) > _EDGE_GREY_PER_PX)
                   for lines, axis in ((grey[::_STEP_PX], 1), (grey[:, ::_STEP_PX], 0)))
    return on_edges >= _FEWEST_ON_EDGES


def _has_changed(before: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return where the brightness has changed, (H, W) bool."""
    difference = cv2.absdiff(grey, before)
    least, most = _GREY_NOISE
    sigma = SIGMA_PER_MEDIAN * median(difference[::_STEP_PX, ::_STEP_PX].ravel())
    return difference > _GREY_SIGMAS * min(max(sigma, least), most)


def _in_scale_of(disparity: np.ndarray, before: np.ndarray,
                 still: np.ndarray) -> np.ndarray | None:
    """Return the old disparity in the scale and shift of the new; None if they are uncertain."""
    thinned = (slice(None, None, _STEP_PX),) * 2
    used = still[thinned]
    old, new = (values[thinned][used].astype(float) for values in (before, disparity))
    scale = shift = 0.0
    for _ in range(_FIT_ROUNDS):
        if len(old) < _FEWEST_FITTED or not np.ptp(old) > 0:
            return None
        scale = np.cov(old, new, ddof=0)[0, 1] / old.var()
        shift = new.mean() - scale * old.mean()
        residual = np.abs(new - scale * old - shift)
        inside = residual <= 3 * SIGMA_PER_MEDIAN * np.median(residual)
        old, new = old[inside], new[inside]
    return np.float32(scale) * before + np.float32(shift) if scale > 0 else None


def _differs(disparity: np.ndarray, expected: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return where the disparity has changed by more than its flicker, (H, W) bool."""
    thinned = (slice(None, None, _STEP_PX),) * 2
    if not known[thinned].any():
        return np.zeros(known.shape, bool)
    difference = disparity - expected
    if not known.all():
        difference[~known] = 0
    share = _block_means(known.astype(np.float32))
    mean = np.abs(_block_means(difference)) / np.maximum(share, 1e-6)
    flicker = SIGMA_PER_MEDIAN * median(mean[share > 0])
    low, high = quantiles(expected[thinned][known[thinned]], (0.05, 0.95))
    far = mean > max(_DEPTH_SIGMAS * flicker, _DEPTH_SHARE * (high - low))
    return cv2.resize(far.view(np.uint8), known.shape[::-1],
                      interpolation=cv2.INTER_NEAREST).view(bool)


def _block_means(values: np.ndarray) -> np.ndarray:
    """Return the means of blocks of the image that are as square as its sides allow."""
    height, width = (max(1, round(side / _BLOCK_PX)) for side in values.shape)
    return cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)
