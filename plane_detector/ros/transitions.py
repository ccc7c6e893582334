# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Transitions of a lifecycle node: slow ones run in a thread, invalid ones are answered.

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
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.task import Future

from plane_detector.stopping import Background

Prepared = TypeVar('Prepared')


class Transitions(Generic[Prepared]):
    """
    Answers the service ``~/change_state`` of a node instead of rclpy.

    Parameters
    ----------
    node : LifecycleNode
        Its ``on_configure`` must call `prepared`.
    prepare : callable
        The slow part of configuring; called in a thread.

    Attributes
    ----------
    group : CallbackGroup
        For callbacks that call `configure`: others run while these wait.

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

        Raises
        ------
        RuntimeError
            The state does not allow it.

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
        """Return the callback of the service; in rclpy's own, an invalid one ends the process."""
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
    """Return whether the transition is configure, by its label if it has one, else its number."""
    if transition.label:
        return transition.label == 'configure'
    return transition.id == Transition.TRANSITION_CONFIGURE
