# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node as a process: it spins until a signal."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from typing import NoReturn

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from plane_detector._runtime.ending import end_process, stopped_by_signals
from plane_detector._runtime.process import retain_freed_memory, use_one_thread
from plane_detector._runtime.stopping import Stop
from plane_detector.ros.fault_log import FaultLog

_SPIN_S = 0.2
# Time after which a thread passes the interpreter to a waiting one. Every kernel releases it, so
# with Python's 5 ms the thread that finds planes waited for the thread that makes messages many
# times per frame. tuned: frames per second of all stages in one process on two loaded cores, 10.6
# at 5 ms, 14.2 at 1 ms, flat from 0.2 to 1 ms, with the same core time per frame.
_SWITCH_INTERVAL_S = 0.001
# Number of objects after which the garbage collector searches for cycles; frames leave none. The
# points of ~/markers exceed Python's 700 and would count as long-lived. tuned: time of the
# collector with all outputs, 1.5 ms a frame at 700, with a pause of .09 s in every 100 frames; .01
# ms and no pause from 5000 to 20000.
_COLLECTED_AFTER = 10_000


class CannotRunError(Exception):
    """Raised in a callback, it ends the node with exit code 1 and this reason."""


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> NoReturn:
    """
    Run a node, created when rclpy is initialised, until SIGINT or SIGTERM; once per process.

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
    gc.set_threshold(_COLLECTED_AFTER)
    # The stages share the cores. The threads of OpenCV and OpenBLAS spin while they wait for the
    # next operation, which costs 1 and 16 ms of core time per frame.
    use_one_thread()


def _init(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # base class of rclpy's exception, which it does not export
        hint = (', name another folder by ROS_LOG_DIR' if 'log directory' in str(error) else '')
        raise CannotRunError(f'rclpy refuses to start: {error}{hint}') from error


def _made(make_node: Callable[[], Node]) -> Node:
    try:
        return make_node()
    except ValueError as error:
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
    try:
        while rclpy.ok() and not stop.is_set:
            try:
                executor.spin_once(timeout_sec=_SPIN_S)
            except (CannotRunError, ExternalShutdownException):
                raise
            except Exception as error:
                faults.report_bug(error)
    finally:
        node.destroy_node()
        executor.shutdown()
