# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The thread that works on frames, and the single place where the next one waits."""

from __future__ import annotations

import threading
from collections.abc import Callable

from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.stopping import Background, Stop, Stopped


class FrameWorker:
    """
    Works on one frame at a time; the freshest one wins.

    While a frame is worked on, one more may wait; a newer one takes its place. So a slow network
    never queues, and receiving goes on.

    Parameters
    ----------
    work : callable
        Called in the thread with each frame, under a stop of that frame; must not raise, but for
        Stopped.

    """

    def __init__(self, work: Callable[[Frame], None]):
        self._work = work
        self._changed = threading.Condition()
        self._waiting: Frame | None = None
        self._frame_stop = Stop()
        self._ended = False
        self._thread = Background(self._run, 'frame_worker')

    def put(self, frame: Frame) -> bool:
        """Leave a frame; return whether it replaced one that still waited."""
        with self._changed:
            replaced = self._waiting is not None
            self._waiting = frame
            self._changed.notify()
            return replaced

    def drop(self) -> None:
        """
        Give up the frame that waits and the one that is worked on, and return at once.

        The next frame is begun when the work on this one has come to its end or to where it looks
        at its stop.
        """
        with self._changed:
            self._waiting, stop = None, self._frame_stop
        stop.set()

    def stop(self) -> None:
        """Drop what there is, take no more frames, and return at once."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self.drop()

    def wait(self, timeout_s: float) -> bool:
        """Wait, after `stop`, for the work to end; return whether it has."""
        return self._thread.wait(timeout_s)

    def _run(self) -> None:
        while (taken := self._take()) is not None:
            frame, stop = taken
            try:
                with stop.applies():
                    self._work(frame)
            except Stopped:  # nobody waits for this frame any more
                pass
            del frame, taken  # nothing is kept while there is nothing to do

    def _take(self) -> tuple[Frame, Stop] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._waiting is not None)
            if self._ended:
                return None
            frame, self._waiting = self._waiting, None
            self._frame_stop = Stop()
            return frame, self._frame_stop
