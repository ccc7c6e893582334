# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Calls of ~/detect: each is answered when a frame that came after it is done."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import Trigger

ANSWERED_WITHIN_S = 30.0
"""A call that no frame comes for is answered then."""
_REMEMBERED = 8


@dataclass(frozen=True)
class _Call:
    after: int
    until_s: float
    future: Future


class FrameRequests:
    """
    Waiting calls; the executor's thread and the worker may use it at once.

    Parameters
    ----------
    wake : callable
        Lets the executor look at answers that another thread has given.
    clock : callable
        Seconds that only grow.

    """

    def __init__(self, wake: Callable[[], None], clock: Callable[[], float] = time.monotonic):
        self._wake, self._clock = wake, clock
        self._lock = threading.Lock()
        self._calls: list[_Call] = []
        self._accepted: list[Any] = []
        self._count = 0

    @property
    def are_waiting(self) -> bool:
        """Whether a frame is asked for that has not been accepted yet."""
        with self._lock:
            return any(call.after == self._count for call in self._calls)

    def add(self) -> Future:
        """Ask for the next frame; the future's result is (success, message)."""
        call = _Call(self._count, self._clock() + ANSWERED_WITHIN_S, Future())
        with self._lock:
            self._calls.append(call)
        return call.future

    def accept(self, frame: Any) -> None:
        """Note that a frame goes to the worker, which answers all calls so far or a newer does."""
        with self._lock:
            self._count += 1
            self._accepted = [*self._accepted, (frame, self._count)][-_REMEMBERED:]

    def finish(self, frame: Any, success: bool, message: str) -> None:
        """Answer the calls that this frame was accepted for, or an earlier one."""
        with self._lock:
            number = next((n for other, n in self._accepted if other is frame), 0)
        self._answer(lambda call: call.after < number, success, message)

    def expire(self, reason: str) -> None:
        """Answer the calls that have waited too long."""
        now_s = self._clock()
        self._answer(lambda call: call.until_s <= now_s, False,
                     f'no frame within {ANSWERED_WITHIN_S:.0f} s' + (reason and f': {reason}'))

    def refuse_all(self, reason: str) -> None:
        """Answer all calls: no frame will be done."""
        self._answer(lambda _: True, False, reason)

    def _answer(self, is_due: Callable[[_Call], bool], success: bool, message: str) -> None:
        with self._lock:
            due = [call for call in self._calls if is_due(call)]
            self._calls = [call for call in self._calls if not is_due(call)]
        for call in due:
            call.future.set_result((success, message))
        if due:
            self._wake()


async def answer_trigger(response: Trigger.Response, future: Future) -> Trigger.Response:
    """Return the response of the service once its frame is done."""
    response.success, response.message = await future
    return response


def describe_frame(header: Header, plane_count: int) -> str:
    """Return the answer to a call: number of planes and stamp of the image."""
    return (f'{plane_count} planes in the image of {header.stamp.sec}.'
            f'{header.stamp.nanosec:09d}')
