# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A subscriber of the node's outputs in a separate process, which only looks at their stamps."""

from __future__ import annotations

import multiprocessing
import struct
import time
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
_STAMP_AT = 4  # derived: after the header of CDR, the stamp is the first field


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
        self.outputs = tuple(outputs)
        self._pipe, other = multiprocessing.Pipe()
        # A fork would share the threads and sockets of this process's middleware.
        self._process = multiprocessing.get_context('spawn').Process(
            target=_receive, args=(self.outputs, namespace, other), daemon=True)
        self._process.start()

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(_END_S)

    def taken(self) -> list[float]:
        """Return the time in ms from stamp to receipt of all ``~/planes`` since the last call."""
        self._pipe.send('taken')
        return self._pipe.recv()


def _receive(outputs: tuple[str, ...], namespace: str, pipe: Connection) -> None:
    """Receive until the process is ended."""
    retain_freed_memory(one_heap=True)  # as the node; otherwise most of its time is page faults
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # SIGTERM ends it
    node, executor = rclpy.create_node('plane_detector_receiver'), SingleThreadedExecutor()
    executor.add_node(node)
    latencies_ms: list[float] = []

    def receive_planes(data: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', data, _STAMP_AT)
        latencies_ms.append((time.time_ns() - nanoseconds) / 1e6 - 1e3 * seconds)
    for name in outputs:
        callback = receive_planes if name == 'planes' else lambda _: None
        node.create_subscription(OUTPUTS[name].msg_type, f'{namespace}/{name}', callback, RELIABLE,
                                 raw=True)
    while True:
        executor.spin_once(timeout_sec=_SPIN_S)
        if pipe.poll():
            pipe.recv()
            pipe.send(latencies_ms.copy())
            latencies_ms.clear()
