# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Work that another thread can stop.

Python cannot end a thread. So whoever starts something long does it under a `Stop`, and what takes
long looks at it between its steps (`raise_if_stopped`) or says how it is broken off
(`Stop.calling`). C++ that does neither is left behind in its thread: `leave` then ends the process
without it.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Generic, NoReturn, TypeVar

Result = TypeVar('Result')


class Stopped(BaseException):
    """The work was told to stop. Not an Exception: no error handler takes it for a fault."""


class Stop:
    """
    The wish that a piece of work ends.

    Examples
    --------
    >>> stop = Stop()
    >>> with stop.applies():
    ...     raise_if_stopped()
    >>> stop.set()
    >>> stop.is_set
    True

    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # reentrant: a signal handler may set it anywhere
        self._callbacks: list[Callable[[], None]] = []
        self.is_set = False

    def set(self) -> None:
        """Ask the work to stop; waits only for what `uncut` holds together."""
        with self._lock:
            if self.is_set:
                return
            self.is_set = True
            callbacks = tuple(self._callbacks)
        for callback in callbacks:
            callback()

    @contextmanager
    def applies(self) -> Iterator[None]:
        """Let what runs within, in this thread, look at this stop."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    @contextmanager
    def calling(self, callback: Callable[[], None]) -> Iterator[None]:
        """
        Call a function when the stop is set while this block runs, from the thread that sets it.

        Raises
        ------
        Stopped
            It is set already.

        """
        with self.uncut():
            self._callbacks.append(callback)
        try:
            yield
        finally:
            self._callbacks.remove(callback)

    @contextmanager
    def uncut(self) -> Iterator[None]:
        """
        Hold together what must be done as a whole or not at all: meanwhile `set` waits.

        Raises
        ------
        Stopped
            It is set already.

        """
        with self._lock:
            if self.is_set:
                raise Stopped
            yield


_current: ContextVar[Stop] = ContextVar('stop')
_NEVER = Stop()


def current_stop() -> Stop:
    """Return the stop that applies here."""
    return _current.get(_NEVER)


def raise_if_stopped() -> None:
    """
    End what runs here if it was told to stop; for the loops of what may take long.

    Raises
    ------
    Stopped

    """
    if current_stop().is_set:
        raise Stopped


class Background(Generic[Result]):
    """
    A call in a thread of its own, which does not keep the process alive.

    Parameters
    ----------
    function : callable
        Called in the thread, under the attribute `stop`.
    name : str
        Of the thread.
    on_end : callable, optional
        Called in the thread once there is a result.

    """

    _running: set[Background] = set()

    def __init__(self, function: Callable[[], Result], name: str,
                 on_end: Callable[[], None] = lambda: None):
        self.stop = Stop()
        self._on_end = on_end
        self._result: Result | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, args=(function,), name=name, daemon=True)
        self._running.add(self)
        self._thread.start()

    @classmethod
    def is_any_running(cls) -> bool:
        """Return whether a thread of any of them has not ended yet."""
        return any(call._thread.is_alive() for call in tuple(cls._running))

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the end; return whether it has come."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def result(self) -> Result:
        """Wait for the end; return what the function returned, or raise what it raised."""
        self.wait()
        if self._error is not None:
            raise self._error
        return self._result

    def _run(self, function: Callable[[], Result]) -> None:
        try:
            with self.stop.applies():
                self._result = function()
        except BaseException as error:  # raised again where the result is asked for
            self._error = error
        finally:
            self._running.discard(self)
            self._on_end()


def leave(exit_code: int) -> int:
    """
    Return the exit code, or end the process with it now where work runs that cannot be stopped.

    Such work is in C++, which the ordinary end of the interpreter would cut off in a way that
    crashes. To be called last: files are closed, the middleware is shut down.
    """
    if Background.is_any_running():
        end_process(exit_code)
    return exit_code


def end_process(exit_code: int) -> NoReturn:
    """End the process now, without the ordinary end of the interpreter."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(exit_code)
