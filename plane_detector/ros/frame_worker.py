# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The thread that processes frames, and the place of the frame that waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.stopping import Background, Stop, Stopped


class FrameWorker:
    """
    Processes one frame at a time; one more may wait, and a newer one replaces it.

    Parameters
    ----------
    work : callable
        Called in the thread with each frame, under a stop for it. Must not raise, except Stopped.

    """

    def __init__(self, work: Callable[[Frame], None]):
        self._work = work
        self._changed = threading.Condition()
        self._waiting: Frame | None = None
        self._stop = Stop()
        self._ended = False
        self._thread = Background(self._run, 'frame_worker')

    def put(self, frame: Frame) -> bool:
        """Set the next frame; return whether it replaced one that was waiting."""
        with self._changed:
            replaced, self._waiting = self._waiting is not None, frame
            self._changed.notify()
        return replaced

    def drop(self) -> None:
        """
        Drop the waiting frame, stop the one being processed, and return at once.

        The next frame starts when the work on the last one has ended, at the latest at its next
        check for a stop.
        """
        with self._changed:
            self._waiting, stop = None, self._stop
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
        while (frame := self._take()) is not None:
            try:
                with self._stop.applies():
                    self._work(frame)
            except Stopped:  # nobody waits for this frame any more
                pass
            del frame  # no reference while waiting

    def _take(self) -> Frame | None:
        """Wait for the next frame; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._waiting is not None)
            frame, self._waiting = self._waiting, None
            self._stop = Stop()
            return None if self._ended else frame
