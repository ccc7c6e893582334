# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of a node to the outside: latched topics, and services to clear, save and load it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from std_srvs.srv import Trigger

from plane_detector._runtime.plain_text import plain
from plane_detector.ros import qos
from plane_detector.ros.fault_log import MOST_OF_FAILURE
from plane_detector.ros.live_map import PERIOD_S, LiveMap
from plane_detector.ros.outputs.topics import MAP_OUTPUTS, OutputPublishers, make_map_messages

AUTO = 'auto'


class MapInterface:
    """
    Topics and services of a map; none stays if one of them cannot be made.

    All is done in the thread of the executor: the topics are the map at the time of a timer, which
    simulated time does not stop, and after a service. While the node is not active they wait.

    Parameters
    ----------
    node : LifecycleNode
    live_map : LiveMap
    file : str
        Of the setting ``map.file``.

    """

    def __init__(self, node: LifecycleNode, live_map: LiveMap, file: str):
        self._node, self._map, path = node, live_map, file_of(file, node)
        self._outputs = OutputPublishers(node, MAP_OUTPUTS, latched=True)
        self._services = [
            node.create_service(Trigger, f'~/map/{name}', partial(self._answer, act),
                                qos_profile=qos.service_profile())
            for name, act in (('clear', live_map.clear),
                              ('save', partial(live_map.save, path)),
                              ('load', partial(live_map.load, path)))]
        self._timer = node.create_timer(PERIOD_S, self.publish,
                                        clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the map if the node is active and the map has changed since it was published."""
        if self._outputs.are_activated and (view := self._map.take_view()) is not None:
            self._outputs.publish(make_map_messages(view))

    def misfits(self) -> dict[str, str]:
        """Return why subscribers receive nothing, as that of the other outputs."""
        return self._outputs.misfits()

    def destroy(self) -> None:
        """Destroy publishers, services and timer."""
        self._node.destroy_timer(self._timer)
        for service in self._services:
            self._node.destroy_service(service)
        self._outputs.destroy()

    def _answer(self, act: Callable[[], str], _request: Trigger.Request,
                response: Trigger.Response) -> Trigger.Response:
        try:
            response.success, response.message = True, act()
        except Exception as error:  # whatever a file holds, the call is answered
            reason = plain(str(error), MOST_OF_FAILURE)
            response.success, response.message = False, reason
            self._node.get_logger().warning(f'map: {reason}')
            return response
        self.publish()
        return response


def file_of(setting: str, node: LifecycleNode) -> Path:
    """
    Return the file of a map.

    Raises
    ------
    ValueError
        It is empty.

    """
    if not setting.strip():
        raise ValueError('map.file is empty: set it to the file of the map, or to auto')
    if setting == AUTO:
        name = node.get_fully_qualified_name().strip('/').replace('/', '_')
        return Path(f'{name}_map.json')
    return Path(setting).expanduser()
