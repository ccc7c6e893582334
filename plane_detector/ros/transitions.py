# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Transitions of a lifecycle node: slow ones in a thread, invalid ones refused, autostart.

rclpy calls ``on_configure`` in the executor, which could neither answer services nor receive
messages while a network is downloaded and warmed up. Here this work runs in a thread while the
node is in the state ``configuring``, and the executor continues the transition when it is
finished.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.task import Future

from plane_detector._runtime.stopping import Background
from plane_detector.ros.spinning import CannotRunError

Prepared = TypeVar('Prepared')
# chosen: an unreachable host is retried as often as a user would, then less and less often.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 5.0, 300.0
_PAUSE_FACTOR = 2.0


class Transitions(Generic[Prepared]):
    """
    Answers the service ``~/change_state`` of a node instead of rclpy.

    ``prepare`` is the slow part of configuring, called in a thread; ``on_configure`` of the node
    must call `prepared`. Callbacks that call `configure` belong to ``group``: others run while
    they wait.
    """

    def __init__(self, node: LifecycleNode, prepare: Callable[[], Prepared]):
        self._node, self._prepare = node, prepare
        self._call: Background[Prepared] | None = None
        self.group = ReentrantCallbackGroup()
        for service in node.services:
            if service.srv_type is ChangeState:
                service.callback = self._answering(service.callback)
                service.callback_group = self.group
                self.group.add_entity(service)

    async def configure(self) -> TransitionCallbackReturn:
        """
        Do the same as ``trigger_configure`` of rclpy without blocking the executor.

        Raises RuntimeError if the state does not allow it.
        """
        machine = self._node._state_machine  # rclpy has no public name for it
        number, label = machine.current_state
        machine.trigger_transition_by_id(Transition.TRANSITION_CONFIGURE, True)
        done = Future()
        self._call = Background(self._prepare, 'configure', lambda: done.set_result(None))
        await done
        code = self._node.on_configure(LifecycleState(label=label, state_id=number))
        machine.trigger_transition_by_label(code.to_label(), True)
        return code

    def prepared(self) -> Prepared:
        """Return the result of the preparation, running it now if needed; raises its exception."""
        call = self._call or Background(self._prepare, 'configure')
        self._call = None
        return call.result()

    def stop(self) -> None:
        """Request that the preparation stops."""
        if self._call is not None:
            self._call.stop.set()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the preparation to end; return False after a timeout."""
        return self._call is None or self._call.wait(timeout_s)

    def _answering(self, by_rclpy: Callable[..., Any]) -> Callable[..., Any]:
        """Return the callback of the service; in rclpy's, an invalid one ends the process."""
        async def answer(request: ChangeState.Request, response: ChangeState.Response):
            try:
                if not _asks_to_configure(request.transition):
                    return by_rclpy(request, response)
                response.success = await self.configure() == TransitionCallbackReturn.SUCCESS
            except RuntimeError as error:
                self._node.get_logger().error(f'transition refused: {error}')
                response.success = False
            return response
        return answer


class Autostart:
    """
    Brings a lifecycle node to the active state without a lifecycle manager.

    ``may_pass`` returns whether the cause of the last failure may be temporary: an unreachable
    host, but not a wrong setting. If it ``exits``, it raises at the first failure instead of
    retrying.
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

        Raises CannotRunError if it failed and ``exits``; this ends the spinning of the executor.
        """
        self._node.destroy_timer(self._timer)
        if self._node.state != 'unconfigured':
            return
        if (await self._transitions.configure() == TransitionCallbackReturn.SUCCESS
                and self._node.trigger_activate() == TransitionCallbackReturn.SUCCESS):
            return
        if self._exits:
            raise CannotRunError('it failed for the logged reason, and exit_on_failure is true')
        if self._node.state == 'unconfigured' and self._may_pass():
            self._node.get_logger().info(f'trying again in {self._pause_s:.0f} s')
            self._wait(self._pause_s)
            self._pause_s = min(_PAUSE_FACTOR * self._pause_s, LONGEST_PAUSE_S)


def _asks_to_configure(transition: Transition) -> bool:
    """Return whether the transition is configure, by its label, or else by its number."""
    if transition.label:
        return transition.label == 'configure'
    return transition.id == Transition.TRANSITION_CONFIGURE
