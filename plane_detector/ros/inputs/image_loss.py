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

    A CameraInfo is small and arrives where its image is lost: its stamp counts as sent.
    """

    def __init__(self) -> None:
        self._images: deque[int] = deque(maxlen=_MOST_STAMPS)
        self._sent: deque[int] = deque(maxlen=2 * _MOST_STAMPS)

    def add_image(self, stamp_ns: int) -> None:
        """Count an image."""
        if self._images and stamp_ns < self._images[-1] - _WINDOW_NS:  # time jumped back
            self._images.clear()
            self._sent.clear()
        self._images.append(stamp_ns)
        self._sent.append(stamp_ns)

    def add_camera_info(self, stamp_ns: int) -> None:
        """Count a stamp."""
        self._sent.append(stamp_ns)

    def arrivals(self) -> Arrivals:
        """Return the numbers for the last seconds before the last image."""
        if not self._images:
            return Arrivals(0, 0)
        first_ns, last_ns = self._images[-1] - _WINDOW_NS, self._images[-1]
        images = np.unique(self._images)
        images = images[images >= first_ns]
        sent = np.unique(self._sent)
        sent = sent[(sent >= images[0]) & (sent <= last_ns)]
        intervals = np.diff(sent)
        if not intervals.size:
            return Arrivals(len(images), len(images))
        # The shortest intervals are one period, the others several; stamps may jitter.
        period = np.median(intervals[intervals < 1.5 * np.quantile(intervals, 0.2)])
        steps = np.rint(intervals / period)
        implied = 1 + int(np.where(steps <= _LONGEST_GAP, steps, 1).sum())
        return Arrivals(len(images), max(implied, len(images)))
