# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

# chosen: more calls than anybody makes at the same time; those above MOST_CALLS are refused.
_CALLS = 256

SILENT_PUBLISHER = PublisherEventCallbacks(use_default_callbacks=False)
SILENT_SUBSCRIPTION = SubscriptionEventCallbacks(use_default_callbacks=False)
"""
Endpoints without events: the executor would check two events of each endpoint before every
message, which takes as long as all its other entities. `OutputPublishers.misfits` finds what they
would report.
"""


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


def service_profile() -> QoSProfile:
    """
    Return the profile of services, requests and answers.

    If there are more calls at the same time than its depth, some are never answered.
    """
    return QoSProfile(depth=_CALLS, reliability=ReliabilityPolicy.RELIABLE)


def output_profile(latched: bool = False) -> QoSProfile:
    """Return the profile of the outputs: reliable, short queue; latched: the last one is kept."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1 if latched else 2, reliability=ReliabilityPolicy.RELIABLE,
                      durability=durability)
