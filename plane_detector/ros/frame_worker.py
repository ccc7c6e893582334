# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Threads that process frames, one per stage, and the buffers between them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.stopping import Background, Stop, Stopped

SKIPPED = None
"""Result of a stage for a frame that has no further stages."""


class FrameWorker:
    """
    Processes several frames at a time, one in each stage of a pipeline; the newest frame wins.

    While a stage processes a frame, the stage before it processes the next one. Each stage takes
    one frame at a time, all in the same order. One more frame may wait for the first stage; a
    newer one replaces it. A stage starts only if nothing waits for the next stage. If a later
    stage is slower, it starts so late that the next one is expected to be free when it ends. So
    no work is discarded, no queue grows, and the processed frames are recent.

    Parameters
    ----------
    *stages : callable
        Each is called in its own thread, under a stop for the frame: the first with the frame,
        the others with the result of the one before, unless it was SKIPPED. Must not raise,
        except Stopped.

    """

    def __init__(self, *stages: Callable[[Any], Any]):
        self._stages = stages
        self._lock = threading.RLock()
        # One for each stage: to wake them all takes as long as a short stage.
        self._changed = [threading.Condition(self._lock) for _ in stages]
        # By stage: what waits for it, how long it took last, and since when it works.
        self._waiting: list[tuple[Any, Stop] | None] = [None] * len(stages)
        self._last_s = [0.0] * len(stages)
        self._since_s: list[float | None] = [None] * len(stages)
        self._stops: list[Stop] = []
        self._ended = False
        self._threads = tuple(Background(partial(self._run, index), f'frame_stage_{index}')
                              for index in range(len(stages)))

    def put(self, frame: Frame) -> bool:
        """Set the next frame; return whether it replaced one that was waiting."""
        with self._lock:
            replaced = self._waiting[0] is not None
            self._waiting[0] = frame, Stop()
            self._wake()
            return replaced

    def drop(self) -> None:
        """
        Drop the waiting frames, stop those being processed, and return at once.

        The next frame starts when the work on the last one has ended, at the latest at its next
        check for a stop.
        """
        with self._lock:
            stops = tuple(self._stops)
            for waiting in self._waiting[1:]:
                if waiting is not None:
                    self._stops.remove(waiting[1])
            self._waiting = [None] * len(self._stages)
            self._wake()
        for stop in stops:
            stop.set()

    def stop(self) -> None:
        """Drop all frames, accept no more, and return at once."""
        with self._lock:
            self._ended = True
        self.drop()

    def wait(self, timeout_s: float) -> bool:
        """Wait, after `stop`, for the work to end; return False after a timeout."""
        end_s = time.monotonic() + timeout_s
        ended = [thread.wait(max(end_s - time.monotonic(), 0.0)) for thread in self._threads]
        return all(ended)

    def _wake(self) -> None:
        """Wake the stages that may begin, or begin sooner; the caller holds the lock."""
        for waiting, after, changed in zip(self._waiting, (*self._waiting[1:], None),
                                           self._changed, strict=True):
            if self._ended or (waiting is not None and after is None):
                changed.notify()

    def _run(self, index: int) -> None:
        while (taken := self._take(index)) is not None:
            given, stop = taken
            self._hand_over(index, _called(self._stages[index], given, stop), stop)
            del given, taken  # no references while waiting

    def _take(self, index: int) -> tuple[Any, Stop] | None:
        """Wait for the next input of a stage; None at the end."""
        with self._lock:
            while not self._ended and (delay_s := self._delay_s(index)) != 0:
                self._changed[index].wait(delay_s)
            if self._ended:
                return None
            taken, self._waiting[index] = self._waiting[index], None
            if index == 0:
                self._stops.append(taken[1])
            self._since_s[index] = time.monotonic()
            self._wake()  # the stage before may begin the next frame
            return taken

    def _delay_s(self, index: int) -> float | None:
        """Return the delay of a stage; None: wait for a change."""
        is_last = index + 1 == len(self._stages)
        if self._waiting[index] is None or (not is_last and self._waiting[index + 1] is not None):
            return None
        if is_last:
            return 0.0
        now_s, until_s, there_s = time.monotonic(), 0.0, 0.0
        free_s = self._free_s(index + 1, now_s)
        for later in range(index + 1, len(self._stages)):
            there_s += self._last_s[later - 1]
            until_s = max(until_s, free_s[later] - there_s)
        return max(until_s - now_s, 0.0)

    def _free_s(self, first: int, now_s: float) -> list[float]:
        """Return when stages are expected to be done with all frames from this one on."""
        free_s = [now_s] * len(self._stages)
        for index in reversed(range(first, len(self._stages))):  # the oldest frame first
            if (since_s := self._since_s[index]) is not None:
                free_s[index] = max(since_s + self._last_s[index], now_s)
                self._pass_on(index + 1, free_s[index], free_s)
            if self._waiting[index] is not None:
                self._pass_on(index, now_s, free_s)
        return free_s

    def _pass_on(self, first: int, there_s: float, free_s: list[float]) -> None:
        """Let one more frame pass the stages from ``first`` on, where it is at ``there_s``."""
        for index in range(first, len(self._stages)):
            there_s = free_s[index] = max(there_s, free_s[index]) + self._last_s[index]

    def _hand_over(self, index: int, result: Any, stop: Stop) -> None:
        with self._lock:
            self._last_s[index] = time.monotonic() - self._since_s[index]
            self._since_s[index] = None
            if index + 1 == len(self._stages) or result is SKIPPED or stop.is_set:
                self._stops.remove(stop)
            else:
                self._waiting[index + 1] = result, stop
            self._wake()


def _called(stage: Callable[[Any], Any], given: Any, stop: Stop) -> Any:
    """Call a stage; skip the frame if it is stopped."""
    try:
        with stop.applies():
            return stage(given)
    except Stopped:  # nobody waits for this frame any more
        return SKIPPED
