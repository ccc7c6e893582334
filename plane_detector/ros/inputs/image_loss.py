# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How many of the images that a camera sent have arrived, by their stamps."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

# derived: a window long enough to count losses of a fifth, short enough to follow a camera that
# changes its rate.
_WINDOW_NS = 5_000_000_000
_MOST_STAMPS = 1000
# derived: of half of the images lost at random, ten in a row are one in a thousand; a longer gap
# is a pause of the camera.
_LONGEST_GAP = 10
_FEWEST_IMPLIED = 20
# derived: stamps without any period are on average .25 of a period off its multiples; those of a
# constant rate with a jitter of .15 of the period .1.
_MOST_OFF = 0.15
# derived: of images lost at random, a fifth or more, two thirds of the intervals at most equal one
# that comes a fixed number of intervals later.
_LONGEST_RHYTHM, _REPEATED_SHARE = 6, 0.9
# derived: a camera that sends a CameraInfo with each image gives both the same stamp.
_PAIRED_SHARE = 0.5
_JUMP_NS = 1_000_000_000
WARNED_SHARE = 0.2
"""From this share of lost images on, the node warns."""


class Arrivals(NamedTuple):
    """Images that arrived in a window, and images that the stamps imply for it."""

    received: int
    implied: int

    @property
    def are_few(self) -> bool:
        """Whether so many images are missing that a warning is due."""
        return (self.implied >= _FEWEST_IMPLIED
                and self.received <= (1 - WARNED_SHARE) * self.implied)


class ImageLoss:
    """
    Counts images, and the stamps between which the camera sends at a constant rate.

    A CameraInfo is small and arrives where its image is lost: its stamp counts as sent. Stamps
    without a period, such as those of a camera that is triggered, imply no other images, nor does
    a rhythm that repeats, such as that of a throttled topic, or a new rate.
    """

    def __init__(self) -> None:
        self._images: deque[int] = deque(maxlen=_MOST_STAMPS)
        self._infos: deque[int] = deque(maxlen=_MOST_STAMPS)

    def add_image(self, stamp_ns: int) -> None:
        """Count an image."""
        if self._images and stamp_ns < self._images[-1] - _JUMP_NS:  # time jumped back
            self._images.clear()
            self._infos = deque((other_ns for other_ns in self._infos
                                 if other_ns <= stamp_ns + _JUMP_NS), _MOST_STAMPS)
        self._images.append(stamp_ns)

    def add_camera_info(self, stamp_ns: int) -> None:
        """Count a stamp."""
        self._infos.append(stamp_ns)

    def arrivals(self) -> Arrivals:
        """Return the numbers for the last seconds before the last image."""
        if not self._images:
            return Arrivals(0, 0)
        images = np.unique(self._images)
        images = images[images >= images[-1] - _WINDOW_NS]
        infos = np.unique(self._infos)
        infos = infos[(infos >= images[0]) & (infos <= images[-1])]
        is_paired = np.isin(images, infos).mean() > _PAIRED_SHARE
        sent = np.union1d(images, infos) if is_paired else images
        return Arrivals(len(images), _implied(sent))


def _implied(stamps_ns: np.ndarray) -> int:
    """Return how many stamps a camera has given, from sorted ones of which some are missing."""
    intervals = np.diff(stamps_ns)
    if len(stamps_ns) < _FEWEST_IMPLIED:
        return len(stamps_ns)
    # The shortest intervals are one period, the others several; stamps may jitter.
    periods = intervals / np.median(intervals[intervals < 1.5 * np.quantile(intervals, 0.2)])
    steps = np.rint(periods)
    steps[steps > _LONGEST_GAP] = 1
    repeats = max((steps[lag:] == steps[:-lag]).mean() for lag in range(1, _LONGEST_RHYTHM + 1))
    if abs(periods - np.rint(periods)).mean() > _MOST_OFF or repeats > _REPEATED_SHARE:
        return len(stamps_ns)
    return 1 + int(steps.sum())
