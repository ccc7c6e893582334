# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The publishers of the node: one per output of the table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode

from plane_detector.ros import qos
from plane_detector.ros.outputs.topics import OUTPUTS


class OutputPublishers:
    """
    Creates the publishers of a lifecycle node.

    Parameters
    ----------
    node : LifecycleNode

    """

    def __init__(self, node: LifecycleNode):
        self._node = node
        # The executor would look at two events of each publisher before every message: as long as
        # at all its other entities. A subscriber reports a QoS that does not fit, too.
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        self._publishers = {name: node.create_lifecycle_publisher(
            output.msg_type, f'~/{name}', qos.output_profile(), event_callbacks=silent,
            qos_overriding_options=qos.overriding_options()) for name, output in OUTPUTS.items()}

    def wanted(self) -> list[str]:
        """Return the names of the outputs that have subscribers."""
        return [name for name, publisher in self._publishers.items()
                if publisher.get_subscription_count()]

    def publish(self, messages: Mapping[str, Any]) -> None:
        """Publish messages, some of them serialised, by the names of their outputs."""
        for name, msg in messages.items():
            self._publishers[name].publish(msg)

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)
