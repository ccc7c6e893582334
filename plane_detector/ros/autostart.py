# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Configure and activate without a lifecycle manager; retries if that can help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import TransitionCallbackReturn

from plane_detector.ros.spinning import CannotRunError
from plane_detector.ros.transitions import Transitions

# derived: an unreachable host is tried again as often as a user would, then less and less often.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 5.0, 300.0
_PAUSE_FACTOR = 2.0


class Autostart:
    """
    Brings a lifecycle node to the active state.

    Parameters
    ----------
    node : rclpy.lifecycle.LifecycleNode
        With the attribute ``state``.
    transitions : Transitions
        Of this node.
    may_pass : callable
        Whether the cause of the last failure may be temporary: an unreachable host, but not a
        wrong setting.
    exits : bool
        Raise at the first failure instead of retrying.

    """

    def __init__(self, node: Any, transitions: Transitions, may_pass: Callable[[], bool],
                 exits: bool):
        self._node, self._transitions = node, transitions
        self._may_pass, self._exits = may_pass, exits
        self._pause_s = FIRST_PAUSE_S
        self._wait(0.0)

    def _wait(self, pause_s: float) -> None:
        """Try after a pause by the steady clock, because simulation time may stand still."""
        self._timer = self._node.create_timer(
            pause_s, self._try, self._transitions.group, Clock(clock_type=ClockType.STEADY_TIME))

    async def _try(self) -> None:
        """
        Configure and activate, unless the node has been configured by others in the meantime.

        Raises
        ------
        CannotRunError
            It failed and ``exits`` is true; this ends the spinning of the executor.

        """
        self._node.destroy_timer(self._timer)
        if self._node.state != 'unconfigured':
            return
        if (await self._transitions.configure() == TransitionCallbackReturn.SUCCESS
                and self._node.trigger_activate() == TransitionCallbackReturn.SUCCESS):
            return
        if self._exits:
            raise CannotRunError('it failed, for the reason logged, and exit_on_failure is true')
        if self._node.state == 'unconfigured' and self._may_pass():
            self._node.get_logger().info(f'trying again in {self._pause_s:.0f} s')
            self._wait(self._pause_s)
            self._pause_s = min(_PAUSE_FACTOR * self._pause_s, LONGEST_PAUSE_S)
