# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The threads that process frames, and the place of the frame that waits for them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from queue import Queue
from typing import TypeVar

from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.stopping import Background, Stop, Stopped, raise_if_stopped

Result = TypeVar('Result')


class FrameWorker:
    """
    Processes frames in order; one more may wait, and a newer one replaces it.

    Parameters
    ----------
    begin : callable
        Called with each frame; returns the function that finishes it, which is called after that
        of the frame before. Both run under a stop for the frame, and must not raise, except
        Stopped.
    overlaps : bool
        Whether frames are finished in a second thread, while the next one is begun. It is worth
        it only if beginning takes long: two threads of Python wait for each other.

    """

    def __init__(self, begin: Callable[[Frame], Callable[[], None]], overlaps: bool):
        self._begin, self._overlaps = begin, overlaps
        self._changed = threading.Condition()
        self._waiting: Frame | None = None
        self._stops: tuple[Stop, ...] = ()
        self._ended = False
        self._begun: Queue[Callable[[], object] | None] = Queue()
        self._thread = Background(self._run, 'frame_worker')

    def put(self, frame: Frame) -> bool:
        """Set the next frame; return whether it replaced one that was waiting."""
        with self._changed:
            replaced, self._waiting = self._waiting is not None, frame
            self._changed.notify()
        return replaced

    def drop(self) -> None:
        """
        Drop the waiting frame, stop those being processed, and return at once.

        The next frame starts when the work on the last one has ended, at the latest at its next
        check for a stop.
        """
        with self._changed:
            self._waiting, stops = None, self._stops
        for stop in stops:
            stop.set()

    def stop(self) -> None:
        """Drop all frames, accept no more, and return at once."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self.drop()

    def wait(self, timeout_s: float) -> bool:
        """Wait, after `stop`, for the work to end; return False after a timeout."""
        return self._thread.wait(timeout_s)

    def _run(self) -> None:
        finisher = Background(self._finish, 'frame_finisher')
        while (frame := self._take()) is not None:
            stop = self._stops[-1]
            finish = _under(stop, partial(self._begin, frame))
            del frame  # no reference while waiting
            self._begun.join()  # the frame before is finished
            if finish is not None and self._overlaps:
                self._begun.put(partial(_under, stop, finish))
            elif finish is not None:
                _under(stop, finish)
            del finish
        self._begun.put(None)
        finisher.wait()

    def _finish(self) -> None:
        """Finish frames, in the second thread."""
        while (finish := self._begun.get()) is not None:
            finish()
            del finish
            self._begun.task_done()

    def _take(self) -> Frame | None:
        """Wait for the next frame; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._waiting is not None)
            frame, self._waiting = self._waiting, None
            self._stops = (*self._stops[-1:], Stop())  # of the frame before too
            return None if self._ended else frame


def _under(stop: Stop, work: Callable[[], Result]) -> Result | None:
    """Return the result of some work; None if nobody waits for it any more."""
    try:
        with stop.applies():
            raise_if_stopped()
            return work()
    except Stopped:
        return None
