# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node that takes its own parameters back, as `ros2 param dump` writes them."""

from __future__ import annotations

from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter


class ReloadableNode(LifecycleNode):
    """
    A lifecycle node whose read-only parameters may be set to the value that they have.

    `ros2 param load` sets everything that `ros2 param dump` has written, the qos_overrides among
    it, which rclpy declares as read-only; without this, it reports a failure for each of them.
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
