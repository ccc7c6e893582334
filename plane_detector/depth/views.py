# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Average of a network's depth over several views of one image (test-time augmentation).

A small network is best on images with the field of view that it was trained with. Two crops of the
image of a wider lens have that field of view; one is mirrored, so that their errors differ. Each
is scaled to the whole image, because a crop looks like the image of a longer lens. Crops of an
image that is already narrower would only be worse.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from plane_detector.geometry.disparity import zero_filled
from plane_detector.geometry.robust import median
from plane_detector.types import Prediction

# Smallest crop, and the largest one that is worth its time.
# tuned: benchmark orientation, flat from 0.85 to 0.95.
MIN_CROP_SHARE, MAX_CROP_SHARE = 0.85, 0.97
# The weight of a crop rises from its inner sides over this share of its width.
# tuned: benchmark orientation; steps at the sides of crops cut planes.
FEATHER_SHARE = 0.25
# Every n-th row and column is enough for the median ratio of two views.
SAMPLE_STEP = 8


@dataclass(frozen=True)
class View:
    """A part of an image."""

    share: float = 1.0  # of the image's height and width
    is_at_end: bool = False  # at the lower right corner instead of the upper left one
    is_mirrored: bool = False

    def of(self, image: np.ndarray) -> np.ndarray:
        """Return this part of an image (H, W, ...), contiguous."""
        part = image[self.slices(image.shape[:2])]
        # numpy takes 1.3 ms to copy a mirrored colour image, OpenCV 0.03.
        return cv2.flip(part, 1) if self.is_mirrored else np.ascontiguousarray(part)

    def slices(self, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Return the rows and columns in an image of this shape."""
        sizes = [max(round(self.share * side), 1) for side in shape]
        starts = [(side - size) * self.is_at_end for side, size in zip(shape, sizes, strict=True)]
        return tuple(slice(start, start + size) for start, size in zip(starts, sizes, strict=True))


def choose_views(lens_ratio: float, most: int) -> tuple[View, ...]:
    """
    Return at most 1 to 3 views of an image: the whole of it, then crops with a longer lens.

    The ratio is the focal length over height of the image, over that of the training images.

    Examples
    --------
    >>> [view.share for view in choose_views(0.9, 3)]
    [1.0, 0.9, 0.9]
    >>> len(choose_views(1.5, 3))
    1

    """
    share = max(lens_ratio, MIN_CROP_SHARE)
    if share > MAX_CROP_SHARE:
        return (View(),)
    return (View(), View(share, False, True), View(share, True, False))[:most]


def average_views(views: Sequence[View], predictions: Iterable[Prediction]) -> Prediction:
    """
    Average the disparity of views at the scale of the first one, the whole image.

    Predictions are metric depth or disparity; the result is NaN where all of them are invalid.
    """
    predictions = iter(predictions)
    first = next(predictions)
    kind = first.output
    whole = _inverted(first.values, kind)
    total, is_valid = zero_filled(whole)
    weight = is_valid.astype(np.float32)
    for view, prediction in zip(views[1:], predictions, strict=True):
        part, crop = view.slices(whole.shape), _inverted(prediction.values, kind)
        crop = cv2.flip(crop, 1) if view.is_mirrored else crop
        crop = crop * _median_ratio(whole[part], crop)
        filled, is_valid = zero_filled(crop)
        share = _feather(crop.shape, view.is_at_end) * is_valid
        total[part] += share * filled
        weight[part] += share
    with np.errstate(invalid='ignore'):  # 0 / 0 is NaN, for invalid
        return Prediction(kind, _inverted(total / weight, kind),
                          is_indoor=first.is_indoor)


def _inverted(values: np.ndarray, kind: str) -> np.ndarray:
    """Convert between values of a kind and disparity; disparity is returned as it is."""
    return 1 / values if kind == 'metric_depth' else values


def _median_ratio(target: np.ndarray, source: np.ndarray) -> np.float32:
    """Return the factor from the scale of source to that of target; 1 if they share no pixel."""
    ratio = target[::SAMPLE_STEP, ::SAMPLE_STEP] / source[::SAMPLE_STEP, ::SAMPLE_STEP]
    ratio = ratio[np.isfinite(ratio)]
    return np.float32(median(ratio) if ratio.size else 1)


@lru_cache(maxsize=8)
def _feather(shape: tuple[int, int], is_at_end: bool) -> np.ndarray:
    """Return the weights of a crop, (h, w) float32: they fall towards its inner sides."""
    sides = []
    for size in shape:
        inner = np.arange(size, 0, -1, dtype=np.float32) / max(FEATHER_SHARE * size, 1)
        sides.append(np.minimum(inner[::-1] if is_at_end else inner, 1))
    return np.outer(*sides)
