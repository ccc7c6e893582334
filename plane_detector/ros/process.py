# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node as a process: signals, spinning, exit code."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from plane_detector.ros.memory import keep_freed_memory

_SPIN_TIMEOUT_S = 0.2


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """
    Run a node until SIGINT or SIGTERM.

    Both are taken by Python rather than by rclpy, so that they also end what takes long outside
    of the executor's wait, the download of a network for example.

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
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _interrupt)
        keep_freed_memory()
        _init(args)
        _spin(make_node())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        # Within a call of rclpy to C the interrupt comes out as another error.
        if not _is_interrupted():
            if not isinstance(error, (ValueError, ParameterException)):
                raise
            print(f'the node cannot start: {error}', file=sys.stderr)
            return 1
    finally:
        rclpy.try_shutdown()
    return 0


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


def _interrupt(_number: int, _stack: Any) -> None:
    """End the process once, whatever the main thread is at; a second signal changes nothing."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _is_interrupted() -> bool:
    """Say whether a signal was taken: from then on they are ignored."""
    return signal.getsignal(signal.SIGTERM) is signal.SIG_IGN


def _spin(node: Node) -> None:
    """Spin in short waits: Python handles signals only between them."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT_S)
    finally:
        node.destroy_node()
        executor.shutdown()
