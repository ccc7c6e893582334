# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Transitions of a lifecycle node: slow ones beside the executor, impossible ones answered.

rclpy calls ``on_configure`` in the executor, which could neither answer a service nor receive a
message while a network is fetched and warmed up. Here that is done in a thread while the node is
in the state ``configuring``, and the executor comes back to it when it is done.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.task import Future

from plane_detector.stopping import Background

Prepared = TypeVar('Prepared')


class Transitions(Generic[Prepared]):
    """
    Answers the service ``~/change_state`` of a node in the place of rclpy.

    Parameters
    ----------
    node : LifecycleNode
        Its ``on_configure`` must call `prepared`.
    prepare : callable
        What takes long of configuring; called in a thread.

    Attributes
    ----------
    group : CallbackGroup
        For callbacks that call `configure`: others go on while these wait.

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
        Do what ``trigger_configure`` of rclpy does, without keeping the executor from other work.

        Raises
        ------
        RuntimeError
            The state does not allow it.

        """
        machine = self._node._state_machine  # for this rclpy has no public name
        number, label = machine.current_state
        machine.trigger_transition_by_id(Transition.TRANSITION_CONFIGURE, True)
        done = Future()
        self._call = Background(self._prepare, 'configure', lambda: done.set_result(None))
        await done
        code = self._node.on_configure(LifecycleState(label=label, state_id=number))
        machine.trigger_transition_by_label(code.to_label(), True)
        return code

    def prepared(self) -> Prepared:
        """Return what was prepared, or prepare it now; raise what that raises."""
        call = self._call or Background(self._prepare, 'configure')
        self._call = None
        return call.result()

    def stop(self) -> None:
        """Tell the preparation to stop."""
        if self._call is not None:
            self._call.stop.set()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the preparation to end; return whether none runs any more."""
        return self._call is None or self._call.wait(timeout_s)

    def _answering(self, by_rclpy: Callable[..., Any]) -> Callable[..., Any]:
        """Return the callback of the service; by rclpy's an impossible one ends the process."""
        async def answer(request: ChangeState.Request, response: ChangeState.Response):
            try:
                if not _asks_to_configure(request.transition):
                    return by_rclpy(request, response)
                response.success = await self.configure() == TransitionCallbackReturn.SUCCESS
            except RuntimeError as error:
                self._refuse(error)
                response.success = False
            return response
        return answer

    def _refuse(self, error: RuntimeError) -> None:
        self._node.get_logger().error(f'transition refused: {error}')


def _asks_to_configure(transition: Transition) -> bool:
    """Return whether it does, by its label if there is one, else by its number."""
    if transition.label:
        return transition.label == 'configure'
    return transition.id == Transition.TRANSITION_CONFIGURE
