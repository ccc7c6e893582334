# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The plane at a clicked point: clicked_point to ~/clicked_plane."""

from __future__ import annotations

from collections import deque

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.lifecycle import LifecycleNode

from plane_detector.ros import qos
from plane_detector.ros.fault_log import FaultLog
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.types import Planes

# chosen: a click is within a few pixels of its target; planes farther away are not meant.
REACH_PX = 8
# chosen: more clicks than a user makes between two frames; limits memory.
_MOST_CLICKS = 16
_LOG_PERIOD_S = 0.5  # chosen: users do not click faster, programs may


class PointQuery:
    """Answers clicks, which the thread of the executor adds, with the next frame of the worker."""

    def __init__(self, node: LifecycleNode, live_map: LiveMap | None = None):
        self._node, self._map = node, live_map
        self._clicks: deque[PointStamped] = deque(maxlen=_MOST_CLICKS)
        self._faults = FaultLog(node.get_logger(), 'clicked point')
        self._publisher = node.create_lifecycle_publisher(
            PoseStamped, '~/clicked_plane', qos.output_profile(),
            event_callbacks=qos.SILENT_PUBLISHER,
            qos_overriding_options=qos.overriding_options())
        try:
            self._subscription = node.create_subscription(
                PointStamped, 'clicked_point', self._on_click, 10,
                event_callbacks=qos.SILENT_SUBSCRIPTION,
                qos_overriding_options=qos.overriding_options())
        except Exception:  # a wrong qos_overrides parameter
            node.destroy_lifecycle_publisher(self._publisher)
            raise

    @property
    def is_waiting(self) -> bool:
        """Whether a click waits for a frame."""
        return bool(self._clicks)

    def destroy(self) -> None:
        """Destroy publisher and subscription."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_lifecycle_publisher(self._publisher)

    def answer(self, result: DetectedFrame) -> None:
        """Publish and log the plane at each click."""
        while self._clicks:
            click = self._clicks.popleft()
            try:
                plane, description = self._plane_at(result, point_in_camera(result, click))
            except ValueError as error:
                self._faults.report(error)
                continue
            (pose,) = messages.poses_to_msg(result.target_header, plane).poses
            self._publisher.publish(PoseStamped(header=result.target_header, pose=pose))
            self._node.get_logger().info(f'clicked point: {description}',
                                         throttle_duration_sec=_LOG_PERIOD_S)

    def _plane_at(self, result: DetectedFrame, point_m: np.ndarray) -> tuple[Planes, str]:
        """Return the plane of the image at a point, else that of the map, and a description."""
        try:
            index = plane_at(result, point_m)
        except ValueError:
            if self._map is None or result.pose is None:
                raise
            plane, kept = self._map.plane_at(result.placed(point_m))
            return plane, (f'plane {kept.label} of the map, {kept.plane_class.readable}, area '
                           f'{kept.cells.area_m2:.2f}, seen in {kept.views} images')
        return result.planes.selected([index]), describe_plane(result, index)

    def refuse_all(self) -> None:
        """Refuse the waiting clicks; called in the thread of the executor."""
        if self._clicks:
            self._clicks.clear()
            self._refuse()

    def _on_click(self, msg: PointStamped) -> None:
        if not self._publisher.is_activated:
            self._refuse()
            return
        self._clicks.append(msg)

    def _refuse(self) -> None:
        self._faults.report(ValueError('the node is not active'))


def point_in_camera(result: DetectedFrame, click: PointStamped) -> np.ndarray:
    """
    Return a clicked point (3,) in the frame of the image.

    Raises ValueError if it is neither in that frame nor in that of the outputs, or not finite.
    """
    point_m = np.array([click.point.x, click.point.y, click.point.z])
    if not np.isfinite(point_m).all():
        raise ValueError(f'the point {point_m.tolist()} is not finite')
    frame = click.header.frame_id
    if frame == result.header.frame_id:
        return point_m
    if frame == result.target_header.frame_id:
        return result.pose.inverse().points(point_m)
    raise ValueError(f'it is in the frame {frame}, but the planes are in '
                     f'{result.target_header.frame_id}: use that as the fixed frame, or set '
                     f'target_frame to {frame}')


def plane_at(result: DetectedFrame, point_m: np.ndarray) -> int:
    """
    Return the index of the plane at the pixel that shows a point, or at the nearest pixel.

    Raises ValueError if the point is not in the image, or no plane is near it.
    """
    x, y, z = point_m.tolist()
    camera, labels = result.intrinsics, result.detection.labels
    if z <= 0:
        raise ValueError('it is behind the camera')
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    # Checked before rounding: round() raises for NaN and infinity.
    if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
        raise ValueError('it is not in the image')
    column, row = round(u), round(v)
    top, left = max(row - REACH_PX, 0), max(column - REACH_PX, 0)
    near = labels[top:row + REACH_PX + 1, left:column + REACH_PX + 1]
    rows, columns = np.nonzero((near >= 0) & (near < len(result.detection.planes)))
    if not rows.size:
        raise ValueError('there is no plane')
    nearest = np.argmin((rows + top - row)**2 + (columns + left - column)**2)
    return int(near[rows[nearest], columns[nearest]])


def describe_plane(result: DetectedFrame, index: int) -> str:
    """Return a description of a plane in words."""
    detection = result.detection
    plane, rectangle = detection.planes[index], result.rectangles[index]
    kind = plane.plane_class
    return (f'plane {plane.label}, {kind.readable}, distance '
            f'{plane.offset_m:.2f}, {rectangle.width_m:.2f} x {rectangle.height_m:.2f}, area '
            f'{plane.area_m2:.2f}, confidence {plane.confidence:.0%}')
