# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Two threads that process frames, and the buffers between them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.stopping import Background, Stop, Stopped

SKIPPED = None
"""Result of the first half for a frame that has no second half."""


class FrameWorker:
    """
    Processes two frames at a time, in the two halves of a pipeline; the newest frame wins.

    While the second half processes a frame, the first half processes the next one. Each half takes
    one frame at a time, both in the same order. One more frame may wait for the first half; a
    newer one replaces it. The first half starts only if nothing waits for the second. If the
    second half is slower, the first starts so late that both are expected to end together. So no
    work is discarded, no queue grows, and the processed frames are recent.

    Parameters
    ----------
    first : callable
        Called in the first thread with each frame, under a stop for that frame; returns the input
        of the second half, or SKIPPED. Must not raise, except Stopped.
    second : callable
        Called in the second thread with this input, under the same stop. Must not raise, except
        Stopped.

    """

    def __init__(self, first: Callable[[Frame], Any], second: Callable[[Any], None]):
        self._halves = first, second
        self._changed = threading.Condition()
        self._waiting: Frame | None = None
        self._between: tuple[Any, Stop] | None = None
        self._stops: list[Stop] = []
        self._first_s = self._second_s = 0.0
        self._second_since_s: float | None = None
        self._ended = False
        self._threads = (Background(self._run_first, 'frame_worker'),
                         Background(self._run_second, 'frame_finisher'))

    def put(self, frame: Frame) -> bool:
        """Set the next frame; return whether it replaced one that was waiting."""
        with self._changed:
            replaced = self._waiting is not None
            self._waiting = frame
            self._changed.notify_all()
            return replaced

    def drop(self) -> None:
        """
        Drop the waiting frames, stop those being processed, and return at once.

        The next frame starts when the work on the last one has ended, at the latest at its next
        check for a stop.
        """
        with self._changed:
            stops = tuple(self._stops)
            if self._between is not None:
                self._stops.remove(self._between[1])
            self._waiting = self._between = None
            self._changed.notify_all()
        for stop in stops:
            stop.set()

    def stop(self) -> None:
        """Drop all frames, accept no more, and return at once."""
        with self._changed:
            self._ended = True
        self.drop()

    def wait(self, timeout_s: float) -> bool:
        """Wait, after `stop`, for the work to end; return False after a timeout."""
        end_s = time.monotonic() + timeout_s
        ended = [thread.wait(max(end_s - time.monotonic(), 0.0)) for thread in self._threads]
        return all(ended)

    def _run_first(self) -> None:
        first, _ = self._halves
        while (taken := self._take_frame()) is not None:
            (frame, stop), start_s = taken, time.monotonic()
            observed = _called(first, frame, stop)
            self._first_s = time.monotonic() - start_s
            self._hand_over(observed, stop)
            del frame, observed, taken  # no references while waiting

    def _run_second(self) -> None:
        _, second = self._halves
        while (taken := self._take_observed()) is not None:
            observed, stop = taken
            _called(second, observed, stop)
            with self._changed:
                self._stops.remove(stop)
                self._second_s = time.monotonic() - self._second_since_s
                self._second_since_s = None
                self._changed.notify_all()
            del observed, taken

    def _take_frame(self) -> tuple[Frame, Stop] | None:
        with self._changed:
            while not self._ended and (delay_s := self._delay_s()) != 0:
                self._changed.wait(delay_s)
            if self._ended:
                return None
            frame, self._waiting = self._waiting, None
            self._stops.append(Stop())
            return frame, self._stops[-1]

    def _delay_s(self) -> float | None:
        """Return the delay of the first half; None: wait for a change."""
        if self._waiting is None or self._between is not None:
            return None
        if self._second_since_s is None:
            return 0.0
        expected_end_s = self._second_since_s + self._second_s
        return max(expected_end_s - self._first_s - time.monotonic(), 0.0)

    def _hand_over(self, observed: Any, stop: Stop) -> None:
        with self._changed:
            if observed is SKIPPED or stop.is_set:
                self._stops.remove(stop)
            else:
                self._between = observed, stop
                self._changed.notify_all()

    def _take_observed(self) -> tuple[Any, Stop] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._between is not None)
            if self._ended:
                return None
            taken, self._between = self._between, None
            self._second_since_s = time.monotonic()
            self._changed.notify_all()  # the first half may start the next frame
            return taken


def _called(half: Callable[[Any], Any], given: Any, stop: Stop) -> Any:
    """Call one half of the pipeline; the frame is skipped if it is stopped."""
    try:
        with stop.applies():
            return half(given)
    except Stopped:  # the frame was dropped
        return SKIPPED
