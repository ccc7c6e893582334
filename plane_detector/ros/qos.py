# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from plane_detector.ros.spinning import InputGroup

_RELIABILITY = {'auto': ReliabilityPolicy.BEST_AVAILABLE,
                'reliable': ReliabilityPolicy.RELIABLE,
                'best_effort': ReliabilityPolicy.BEST_EFFORT}


def overriding_options(settle: Callable[[QoSProfile], SetParametersResult] | None = None
                       ) -> QoSOverridingOptions:
    """
    Return the policies of an endpoint that the qos_overrides parameters may change.

    ``settle`` is called with the profile after these parameters are applied; may change or reject
    it.
    """
    return QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH,
                                 QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY),
                                callback=settle)


def output_profile() -> QoSProfile:
    """Return the profile of the outputs: reliable, short queue."""
    return QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)


class InputSubscription:
    """
    A subscription that keeps the last message and can adapt to its publishers.

    With reliability ``auto`` it starts compatible with every publisher: best effort if none is
    known, reliable if all of them are. When `follow` finds that they have changed, it creates a
    second subscription with the other reliability, and the first one is destroyed when the second
    has received a message, so that no message is lost in between.
    """

    def __init__(self, node: Node, msg_type: Any, topic: str, callback: Callable[[Any], None],
                 reliability: str):
        self._node = node
        self._arguments = msg_type, topic
        self._callback = callback
        self._wanted = _RELIABILITY[reliability]
        self._follows = False
        self._last_sent_ns = 0
        self.topic = node.resolve_topic_name(topic)
        self._next: Subscription | None = None
        self._current = self._subscribe(self._on_message)

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._destroy_next()
        self._node.destroy_subscription(self._current)

    def follow(self) -> None:
        """Adapt to the publishers of now; to be called from time to time."""
        if not self._follows:
            return
        offered = self._offered()
        if self._next is not None and self._next.qos_profile.reliability == offered:
            return
        self._destroy_next()
        if self._current.qos_profile.reliability != offered:
            self._next = self._subscribe(self._on_first_of_next)

    def _subscribe(self, callback: Callable[..., None]) -> Subscription:
        # The executor would look at each event before every message: a quarter of its time.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        return self._node.create_subscription(
            *self._arguments, callback, QoSProfile(depth=1, reliability=self._wanted),
            event_callbacks=silent, callback_group=InputGroup(),
            qos_overriding_options=overriding_options(self._settle))

    def _settle(self, profile: QoSProfile) -> SetParametersResult:
        """Replace ``auto``, unless overridden, before the subscription is created."""
        self._follows = profile.reliability == ReliabilityPolicy.BEST_AVAILABLE
        if self._follows:
            profile.reliability = self._offered()
        return SetParametersResult(successful=True)

    def _offered(self) -> ReliabilityPolicy:
        """Return the strongest reliability compatible with all publishers, present and future."""
        infos = self._node.get_publishers_info_by_topic(self.topic)
        if infos and all(i.qos_profile.reliability == ReliabilityPolicy.RELIABLE for i in infos):
            return ReliabilityPolicy.RELIABLE
        return ReliabilityPolicy.BEST_EFFORT

    def _on_message(self, msg: Any, info: Mapping[str, int]) -> None:
        self._last_sent_ns = info['source_timestamp']
        self._callback(msg)

    def _on_first_of_next(self, msg: Any, info: Mapping[str, int]) -> None:
        """Destroy the first subscription, which may already have delivered this message."""
        self._node.destroy_subscription(self._current)
        self._current, self._next = self._next, None
        self._current.callback = self._on_message
        if info['source_timestamp'] != self._last_sent_ns:
            self._on_message(msg, info)

    def _destroy_next(self) -> None:
        if self._next is not None:
            self._node.destroy_subscription(self._next)
            self._next = None
