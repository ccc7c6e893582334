# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
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


def output_profile() -> QoSProfile:
    """Return the profile of the outputs: reliable, short queue."""
    return QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
