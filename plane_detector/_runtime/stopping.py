# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Work that another thread can stop.

Python cannot end a thread. Long work therefore runs under a `Stop`, and either checks it between
its steps (`raise_if_stopped`) or registers a callback that interrupts it (`Stop.calling`). C++
code that does neither keeps running; :mod:`plane_detector._runtime.ending` ends its process.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Generic, TypeVar

Result = TypeVar('Result')


class Stopped(BaseException):
    """The work was asked to stop. Not an Exception, so that no error handler catches it."""


class Stop:
    """
    A request to end a piece of work.

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
        """Request the stop; waits only while a block of `uncut` runs."""
        with self._lock:
            if self.is_set:
                return
            self.is_set = True
            callbacks = tuple(self._callbacks)
        for callback in callbacks:
            callback()

    @contextmanager
    def applies(self) -> Iterator[None]:
        """Make :func:`raise_if_stopped` check this stop in this block and thread."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    @contextmanager
    def calling(self, callback: Callable[[], None]) -> Iterator[None]:
        """
        Call a function when the stop is requested while this block runs, in the requesting thread.

        Raises
        ------
        Stopped
            The stop was requested before.

        """
        self._callbacks.append(callback)  # first: a signal handler may set the stop at any line
        try:
            if self.is_set:
                raise Stopped
            yield
        finally:
            self._callbacks.remove(callback)

    @contextmanager
    def uncut(self) -> Iterator[None]:
        """
        Run a block completely or not at all: `set` waits until it ends.

        Raises
        ------
        Stopped
            The stop was requested before.

        """
        with self._lock:
            if self.is_set:
                raise Stopped
            yield


_current: ContextVar[Stop] = ContextVar('stop')
_NEVER = Stop()


def current_stop() -> Stop:
    """Return the stop that applies in this context."""
    return _current.get(_NEVER)


def raise_if_stopped() -> None:
    """
    Raise if the current work was asked to stop; for the loops of long computations.

    Raises
    ------
    Stopped

    """
    if current_stop().is_set:
        raise Stopped


class Background(Generic[Result]):
    """
    A call in its own thread, which does not keep the process alive.

    Parameters
    ----------
    function : callable
        Called in the thread; the attribute `stop` applies to it.
    name : str
        Name of the thread.
    on_end : callable, optional
        Called in the thread when the result is available.

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
        """Return whether the thread of any instance is still running."""
        return any(call._thread.is_alive() for call in tuple(cls._running))

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the end of the thread; return False after a timeout."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def result(self) -> Result:
        """Wait for the end; return the result of the function, or raise its exception."""
        self.wait()
        if self._error is not None:
            raise self._error
        return self._result

    def _run(self, function: Callable[[], Result]) -> None:
        try:
            with self.stop.applies():
                self._result = function()
        except BaseException as error:  # raised again by result()
            self._error = error
        finally:
            self._running.discard(self)
            self._on_end()
