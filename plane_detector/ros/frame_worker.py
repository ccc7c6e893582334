# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The thread that works on frames, and the single place where the next one waits."""

from __future__ import annotations

import threading
from collections.abc import Callable

from plane_detector.ros.inputs.synchronizer import Frame


class FrameWorker:
    """
    Works on one frame at a time; the freshest one wins.

    While a frame is worked on, one more may wait; a newer one takes its place. So a slow network
    never queues, and receiving goes on.

    Parameters
    ----------
    work : callable
        Called in the thread with each frame; must not raise.

    """

    def __init__(self, work: Callable[[Frame], None]):
        self._work = work
        self._changed = threading.Condition()
        self._waiting: Frame | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name='frame_worker', daemon=True)
        self._thread.start()

    def put(self, frame: Frame) -> bool:
        """Leave a frame; return whether it replaced one that still waited."""
        with self._changed:
            replaced = self._waiting is not None
            self._waiting = frame
            self._changed.notify()
            return replaced

    def stop(self) -> None:
        """Drop the frame that waits, and return when the one that is worked on is done."""
        with self._changed:
            self._stopped = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while (frame := self._take()) is not None:
            self._work(frame)

    def _take(self) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._waiting is not None)
            frame, self._waiting = self._waiting, None
            return None if self._stopped else frame
