# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The publishers of the node: one per output of the table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

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
        # at all its other entities. `misfits` finds what they would report.
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        self._publishers = {name: node.create_lifecycle_publisher(
            output.msg_type, f'~/{name}', qos.output_profile(), event_callbacks=silent,
            qos_overriding_options=qos.overriding_options()) for name, output in OUTPUTS.items()}

    def wanted(self) -> list[str]:
        """Return the names of the outputs that have subscribers."""
        return [name for name, publisher in self._publishers.items()
                if publisher.get_subscription_count()]

    def publish(self, messages: Mapping[str, Any]) -> None:
        """Publish messages by the names of their outputs."""
        for name, msg in messages.items():
            self._publishers[name].publish(msg)

    def misfits(self) -> dict[str, str]:
        """Return why subscribers receive nothing, by topic and node: their QoS does not fit."""
        found: dict[str, str] = {}
        for publisher in self._publishers.values():
            topic = publisher.topic_name
            if self._node.count_subscribers(topic) <= publisher.get_subscription_count():
                continue
            for info in self._node.get_subscriptions_info_by_topic(topic):
                if reason := self._misfit(topic, info):
                    reader = f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                    found[f'{topic} {reader}'] = (
                        f'{reader} subscribes to {topic}, but receives nothing, because its QoS '
                        f'does not fit ({reason}): change it there, or here by the '
                        'qos_overrides parameters')
        return found

    def _misfit(self, topic: str, reader: TopicEndpointInfo) -> str:
        """Return why a subscriber cannot receive what this node publishes; empty if it can."""
        own = self._node.get_name(), self._node.get_namespace()
        # From the graph: the profile of the publisher itself has placeholders for its defaults.
        for info in self._node.get_publishers_info_by_topic(topic):
            if (info.node_name, info.node_namespace) == own:
                fits, reason = qos_check_compatible(info.qos_profile, reader.qos_profile)
                return _plain(reason) if fits == QoSCompatibility.ERROR else ''
        return ''

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)


def _plain(reason: str) -> str:
    """Return the reasons of rclpy, "ERROR: This and that;ERROR: ...", as part of a sentence."""
    return ', '.join(part.removeprefix('ERROR: ').lower() for part in reason.split(';')
                     if part.startswith('ERROR: '))
