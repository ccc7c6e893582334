# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Calls of ~/detect; each is answered when a frame that arrived after it is processed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.task import Future
from std_srvs.srv import Trigger

from plane_detector.ros.inputs.synchronizer import stamp_text
from plane_detector.ros.outputs.frame import DetectedFrame

ANSWERED_WITHIN_S = 30.0
"""A call without a frame is answered after this time."""
_REMEMBERED = 8


@dataclass(frozen=True)
class _Call:
    after: int
    until_s: float
    future: Future


class FrameRequests:
    """
    Waiting calls; thread-safe for the executor and the worker.

    ``wake`` wakes the executor, so that it sends answers given by another thread.
    """

    def __init__(self, wake: Callable[[], None], clock: Callable[[], float] = time.monotonic):
        self._wake, self._clock = wake, clock
        self._lock = threading.Lock()
        self._calls: list[_Call] = []
        self._accepted: list[Any] = []
        self._count = 0

    @property
    def are_waiting(self) -> bool:
        """Whether there is a call for which no frame has been accepted yet."""
        with self._lock:
            return any(call.after == self._count for call in self._calls)

    def add(self) -> Future:
        """Request the next frame; the result of the future is (success, message)."""
        call = _Call(self._count, self._clock() + ANSWERED_WITHIN_S, Future())
        with self._lock:
            self._calls.append(call)
        return call.future

    def accept(self, frame: Any) -> None:
        """Note that a frame goes to the worker; it, or a newer one, answers all calls so far."""
        with self._lock:
            self._count += 1
            if self._calls:  # otherwise nobody asks for its number, and frames take memory
                self._accepted = [*self._accepted, (frame, self._count)][-_REMEMBERED:]

    def finish(self, frame: Any, success: bool, message: str) -> None:
        """Answer the calls for which this frame, or an earlier one, was accepted."""
        with self._lock:
            number = next((n for other, n in self._accepted if other is frame), 0)
        self._answer(lambda call: call.after < number, success, message)

    def expire(self, obstacle: str) -> None:
        """Answer the calls that have waited too long, or all if it is known why no frame comes."""
        now_s = self._clock()
        if obstacle:
            self._answer(lambda _: True, False, f'no frame: {obstacle}')
        self._answer(lambda call: call.until_s <= now_s, False,
                     f'no frame within {ANSWERED_WITHIN_S:.0f} s')

    def refuse_all(self, reason: str) -> None:
        """Answer all calls: no frame will be processed."""
        self._answer(lambda _: True, False, reason)

    def _answer(self, is_due: Callable[[_Call], bool], success: bool, message: str) -> None:
        with self._lock:
            due = [call for call in self._calls if is_due(call)]
            self._calls = [call for call in self._calls if not is_due(call)]
            if not self._calls:
                self._accepted = []
        for call in due:
            call.future.set_result((success, message))
        if due:
            self._wake()


async def answer_trigger(response: Trigger.Response, future: Future) -> Trigger.Response:
    """Return the response of the service when its frame is finished."""
    response.success, response.message = await future
    return response


def describe_frame(result: DetectedFrame) -> str:
    """Return the answer to a call: number of planes and stamp of the image."""
    return f'{len(result.detection.planes)} planes in the image of {stamp_text(result)}'
