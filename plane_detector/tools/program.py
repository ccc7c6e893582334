# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How demo and replay end: with an exit code, one line on an error, and soon after a signal."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from typing import TypeVar

from plane_detector.stopping import Background, Stopped, leave

Result = TypeVar('Result')
FAILED, INTERRUPTED = 1, 130
_LOOK_S = 0.1
# derived: a program ends within 3 s of a signal; closing a bag takes under a second.
_PATIENCE_S = 1.5


def run_program(name: str, function: Callable[[], int],
                *expected: type[Exception]) -> int:
    """Return the exit code of a program; an expected error is told in one line."""
    try:
        return leave(function())
    except (KeyboardInterrupt, Stopped):
        return leave(INTERRUPTED)
    except (OSError, ValueError, ModuleNotFoundError, *expected) as error:
        print(f'{name}: {error}', file=sys.stderr)
        return leave(FAILED)


def until_signal(function: Callable[[], Result]) -> Result:
    """
    Return the result of a function; SIGINT or SIGTERM stops it, a second one ends the process.

    Raises
    ------
    Stopped
        It was stopped, or did not end within 1.5 s and may still run in its thread: see
        :func:`plane_detector.stopping.leave`.

    """
    call = Background(function, 'program')

    def stop(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        call.stop.set()

    # An ignored signal, as SIGINT under nohup, stays ignored.
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)
              if signal.getsignal(number) is not signal.SIG_IGN}
    try:
        while not call.wait(_LOOK_S):
            if call.stop.is_set and not call.wait(_PATIENCE_S):
                raise Stopped
        return call.result()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
