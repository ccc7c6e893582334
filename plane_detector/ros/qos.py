# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions


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


def output_profile(latched: bool = False) -> QoSProfile:
    """Return the profile of the outputs: reliable, short queue; latched: the last one is kept."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1 if latched else 2, reliability=ReliabilityPolicy.RELIABLE,
                      durability=durability)
