# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node as a process: signals, spinning, exit code."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from plane_detector.ros.allocator import keep_freed_memory

_SPIN_TIMEOUT_S = 0.2
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Interruption:
    """
    What SIGINT and SIGTERM do: they are noted, for the main thread to end when it comes to it.

    An exception that a signal raises anywhere is swallowed where it meets a destructor or an
    error handler, and gives a traceback where it meets the shutdown. So it is raised only where
    the main thread may stay for long; see `interruptible`.
    """

    def __init__(self) -> None:
        self.is_asked = False
        self.may_raise = False

    def ask(self, _number: int, _stack: Any) -> None:
        """Handle a signal; a second one changes nothing."""
        is_first, self.is_asked = not self.is_asked, True
        if is_first and self.may_raise:
            raise KeyboardInterrupt


_interruption = _Interruption()


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """
    Run a node until SIGINT or SIGTERM; once in a process.

    Both are taken by Python rather than by rclpy, so that they also end what takes long outside
    of the executor's wait; see `interruptible`.

    Parameters
    ----------
    make_node : callable
        Called once rclpy is initialised.
    args : list of str, optional
        The command line; sys.argv if not given.

    Returns
    -------
    int
        The exit code: 1 when the node cannot be made with these arguments, else 0.

    """
    for number in _SIGNALS:
        signal.signal(number, _interruption.ask)
    try:
        keep_freed_memory()
        _init(args)
        _spin(make_node())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (ValueError, ParameterException) as error:
        print(f'the node cannot start: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
        for number in _SIGNALS:  # the interpreter's end would put back that they kill
            signal.signal(number, signal.SIG_IGN)
    return 0


@contextmanager
def interruptible() -> Iterator[None]:
    """
    Let SIGINT and SIGTERM break off what takes long, the download of a network for example.

    For the main thread of `run`; without it nothing changes.

    Raises
    ------
    KeyboardInterrupt
        From anywhere within, or at once when the signal came before.

    """
    try:
        _interruption.may_raise = True
        if _interruption.is_asked:
            raise KeyboardInterrupt
        yield
    finally:
        _interruption.may_raise = False


def answer_impossible_transitions(node: LifecycleNode) -> None:
    """Let a transition that the state does not allow fail; in rclpy it would end the process."""
    def guarded(callback: Callable[..., Any]) -> Callable[..., Any]:
        def answer(request: ChangeState.Request, response: ChangeState.Response):
            try:
                return callback(request, response)
            except RuntimeError as error:
                node.get_logger().error(f'transition refused: {error}')
                response.success = False
                return response
        return answer

    for service in node.services:
        if service.srv_type is ChangeState:
            service.callback = guarded(service.callback)


def _init(args: list[str] | None) -> None:
    """Initialise rclpy; raise ValueError where it does not understand the command line."""
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # the base of rclpy's own, which it does not export
        raise ValueError(f'rclpy refuses the arguments: {error}') from error


def _spin(node: Node) -> None:
    """Spin until a signal, in short waits: Python handles signals only between them."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok() and not _interruption.is_asked:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT_S)
    finally:
        node.destroy_node()
        executor.shutdown()
