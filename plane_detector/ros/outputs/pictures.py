# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures for people, ~/markers and ~/overlay: at a limited rate, but always the last one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.topics import OUTPUTS

PERIOD_S = 0.1
"""Time between two calls of :meth:`Pictures.publish_late`."""
# chosen: an image that is on time, given the jitter of a camera, replaces a waiting one.
_PATIENCE = 1.5


class Pictures:
    """
    Decides which images get pictures; keeps the last image without one until no other follows.

    Thread-safe: images come from the worker, late pictures are made in the thread of the executor.

    Parameters
    ----------
    publish : callable
        Makes and publishes the pictures of an image.

    """

    def __init__(self, publish: Callable[[DetectedFrame], None]):
        self._publish = publish
        self._lock = threading.Lock()
        self._made_s = float('-inf')
        self._waiting: DetectedFrame | None = None

    def due(self, found: DetectedFrame, wanted: list[str]) -> list[str]:
        """Return the outputs to make for an image now: the wanted ones, with pictures if due."""
        now_s, rate_hz = time.monotonic(), found.settings.picture_rate
        if not any(OUTPUTS[name].is_picture for name in wanted):
            return wanted
        with self._lock:
            if (now_s - self._made_s) * rate_hz >= 1 or rate_hz == 0:
                self._made_s, self._waiting = now_s, None
                return wanted
            self._waiting = found
        return [name for name in wanted if not OUTPUTS[name].is_picture]

    def publish_late(self) -> None:
        """Publish the pictures of the last image if no other image has followed in time."""
        with self._lock:  # so that no newer picture is published first
            found, now_s = self._waiting, time.monotonic()
            if found is not None and (now_s - self._made_s
                                      ) * found.settings.picture_rate >= _PATIENCE:
                self._made_s, self._waiting = now_s, None
                self._publish(found)

    def drop(self) -> None:
        """Forget the waiting image; the next one gets its pictures immediately."""
        with self._lock:
            self._made_s, self._waiting = float('-inf'), None
