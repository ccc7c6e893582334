# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms between frames: from TF for the node, from a recording for replay."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from plane_detector.config import NodeConfig
from plane_detector.geometry.rigid_transform import RigidTransform, interpolate
from plane_detector.ros.inputs.synchronizer import ns_of

# chosen: beyond any place on earth in metres, and small enough for points in float32.
_LARGEST = 1e9
# chosen: transforms arrive within one or two periods of the camera; later the frame is skipped.
TIMEOUT_S = 0.2


class TransformError(ValueError):
    """There is no transform between two frames at a time."""


@dataclass
class _Edge:
    """The transforms from a frame to its parents, ordered by time; the parent may change."""

    is_static: bool
    stamps_ns: list[int] = field(default_factory=list)
    parents: list[str] = field(default_factory=list)
    transforms: list[RigidTransform] = field(default_factory=list)

    def parent_at(self, stamp_ns: int) -> str:
        """Return the parent at a time: the previous one until the next one is known."""
        return self.parents[-1 if self.is_static else
                            max(bisect_right(self.stamps_ns, stamp_ns) - 1, 0)]

    def at(self, stamp_ns: int) -> RigidTransform:
        """Return the transform at a time, interpolated between neighbours of the same parent."""
        if self.is_static:
            return self.transforms[-1]
        index = bisect_left(self.stamps_ns, stamp_ns)
        if self.stamps_ns[index:index + 1] == [stamp_ns]:
            return self.transforms[index]
        if index in (0, len(self.stamps_ns)):
            raise TransformError('the time is before the first or after the last transform to '
                                 f'{self.parent_at(stamp_ns)}')
        if self.parents[index - 1] != self.parents[index]:
            return self.transforms[index - 1]  # as in tf2
        before_ns, after_ns = self.stamps_ns[index - 1:index + 1]
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return interpolate(*self.transforms[index - 1:index + 1], share)


class TransformBuffer:
    """The tree of frames over time. No transform is dropped: memory grows with their number."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, msg: Any, is_static: bool = False) -> None:
        """
        Add a geometry_msgs/TransformStamped; static ones are valid at any time.

        Raises
        ------
        ValueError
            Its quaternion is zero, or a number is not finite.

        """
        transform, stamp_ns = transform_from_msg(msg), ns_of(msg)
        edge = self._edges.get(msg.child_frame_id)
        if edge is None or edge.is_static != is_static:
            edge = self._edges[msg.child_frame_id] = _Edge(is_static)
        index = len(edge.stamps_ns) if is_static else bisect_left(edge.stamps_ns, stamp_ns)
        edge.stamps_ns.insert(index, stamp_ns)
        edge.parents.insert(index, msg.header.frame_id)
        edge.transforms.insert(index, transform)

    def lookup_transform(self, target_frame: str, source_frame: str, time: Any,
                         timeout: Any = None) -> TransformStamped:
        """
        Return the transform that maps points of the source frame into the target frame.

        Only the transforms between the frames and their nearest common ancestor are needed at
        that time (rclpy.time.Time); the timeout is ignored, because all have been added.

        Raises
        ------
        TransformError
            The frames are not connected at that time.

        """
        above_source, above_target = (self._ancestors(frame, time.nanoseconds)
                                      for frame in (source_frame, target_frame))
        common = next((frame for frame in above_target if frame in above_source), None)
        if common is None:
            frames = sorted({*self._edges, *(parent for edge in self._edges.values()
                                             for parent in edge.parents)})
            raise TransformError(f'the frames are not connected; there are {", ".join(frames)}')

        def into_common(path: list[str]) -> RigidTransform:
            transform = RigidTransform.identity()
            for frame in path[:path.index(common)]:
                transform = self._edges[frame].at(time.nanoseconds).after(transform)
            return transform

        transform = into_common(above_target).inverse().after(into_common(above_source))
        return _to_msg(target_frame, source_frame, time, transform)

    def _ancestors(self, frame: str, stamp_ns: int) -> list[str]:
        """Return a frame, its parent at a time, and so on, until a cycle would start again."""
        path = [frame]
        while (edge := self._edges.get(path[-1])) is not None and (
                parent := edge.parent_at(stamp_ns)) not in path:
            path.append(parent)
        return path


def transform_from_msg(msg: Any) -> RigidTransform:
    """
    Return the transform of a geometry_msgs/TransformStamped, from child to parent frame.

    Raises
    ------
    ValueError
        Its quaternion is zero, or a number is not finite.

    """
    rotation, translation = msg.transform.rotation, msg.transform.translation
    quaternion = rotation.x, rotation.y, rotation.z, rotation.w
    translation_m = translation.x, translation.y, translation.z
    if not (np.abs([*quaternion, *translation_m]) <= _LARGEST).all():  # nor NaN
        raise ValueError(f'the transform from {msg.child_frame_id} to {msg.header.frame_id} has '
                         f'numbers that are not finite, or above {_LARGEST:g}')
    return RigidTransform.from_quaternion(quaternion, translation_m)


def _to_msg(target_frame: str, source_frame: str, time: Any,
            transform: RigidTransform) -> TransformStamped:
    msg = TransformStamped(child_frame_id=source_frame)
    msg.header.frame_id, msg.header.stamp = target_frame, time.to_msg()
    for name, value in zip('xyz', transform.translation_m.tolist(), strict=True):
        setattr(msg.transform.translation, name, value)
    for name, value in zip('xyzw', transform.quaternion.tolist(), strict=True):
        setattr(msg.transform.rotation, name, value)
    return msg


class Buffer(Protocol):
    """The part of tf2_ros.Buffer that is used; a buffer with a listener also has ``clear()``."""

    def lookup_transform(self, target_frame: str, source_frame: str, time: Time,
                         timeout: Duration) -> Any:
        """Return a TransformStamped, or raise after the timeout."""


@dataclass(frozen=True)
class CameraPose:
    """The pose of the camera in the base frame: z up, its origin on the floor (REP-103)."""

    to_base: RigidTransform

    @property
    def gravity_camera(self) -> np.ndarray:
        """Direction of gravity in the optical frame, (3,)."""
        return -self.to_base.rotation[2]

    @property
    def height_m(self) -> float | None:
        """Height above the origin; None below it."""
        height_m = float(self.to_base.translation_m[2])
        return height_m if height_m > 0 else None


class FrameTransforms:
    """
    Looks up the frames named in the settings; does nothing if there are none.

    A listener, if there is one, fills the buffer in another thread until its ``unregister`` is
    called.
    """

    def __init__(self, buffer: Buffer, listener: Any = None):
        self._buffer, self._listener = buffer, listener
        self._was_missing = False

    def destroy(self) -> None:
        """Stop listening; transforms already received stay."""
        if self._listener is not None:
            self._listener.unregister()
            self._listener = None

    def forget(self) -> None:
        """
        Forget the transforms received so far, except static ones: time jumped back.

        tf2 ignores transforms that are more than ten seconds older than the newest one.
        """
        if self._listener is not None:
            self._buffer.clear()

    def rotation(self, frame: str, header: Header) -> tuple[float, ...] | None:
        """Return the quaternion x y z w from a frame into that of the header; None if unknown."""
        try:
            msg = self._buffer.lookup_transform(header.frame_id, frame,
                                                Time.from_msg(header.stamp), Duration())
            return tuple(transform_from_msg(msg).quaternion.tolist())
        except Exception:  # tf2's classes cannot be imported where it is not installed
            return None

    def awaited(self, header: Header, settings: NodeConfig
                ) -> Callable[[], tuple[CameraPose | None, RigidTransform | None, str]]:
        """
        Return a function that waits, `TIMEOUT_S` from now, for `camera_pose` and `to_target`.

        It returns both, and the reason if the second one is missing. Call it when the other work
        on the frame is done: transforms arrive meanwhile. If the transforms of the previous frame
        were missing, this method waits for them itself, so that no work is done in vain.

        Raises
        ------
        ValueError
            The first transform is not available in time; also raised by the function.

        """
        until_s = time.monotonic() + TIMEOUT_S

        def wait() -> tuple[CameraPose | None, RigidTransform | None, str]:
            self._was_missing = True
            pose = self.camera_pose(header, settings, until_s - time.monotonic())
            try:
                to_target = self.to_target(header, settings, until_s - time.monotonic())
            except ValueError as error:  # outputs in the frame of the image do not need it
                return pose, None, str(error)
            self._was_missing = False
            return pose, to_target, ''
        if not self._was_missing:
            return wait
        found = wait()
        return lambda: found

    def camera_pose(self, header: Header, settings: NodeConfig, timeout_s: float = 0.0
                    ) -> CameraPose | None:
        """Return the pose of the camera relative to ``base_frame``; None if none is named."""
        if not settings.base_frame:
            return None
        return CameraPose(self._lookup(settings.base_frame, header, timeout_s))

    def to_target(self, header: Header, settings: NodeConfig, timeout_s: float = 0.0
                  ) -> RigidTransform | None:
        """Return the transform into ``target_frame``; None if the image is in it."""
        if settings.target_frame in ('', header.frame_id):
            return None
        return self._lookup(settings.target_frame, header, timeout_s)

    def _lookup(self, frame: str, header: Header, timeout_s: float) -> RigidTransform:
        stamp, timeout = Time.from_msg(header.stamp), Duration(seconds=max(timeout_s, 0.0))
        try:
            msg = self._buffer.lookup_transform(frame, header.frame_id, stamp, timeout)
        except Exception as error:  # tf2's classes cannot be imported where it is not installed
            raise ValueError(
                f'no transform from {header.frame_id} to {frame} at the time of the image, within '
                f'{TIMEOUT_S:g} s: {error}') from error
        return transform_from_msg(msg)


def listen_to_tf(node: Node) -> FrameTransforms:
    """Return transforms that the node receives from /tf and /tf_static."""
    try:
        import tf2_ros
    except ImportError as error:
        raise ValueError('base_frame and target_frame need tf2_ros: install '
                         'ros-jazzy-tf2-ros-py') from error
    buffer = tf2_ros.Buffer()
    return FrameTransforms(buffer, tf2_ros.TransformListener(buffer, node))
