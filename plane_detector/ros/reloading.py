# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node whose parameters can be loaded from a `ros2 param dump`."""

from __future__ import annotations

from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter


class ReloadableNode(LifecycleNode):
    """
    A lifecycle node whose read-only parameters may be set to their current values.

    `ros2 param load` sets everything that `ros2 param dump` has written, including qos_overrides,
    which rclpy declares as read-only; without this class it would report a failure for each.
    """

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, all or none."""
        changed = [parameter for parameter in parameter_list if not self._has_fixed(parameter)]
        if parameter_list and not changed:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(changed)

    def _has_fixed(self, parameter: Parameter) -> bool:
        return (self.has_parameter(parameter.name)
                and self.describe_parameter(parameter.name).read_only
                and self.get_parameter(parameter.name).value == parameter.value)
