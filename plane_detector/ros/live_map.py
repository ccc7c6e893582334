# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of a node or of a replay: the images that are added to it, its topics and services."""

from __future__ import annotations

import threading
from collections.abc import Callable
from copy import copy
from functools import partial
from pathlib import Path

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from plane_detector._runtime.plain_text import plain
from plane_detector.config import MapConfig
from plane_detector.mapping.map_plane import MapPlane
from plane_detector.mapping.plane_map import MapUpdate, PlaneMap
from plane_detector.mapping.registration import MOST_CORRECTION_M
from plane_detector.ros import qos
from plane_detector.ros.fault_log import MOST_OF_FAILURE
from plane_detector.ros.outputs.frame import DetectedFrame, MapView
from plane_detector.ros.outputs.topics import MAP_OUTPUTS, OutputPublishers, make_map_messages
from plane_detector.types import Planes

# chosen: the map is published at most twice a second; in a bag, by the stamps of the images.
PERIOD_S = 0.5
# chosen: largest distance of a click from a plane of the map: a click hits a visible surface.
CLICK_REACH_M = 0.1
# chosen: a camera that has not moved for this many images may be fixed to the target frame.
_STILL_IMAGES = 30
AUTO = 'auto'
"""Setting for a file that is named after the node."""


class LiveMap:
    """
    A map of planes that several threads may use; ValueError if the poses have no frame.

    In a node it has topics and services, see :meth:`offer`. They run in the thread of the
    executor. The map is published by a timer, which simulated time does not stop, and after a
    service call. While the node is inactive nothing is published.
    """

    def __init__(self, config: MapConfig, target_frame: str):
        if not target_frame:
            raise ValueError('map.enabled needs target_frame: a frame that does not move, such as '
                             'odom or map')
        self._map, self._frame_id, self._lock = PlaneMap(config), target_frame, threading.Lock()
        self._epoch = 0
        self._header, self._stamp_s = Header(frame_id=target_frame), 0.0  # of the last image
        self._update: MapUpdate | None = None  # by it; None: cleared or loaded since
        # What has changed since the last view, and when that was due.
        self._has_changed, self._due_s = False, -np.inf
        self._subsumed: dict[int, int] = {}
        self._events: list[str] = []
        self._last_jump_m = 0.0
        self._still_images = 0
        self._obstacle = ''
        self._without_pose = 0
        self._outputs: OutputPublishers | None = None  # of a node that offers them
        self._destroy: list[Callable[[], object]] = []  # what a node offers

    def offer(self, node: LifecycleNode, file: str) -> None:
        """
        Create the topics and services of a node, for the ``file`` of the setting ``map.file``.

        Raises
        ------
        ValueError
            The file has no name.

        """
        path = file_of(file, node)
        self._outputs = OutputPublishers(node, MAP_OUTPUTS, latched=True)
        self._destroy.append(self._outputs.destroy)
        for name, act in (('clear', self.clear), ('save', partial(self.save, path)),
                          ('load', partial(self.load, path))):
            service = node.create_service(
                Trigger, f'~/map/{name}', partial(self._answer, act, node.get_logger().warning),
                qos_profile=qos.service_profile())
            self._destroy.append(partial(node.destroy_service, service))
        timer = node.create_timer(PERIOD_S, self.publish,
                                  clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._destroy.append(partial(node.destroy_timer, timer))

    def publish(self) -> None:
        """Publish the map if the node is active and the map has changed since it was published."""
        if self._outputs.are_activated and (view := self.take_view()) is not None:
            self._outputs.publish(make_map_messages(view))

    def misfits(self) -> dict[str, str]:
        """Return why subscribers receive nothing, as for the other outputs."""
        return self._outputs.misfits()

    def destroy(self) -> None:
        """Destroy publishers, services and timer."""
        while self._destroy:
            self._destroy.pop()()

    def _answer(self, act: Callable[[], str], warn: Callable[[str], object],
                _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.success, response.message = True, act()
        except Exception as error:  # whatever the file contains, the call is answered
            reason = plain(str(error), MOST_OF_FAILURE)
            response.success, response.message = False, reason
            warn(f'map: {reason}')
            return response
        self.publish()
        return response

    def add(self, frame: DetectedFrame, epoch: int = 0) -> None:
        """Add an image if possible."""
        if frame.pose is None:
            self._without_pose += bool(frame.pose_problem)
            self._obstacle = frame.pose_problem or (
                f'no map: target_frame {self._frame_id} is the frame of the camera; set it to one '
                'that does not move, such as odom or map')
            return
        with self._lock:
            if epoch != self._epoch:  # time jumped back: nothing is known about the pose
                self._epoch, self._due_s = epoch, -np.inf
                self._map.lose_pose()
            before = self._map.correction.pose
            try:
                update = self._map.update(frame)
            except ValueError as error:
                self._obstacle = str(error)
                return
            self._obstacle = ''
            is_still = before is not None and np.array_equal(
                before.translation_m, frame.pose.translation_m)
            self._still_images = self._still_images + 1 if is_still else 0
            if update.jump_m:
                self._last_jump_m = update.jump_m
                self._events.append(f'the poses have jumped by {100 * update.jump_m:.0f} cm: all '
                                    'planes of the map moved along')
            self._subsumed.update(update.subsumed)
            self._header, self._stamp_s = frame.target_header, frame.stamp_s
            self._update, self._has_changed = update, True

    def take_view(self) -> MapView | None:
        """Return the map if it has changed since it was returned last."""
        with self._lock:
            if not self._has_changed:
                return None
            self._has_changed, self._due_s = False, self._stamp_s
            subsumed, self._subsumed = self._subsumed, {}
            return MapView(self._header, self._map.snapshot(), subsumed)

    def due_view(self) -> MapView | None:
        """Return the map as :meth:`take_view`, at most twice a second by the stamps of images."""
        return self.take_view() if abs(self._stamp_s - self._due_s) >= PERIOD_S else None

    def plane_at(self, point_m: np.ndarray) -> tuple[Planes, MapPlane]:
        """
        Return the plane at a point (3,) of the target frame, as one row and as it is kept.

        ValueError if none is within reach.
        """
        with self._lock:
            snapshot = self._map.snapshot()
        inner_m = snapshot.to_poses.inverse().points(point_m)
        off_m = [np.linalg.norm(point_m - snapshot.to_poses.points(
            plane.points(plane.cells.nearest_m(plane.flat(inner_m[None])[0])[None])[0]))
            for plane in snapshot.surfaces]
        if not off_m or min(off_m) > CLICK_REACH_M:
            raise ValueError('there is no plane, nor is there one in the map')
        index = int(np.argmin(off_m))
        return snapshot.planes.selected([index]), snapshot.surfaces[index]

    def clear(self) -> str:
        """Discard the map; return what was done."""
        with self._lock:
            count = len(self._map.confirmed)
            self._map.clear()
            self._begin()
        return f'{count} planes were removed'

    def save(self, path: Path) -> str:
        """
        Write the map as it is shown to a file; return what was done.

        OSError or ValueError if it cannot be written.
        """
        with self._lock:
            self._map.save(path, self._frame_id, self._stamp_s)
            return f'{len(self._map.confirmed)} planes are in {path.absolute()}'

    def load(self, path: Path) -> str:
        """Replace the map by that of a file; it is unchanged after an OSError or ValueError."""
        with self._lock:
            loaded = copy(self._map)
            loaded.load(path, self._frame_id)
            # A map of which no message can be made is refused, whatever the reason.
            make_map_messages(MapView(self._header, loaded.snapshot()))
            self._map = loaded
            self._begin()
            return f'{len(self._map.confirmed)} planes from {path.absolute()}'

    def take_events(self) -> list[str]:
        """Return what has happened since the last call: jumps of the poses."""
        with self._lock:
            events, self._events = self._events, []
        return events

    def facts(self) -> dict[str, str]:
        """Return what the diagnostics report about the map."""
        with self._lock:
            facts = {'map_planes': str(len(self._map.confirmed)),
                     'map_images_without_pose': str(self._without_pose)}
            if self._update is not None:
                moved_m, turned_deg = self._map.correction.size()
                facts['map_correction'] = f'{100 * moved_m:.1f} cm, {turned_deg:.2f} degrees'
                facts['map_explained'] = f'{self._update.explained:.0%}'
            if self._last_jump_m:
                facts['map_last_jump'] = f'{100 * self._last_jump_m:.0f} cm'
            return facts

    def problem(self) -> str:
        """Return what is wrong with the poses or the map, and what to do; empty if nothing."""
        with self._lock:
            if self._obstacle or self._update is None:
                return self._obstacle
            if self._update.is_full:
                count = sum(plane.cells.hits.size for plane in self._map.planes)
                return (f'the map has {len(self._map.planes)} planes of {count / 1e6:.1f} million '
                        'cells and takes no more: call ~/map/clear, or increase map.cell or '
                        'segmentation.min_plane_share')
            moved_m, _ = self._map.correction.size()
            if moved_m > MOST_CORRECTION_M:
                hint = (f'; does {self._frame_id} move with the camera?'
                        if self._still_images > _STILL_IMAGES else '')
                return (f'the map corrects the poses by {100 * moved_m:.0f} cm: are the poses '
                        f'good?{hint}')
            jitter_m = self._map.jitter_m
            if jitter_m > 2 * self._map.config.pose_jitter:
                return (f'the poses jitter by {100 * jitter_m:.1f} cm, map.pose_jitter is '
                        f'{100 * self._map.config.pose_jitter:.1f} cm: set it to {jitter_m:.3f}')
            return ''

    def _begin(self) -> None:
        """Note that this is a different map from before."""
        self._update, self._subsumed, self._has_changed = None, {}, True
        self._due_s = -np.inf


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
