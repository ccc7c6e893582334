# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node with a stand-in for tf2_ros, which has no wheel: transforms come on a topic, singly."""

from __future__ import annotations

import sys
import threading
from types import SimpleNamespace
from typing import Any

from geometry_msgs.msg import TransformStamped

from plane_detector.ros.inputs.transforms import TransformBuffer, TransformError
from plane_detector.ros.node import main

TOPIC = 'tf_of_benchmark'


class _Buffer(TransformBuffer):
    """Waits for a transform, as that of tf2_ros."""

    def __init__(self) -> None:
        super().__init__()
        self._arrival = threading.Condition()

    def add(self, msg: TransformStamped, is_static: bool = False) -> None:
        with self._arrival:
            super().add(msg, is_static)
            self._arrival.notify_all()

    def lookup_transform(self, target_frame: str, source_frame: str, time: Any, timeout: Any
                         ) -> TransformStamped:
        def looked_up() -> TransformStamped | None:
            try:
                return TransformBuffer.lookup_transform(self, target_frame, source_frame, time)
            except TransformError:
                return None
        with self._arrival:
            found = self._arrival.wait_for(looked_up, 1e-9 * timeout.nanoseconds)
        if found is None:
            raise TransformError('it has not arrived')
        return found


def _listener(buffer: _Buffer, node: Any) -> SimpleNamespace:
    subscription = node.create_subscription(TransformStamped, TOPIC, buffer.add, 100)
    return SimpleNamespace(unregister=lambda: node.destroy_subscription(subscription))


if __name__ == '__main__':
    sys.modules['tf2_ros'] = SimpleNamespace(Buffer=_Buffer, TransformListener=_listener)
    sys.exit(main())
