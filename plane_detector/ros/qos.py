# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service: what is asked of the inputs and offered on the outputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions

_RELIABILITY = {'auto': ReliabilityPolicy.BEST_AVAILABLE,
                'reliable': ReliabilityPolicy.RELIABLE,
                'best_effort': ReliabilityPolicy.BEST_EFFORT}


def overriding_options() -> QoSOverridingOptions:
    """Return which policies of an endpoint the qos_overrides parameters may change."""
    return QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH,
                                 QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY))


def output_profile() -> QoSProfile:
    """Return the profile of the outputs: reliable, a short queue."""
    return QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)


class InputSubscription:
    """
    A subscription that keeps the last message only and can follow its publishers.

    With reliability ``auto`` the middleware takes what the publishers offer when the
    subscription is made: reliable where all of them are. When a publisher turns up later that
    this does not fit, or the last best-effort one leaves, the subscription is made anew.
    """

    def __init__(self, node: Node, msg_type: Any, topic: str, callback: Callable[[Any], None],
                 reliability: str):
        self._node = node
        self._arguments = msg_type, topic, callback
        self._wanted = _RELIABILITY[reliability]
        self._subscribe()

    @property
    def topic(self) -> str:
        """The resolved name."""
        return self._subscription.topic_name

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self) -> None:
        events = SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible,
                                            matched=self._on_matched)
        self._subscription = self._node.create_subscription(
            *self._arguments, QoSProfile(depth=1, reliability=self._wanted),
            event_callbacks=events, qos_overriding_options=overriding_options())
        self._reliable = self._all_reliable()

    def _follows(self) -> bool:
        """An override may have replaced ``auto``, then it stands."""
        return self._subscription.qos_profile.reliability == ReliabilityPolicy.BEST_AVAILABLE

    def _all_reliable(self) -> bool:
        infos = self._node.get_publishers_info_by_topic(self.topic)
        return all(i.qos_profile.reliability == ReliabilityPolicy.RELIABLE for i in infos)

    def _on_incompatible(self, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if self._follows() and policy == 'RELIABILITY':
            self._resubscribe()
        else:
            self._node.get_logger().warning(
                f'a publisher of {self.topic} offers another {policy} than this node asks for: '
                'nothing will be received from it; see the qos_overrides parameters')

    def _on_matched(self, _event: Any) -> None:
        if self._follows() and self._all_reliable() != self._reliable:
            self._resubscribe()

    def _resubscribe(self) -> None:
        self.destroy()
        self._subscribe()
        offer = 'reliable' if self._reliable else 'best effort'
        self._node.get_logger().info(f'subscribed to {self.topic} anew, {offer} as its publishers')
