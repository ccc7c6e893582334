# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
How the node and the programs end: soon after a signal, quietly, with an exit code.

SIGINT and SIGTERM request a `Stop`, and the main thread ends at its next check. An exception
raised by a signal could be lost in a destructor or an error handler, or cause a traceback during
shutdown. If the main thread does not end in time, or at a second signal, another thread ends the
process. That thread needs the interpreter lock, which a C function that never returns may hold; in
that case a guard process, started beforehand, kills this one.
"""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn, TypeVar

from plane_detector._runtime.plain_text import plain
from plane_detector._runtime.stopping import Background, Stop, Stopped

Result = TypeVar('Result')
FAILED, INTERRUPTED = 1, 130
MOST_ENDING_S = 2.5
"""Longest time from the first signal to the end of the process."""
KILLED_LATER_S = 5
"""Time after `MOST_ENDING_S` until the process is killed, if no thread of it can run."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_OVER = b'\0'
_MOST_SHOWN = 10_000
# The guard passes on the bytes that Python's C code writes for each signal, until the process ends
# or reports that it is done.
_GUARD = """
import os, signal, sys
parent, kill_s = int(sys.argv[1]), int(sys.argv[2])

def kill(*_):
    if os.getppid() == parent:
        os.write(2, b'the process has not ended after a signal: it is killed\\n')
        os.kill(parent, signal.SIGKILL)

signal.signal(signal.SIGALRM, kill)
signal.signal(signal.SIGPIPE, signal.SIG_DFL)
while (number := os.read(0, 1)) > b'\\0':
    kill_s = kill_s and signal.alarm(kill_s)  # once
    os.write(1, number)
os.write(1, number)
"""


@contextmanager
def quiet_interrupt() -> Iterator[None]:
    """
    Let SIGINT end the process immediately, without a traceback, while this block imports a
    program.

    The imports take a second, and KeyboardInterrupt would be raised somewhere in them. This has no
    effect outside the main thread, or if SIGINT is already ignored or handled.
    """
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler):
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def stopped_by_signals() -> Iterator[Stop]:
    """
    Yield a stop that SIGINT and SIGTERM request while this block runs in the main thread.

    The process ends with 128 plus the number of the signal at a second signal, or if the block has
    not ended within `MOST_ENDING_S` of the first. An ignored signal, such as SIGINT under nohup,
    stays ignored.
    """
    stop, (signals, written) = Stop(), os.pipe()
    os.set_blocking(written, False)
    # Python's C code writes each signal to the pipe at once, whatever the main thread is doing.
    descriptor = signal.set_wakeup_fd(written, warn_on_full_buffer=False)
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in _SIGNALS
              if signal.getsignal(number) is not signal.SIG_IGN}
    guard = _start_guard(signals)
    watcher = threading.Thread(target=_watch, args=(guard.stdout.fileno(), stop), name='ending',
                               daemon=True)
    watcher.start()
    try:
        yield stop
    finally:
        signal.set_wakeup_fd(descriptor)
        os.write(written, _OVER)
        watcher.join()
        guard.stdout.close()
        guard.wait()
        os.close(written)
        os.close(signals)
        for number, handler in before.items():
            signal.signal(number, handler)


def _start_guard(signals: int) -> subprocess.Popen:
    """
    Start a process that kills this one if it does not end after a signal.

    It reads the signals from a pipe and passes them on to its standard output.
    """
    # It inherits the mask, because a signal to all processes of a terminal or service is not for
    # it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        return subprocess.Popen(
            [sys.executable, '-I', '-S', '-c', _GUARD, str(os.getpid()),
             str(math.ceil(MOST_ENDING_S + KILLED_LATER_S))],
            stdin=signals, stdout=subprocess.PIPE)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _watch(watched: int, stop: Stop) -> None:
    """Request the stop at the first signal; end the process at the second one or in time."""
    number = os.read(watched, 1)
    if number in (_OVER, b''):  # the guard has ended; the main thread still handles signals
        return
    # The main thread may be in C++ and never reach its handler; `set` may wait for `uncut` work.
    threading.Thread(target=stop.set, daemon=True).start()
    ready, _, _ = select.select([watched], [], [], MOST_ENDING_S)
    if not ready or os.read(watched, 1) != _OVER:
        os._exit(128 + number[0])


def until_signal(function: Callable[[], Result]) -> Result:
    """
    Return the result of a function, to which the stop of `stopped_by_signals` applies.

    Raises
    ------
    Stopped
        A signal stopped it.

    """
    with stopped_by_signals() as stop, stop.applies():
        return function()


def run_program(name: str, function: Callable[[], int],
                *expected: type[Exception]) -> int:
    """Return the exit code of a program; an expected error is printed without traceback."""
    try:
        return leave(function())
    except (KeyboardInterrupt, Stopped):
        return leave(INTERRUPTED)
    except (OSError, ValueError, ModuleNotFoundError, *expected) as error:
        lines = (plain(line, _MOST_SHOWN) for line in str(error).splitlines())
        print(f'{name}: ' + '\n'.join(lines), file=sys.stderr)
        return leave(FAILED)


def leave(exit_code: int) -> int:
    """
    Return the exit code, or end the process at once if work is running that cannot be stopped.

    Such work is in C++, and the regular shutdown of the interpreter would crash while it runs.
    Call this last, after files are closed and the middleware is shut down.
    """
    if Background.is_any_running():
        end_process(exit_code)
    return exit_code


def end_process(exit_code: int) -> NoReturn:
    """End the process at once, without the regular shutdown of the interpreter."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(exit_code)
