# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A subscriber of the node's outputs in a separate process, which only counts messages."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Sequence
from multiprocessing.connection import Connection

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from plane_detector.evaluation.benchmark.node_process import NODE
from plane_detector.process import retain_freed_memory
from plane_detector.ros.outputs.topics import OUTPUTS

RELIABLE = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
_SPIN_S = 0.05
_END_S = 5.0


class Receiver:
    """
    Receives outputs as bytes; a context manager.

    Bytes show the limit of the node itself: converting them to messages in Python would use the
    node's cores.

    Parameters
    ----------
    outputs : sequence of str
        Names of outputs.
    namespace : str
        Of the topics.

    """

    def __init__(self, outputs: Sequence[str], namespace: str = NODE) -> None:
        self._pipe, other = multiprocessing.Pipe()
        # A fork would share the threads and sockets of this process's middleware.
        self._process = multiprocessing.get_context('spawn').Process(
            target=_receive, args=(tuple(outputs), namespace, other), daemon=True)
        self._process.start()

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(_END_S)

    @property
    def process_id(self) -> int:
        """Of the operating system."""
        return self._process.pid

    def counts(self) -> Counter[str]:
        """Return how many messages of each output came since the last call."""
        self._pipe.send('counts')
        return self._pipe.recv()


def _receive(outputs: tuple[str, ...], namespace: str, pipe: Connection) -> None:
    """Count until the process is ended."""
    retain_freed_memory(one_heap=True)  # as the node; otherwise most of its time is page faults
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # SIGTERM ends it
    node, executor = rclpy.create_node('plane_detector_receiver'), SingleThreadedExecutor()
    executor.add_node(node)
    received: Counter[str] = Counter()
    for name in outputs:
        node.create_subscription(OUTPUTS[name].msg_type, f'{namespace}/{name}',
                                 lambda _, name=name: received.update([name]), RELIABLE, raw=True)
    while True:
        executor.spin_once(timeout_sec=_SPIN_S)
        if pipe.poll():
            pipe.recv()
            pipe.send(received.copy())
            received.clear()
