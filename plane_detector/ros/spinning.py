# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node as a process: it spins until a signal, and takes the messages of its inputs."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, NoReturn

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from plane_detector.ending import end_process, stopped_by_signals
from plane_detector.process import load_numba_alone, retain_freed_memory, use_one_thread
from plane_detector.ros.fault_log import FaultLog
from plane_detector.stopping import Stop

_SPIN_S = 0.2
# Time after which a thread gives the interpreter to one that waits for it. Every compiled loop
# releases it, so with Python's 5 ms the stage of the planes waited for that of the messages many
# times in each frame. tuned: frames per second of all stages in one process on two loaded cores,
# 10.6 at 5 ms, 14.2 at 1 ms, flat from 0.2 to 1 ms, with the same core time per frame.
_SWITCH_INTERVAL_S = 0.001


class InputGroup(ReentrantCallbackGroup):
    """
    Of subscriptions to frequent messages, which `run` takes itself; any executor may too.

    Their callbacks have two arguments: the message and its info.

    An executor of rclpy builds a set of all 35 entities of the node before and after each message:
    with three messages an image, .8 ms of its core time.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_taken = False

    def can_execute(self, entity: Any) -> bool:
        """Return whether an executor may wait for a subscription."""
        return not self.is_taken


class CannotRunError(Exception):
    """Raised in a callback, it ends the node with exit code 1 and this reason."""


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> NoReturn:
    """
    Run a node, made when rclpy is initialised, until SIGINT or SIGTERM; once per process.

    An exception of a callback is logged with its traceback, and the node goes on.

    This function does not return: the process exits with code 1 if the node cannot be made with
    these arguments or raises `CannotRunError`, otherwise 0. The regular exit of the interpreter
    would take a second or more to unload all libraries, and crash if one of them is still running.
    """
    with stopped_by_signals() as stop:
        end_process(_exit_code(make_node, args, stop))


def _exit_code(make_node: Callable[[], Node], args: list[str] | None, stop: Stop) -> int:
    """Run a node until the stop."""
    try:
        prepare_process()
        _init(args)
        _spin(_made(make_node), stop)
    except ExternalShutdownException:
        pass
    except CannotRunError as error:
        print(f'the node cannot start: {error}', file=sys.stderr)
        return 1
    finally:
        _close_middleware()
    return 0


def prepare_process() -> None:
    """Set up memory and interpreter of this process for worker threads."""
    retain_freed_memory(one_heap=True)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    # The stages share the cores. The threads of OpenCV and OpenBLAS spin while they wait for the
    # next operation: measured 1 and 16 ms of core time for each frame.
    use_one_thread()
    load_numba_alone()


def _init(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # base class of rclpy's exception, which it does not export
        raise CannotRunError(f'rclpy refuses the arguments: {error}') from error


def _made(make_node: Callable[[], Node]) -> Node:
    try:
        return make_node()
    except (ValueError, ParameterException) as error:
        raise CannotRunError(str(error)) from error


def _close_middleware() -> None:
    """Shut rclpy down and release its shared memory."""
    context = rclpy.get_default_context()
    rclpy.try_shutdown()
    context.destroy()
    gc.collect()  # the node and its executor refer to each other


def _spin(node: Node, stop: Stop) -> None:
    """Spin until a signal, in short waits: Python handles signals only between them."""
    executor, faults = SingleThreadedExecutor(), FaultLog(node.get_logger(), 'error in a callback')
    executor.add_node(node)
    spun_s = 0.0
    try:
        while rclpy.ok() and not stop.is_set:
            inputs = [one for one in node.subscriptions
                      if isinstance(one.callback_group, InputGroup)]
            try:
                is_other_ready = not inputs or _take(node, inputs)
                if is_other_ready or time.monotonic() > spun_s + _SPIN_S:
                    executor.spin_once(timeout_sec=0 if inputs else _SPIN_S)
                    spun_s = time.monotonic()
            except (CannotRunError, ExternalShutdownException):
                raise
            except Exception as error:
                faults.tell_bug(error)
    finally:
        node.destroy_node()
        executor.shutdown()


def _take(node: Node, inputs: list[Subscription]) -> bool:
    """
    Wait for messages of the inputs and handle them; return whether the executor has work.

    The executor alone knows timers, and looks at them five times a second or more.
    """
    others = [one for one in node.subscriptions if one not in inputs]
    services, guards = list(node.services), list(node.guards)
    with ExitStack() as held:
        for entity in (*inputs, *others, *services, *guards, node.context):
            held.enter_context(entity.handle)
        ready = _rclpy.WaitSet(len(inputs) + len(others), len(guards), 0, 0, len(services), 0,
                               node.context.handle)
        ready.clear_entities()
        for subscription in (*inputs, *others):
            ready.add_subscription(subscription.handle)
        for service in services:
            ready.add_service(service.handle)
        for guard in guards:
            ready.add_guard_condition(guard.handle)
        ready.wait(round(1e9 * _SPIN_S))
        arrived = ready.get_ready_entities('subscription')
        for one in inputs:
            one.callback_group.is_taken = True
            if (one.handle.pointer in arrived
                    and (taken := one.handle.take_message(one.msg_type, one.raw)) is not None):
                one.callback(*taken)
        triggered = ready.get_ready_entities('guard_condition')
        for guard in guards:
            if guard.handle.pointer in triggered:
                guard.trigger()  # the wait has reset it
        return bool(triggered or ready.get_ready_entities('service')
                    or any(one.handle.pointer in arrived for one in others))
