# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Transforms over time, for programs that read them from a bag, without tf2.

It has the interface of tf2_ros.Buffer, for the transforms that were added.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped

from plane_detector.geometry.rigid_transform import RigidTransform, interpolate


class TransformError(ValueError):
    """There is no transform between two frames at a time."""


@dataclass
class _Edge:
    """The transforms from a frame to its parent, ordered by time."""

    parent: str
    is_static: bool
    stamps_ns: list[int] = field(default_factory=list)
    transforms: list[RigidTransform] = field(default_factory=list)

    def add(self, stamp_ns: int, transform: RigidTransform) -> None:
        if self.is_static:
            self.stamps_ns, self.transforms = [0], [transform]
            return
        index = bisect_left(self.stamps_ns, stamp_ns)
        self.stamps_ns.insert(index, stamp_ns)
        self.transforms.insert(index, transform)

    def at(self, stamp_ns: int) -> RigidTransform:
        if self.is_static:
            return self.transforms[0]
        index = bisect_left(self.stamps_ns, stamp_ns)
        if index < len(self.stamps_ns) and self.stamps_ns[index] == stamp_ns:
            return self.transforms[index]
        if index in (0, len(self.stamps_ns)):
            raise TransformError('the time is before the first or after the last transform')
        before_ns, after_ns = self.stamps_ns[index - 1:index + 1]
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return interpolate(*self.transforms[index - 1:index + 1], share)


class TransformBuffer:
    """
    The tree of frames over time.

    No transform is dropped, so memory grows with their number.
    """

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, msg: Any, is_static: bool = False) -> None:
        """
        Add a geometry_msgs/TransformStamped; static ones hold at any time.

        Raises
        ------
        ValueError
            Its quaternion is zero, or a number is not finite.

        """
        transform = transform_from_msg(msg)
        edge = self._edges.get(msg.child_frame_id)
        if edge is None or edge.parent != msg.header.frame_id:
            edge = self._edges[msg.child_frame_id] = _Edge(msg.header.frame_id, is_static)
        stamp = msg.header.stamp
        edge.add(stamp.sec * 1_000_000_000 + stamp.nanosec, transform)

    def lookup_transform(self, target_frame: str, source_frame: str, time: Any,
                         timeout: Any = None) -> TransformStamped:
        """
        Return the transform that maps points of the source frame into the target frame.

        Parameters
        ----------
        target_frame, source_frame : str
        time : rclpy.time.Time
        timeout : rclpy.duration.Duration, optional
            Ignored: all transforms are available.

        Raises
        ------
        TransformError
            The frames are not connected at that time.

        """
        source = dict(self._ancestors(source_frame, time.nanoseconds))
        for frame, from_target in self._ancestors(target_frame, time.nanoseconds):
            if frame in source:
                return _to_msg(target_frame, source_frame, time,
                               from_target.inverse().after(source[frame]))
        frames = sorted({*self._edges, *(edge.parent for edge in self._edges.values())})
        raise TransformError(f'the frames are not connected; there are {", ".join(frames)}')

    def _ancestors(self, frame: str, stamp_ns: int) -> Iterator[tuple[str, RigidTransform]]:
        """Yield a frame, its parent, ... and the transform from the frame into each."""
        transform = RigidTransform.identity()
        for _ in range(len(self._edges) + 1):  # ends even if the tree has a cycle
            yield frame, transform
            edge = self._edges.get(frame)
            if edge is None:
                return
            transform, frame = edge.at(stamp_ns).after(transform), edge.parent


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
    if not np.isfinite([*quaternion, *translation_m]).all():
        raise ValueError(f'the transform from {msg.child_frame_id} to {msg.header.frame_id} has '
                         'numbers that are not finite')
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
