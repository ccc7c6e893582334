# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM end a replay between two frames, or abandon a frame that takes too long."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from plane_detector.stopping import Background, Stopped

Result = TypeVar('Result')
ShouldStop = Callable[[], bool]
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LOOK_S = 0.1
# derived: the bag is closed within 3 s of the signal, and closing it takes under a second.
_PATIENCE_S = 1.5


@contextmanager
def stop_on_signal(on_signal: Callable[[], None] = lambda: None) -> Iterator[ShouldStop]:
    """Yield a function that tells whether SIGINT or SIGTERM came; a second one exits at once."""
    came: list[int] = []

    def remember(number: int, _stack: object) -> None:
        came.append(number)
        for handled in _SIGNALS:
            signal.signal(handled, before[handled] if callable(before[handled])
                          else signal.SIG_DFL)
        on_signal()

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {number: signal.signal(number, remember) for number in _SIGNALS}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def until_stopped(function: Callable[[], Result], should_stop: ShouldStop) -> Result:
    """
    Return the result of a function; after a stop request, wait for at most 1.5 s.

    Raises
    ------
    Stopped
        It was abandoned, and may still run in its thread: see
        :func:`plane_detector.stopping.leave`.

    """
    call = Background(function, 'replay')
    while not call.wait(_LOOK_S):
        if should_stop():
            call.stop.set()
            if not call.wait(_PATIENCE_S):
                raise Stopped
    return call.result()
