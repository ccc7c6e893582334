# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
A stand-in for tf2_ros, which is not in pip, as far as the node uses it.

tf2_msgs is not in pip either: /tf and /tf_static are of geometry_msgs/TransformStamped here.
"""

import threading
from functools import partial

from geometry_msgs.msg import TransformStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile

from plane_detector.ros.inputs.transforms import TransformBuffer, TransformError

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Buffer:
    """Transforms as they come; a lookup waits for them."""

    def __init__(self):
        self._changed, self._static = threading.Condition(), {}
        self._buffer = TransformBuffer()

    def add(self, msg, is_static):
        """Add a transform."""
        with self._changed:
            if is_static:
                self._static[msg.child_frame_id] = msg
            self._buffer.add(msg, is_static)
            self._changed.notify_all()

    def lookup_transform(self, target_frame, source_frame, time, timeout):
        """Return a transform, or raise after the timeout."""
        found = []

        def is_found():
            try:
                found.append(self._buffer.lookup_transform(target_frame, source_frame, time))
            except TransformError as error:
                return found.append(error)
            return True
        with self._changed:
            self._changed.wait_for(is_found, timeout.nanoseconds / 1e9)
        if isinstance(found[-1], Exception):
            raise found[-1]
        return found[-1]

    def clear(self):
        """Forget all but the static ones."""
        with self._changed:
            self._buffer = TransformBuffer()
            for msg in self._static.values():
                self._buffer.add(msg, True)


class TransformListener:
    """Adds what the node receives."""

    def __init__(self, buffer, node):
        self._node, group = node, ReentrantCallbackGroup()
        self._subscriptions = [
            node.create_subscription(TransformStamped, topic, partial(
                buffer.add, is_static=is_static), profile, callback_group=group)
            for topic, is_static, profile in (('/tf', False, 100), ('/tf_static', True, LATCHED))]

    def unregister(self):
        """Receive no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
