# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of a node to the outside: latched topics, and services to clear, save and load it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rclpy.lifecycle import LifecycleNode
from std_srvs.srv import Trigger

from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.outputs.frame import MapView
from plane_detector.ros.outputs.topics import MAP_OUTPUTS, OutputPublishers, make_map_messages


class MapInterface:
    """
    Topics and services of a map; none stays if one of them cannot be made.

    ``path`` is the file of ``~/map/save`` and ``~/map/load``.
    """

    def __init__(self, node: LifecycleNode, live_map: LiveMap, path: Path):
        self._node, self._map, self._publishing = node, live_map, threading.Lock()
        self._outputs = OutputPublishers(node, MAP_OUTPUTS, latched=True)
        self._services = [
            node.create_service(Trigger, f'~/map/{name}', partial(self._answer, act))
            for name, act in (('clear', live_map.clear),
                              ('save', partial(live_map.save, path)),
                              ('load', partial(live_map.load, path)))]

    def publish(self, view: MapView | None) -> None:
        """Publish the map, if there is one and it was not cleared or loaded meanwhile."""
        with self._publishing:
            if view is not None and self._map.is_current(view):
                self._outputs.publish(make_map_messages(view))

    def misfits(self) -> dict[str, str]:
        """Return why subscribers receive nothing, as that of the other outputs."""
        return self._outputs.misfits()

    def destroy(self) -> None:
        """Destroy publishers and services."""
        for service in self._services:
            self._node.destroy_service(service)
        self._outputs.destroy()

    def _answer(self, act: Callable[[], str], _request: Trigger.Request,
                response: Trigger.Response) -> Trigger.Response:
        try:
            response.success, response.message = True, act()
        except (OSError, ValueError) as error:
            response.success, response.message = False, str(error)
            self._node.get_logger().warning(f'map: {error}')
            return response
        self.publish(self._map.view(self._node.get_clock().now().to_msg()))
        return response
