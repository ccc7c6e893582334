# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From TF: gravity and height of the camera, and the transform to the frame of the outputs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from plane_detector.config import NodeConfig
from plane_detector.geometry.gravity import unit_direction
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.inputs.transform_buffer import transform_from_msg


class Buffer(Protocol):
    """The part of tf2_ros.Buffer that is used."""

    def lookup_transform(self, target_frame: str, source_frame: str, time: Time,
                         timeout: Duration) -> Any:
        """Return a TransformStamped, or raise after the timeout."""


@dataclass(frozen=True)
class CameraPose:
    """Direction of gravity (3,) in the optical frame, and height above the base frame's origin."""

    gravity_camera: np.ndarray
    height_m: float


class FrameTransforms:
    """
    Looks up the frames named in the settings; does nothing if none is named.

    Parameters
    ----------
    buffer : Buffer
        Filled in another thread.
    listener : object, optional
        Fills the buffer until its ``unregister`` is called.

    """

    def __init__(self, buffer: Buffer, listener: Any = None):
        self._buffer, self._listener = buffer, listener
        self._was_missing = False

    def destroy(self) -> None:
        """Stop listening."""
        if self._listener is not None:
            self._listener.unregister()

    def awaited(self, header: Header, settings: NodeConfig
                ) -> Callable[[], tuple[CameraPose | None, RigidTransform | None]]:
        """
        Return a function that waits until `tf_timeout` from now for `camera_pose` and `to_target`.

        Call it when the other work on the frame is done: transforms arrive meanwhile. If those of
        the frame before were missing, they are awaited here, so that no work is done in vain.

        Raises
        ------
        ValueError
            A transform is not available in time; also raised by the function.

        """
        until_s = time.monotonic() + settings.tf_timeout

        def wait() -> tuple[CameraPose | None, RigidTransform | None]:
            self._was_missing = True
            found = (self.camera_pose(header, settings, until_s - time.monotonic()),
                     self.to_target(header, settings, until_s - time.monotonic()))
            self._was_missing = False
            return found
        if not self._was_missing:
            return wait
        found = wait()
        return lambda: found

    def camera_pose(self, header: Header, settings: NodeConfig, timeout_s: float = 0.0
                    ) -> CameraPose | None:
        """Return the pose of the camera relative to ``base_frame``; None if none is named."""
        if not settings.base_frame:
            return None
        to_base = self._lookup(settings.base_frame, header, settings, timeout_s)
        up_base = unit_direction(settings.base_up)
        return CameraPose(-to_base.rotation.T @ up_base, float(to_base.translation_m @ up_base))

    def to_target(self, header: Header, settings: NodeConfig, timeout_s: float = 0.0
                  ) -> RigidTransform | None:
        """Return the transform into ``target_frame``; None if the image is in it."""
        if settings.target_frame in ('', header.frame_id):
            return None
        return self._lookup(settings.target_frame, header, settings, timeout_s)

    def _lookup(self, frame: str, header: Header, settings: NodeConfig, timeout_s: float
                ) -> RigidTransform:
        stamp, timeout = Time.from_msg(header.stamp), Duration(seconds=max(timeout_s, 0.0))
        try:
            msg = self._buffer.lookup_transform(frame, header.frame_id, stamp, timeout)
        except Exception as error:  # tf2's classes cannot be imported where it is not installed
            raise ValueError(
                f'no transform from {header.frame_id} to {frame} at the time of the image, within '
                f'tf_timeout ({settings.tf_timeout:g} s): {error}') from error
        return transform_from_msg(msg)


def listen_to_tf(node: Node) -> FrameTransforms:
    """
    Return transforms that the node receives from /tf and /tf_static.

    Raises
    ------
    ValueError
        tf2_ros is not installed.

    """
    try:
        import tf2_ros
    except ImportError as error:
        raise ValueError('base_frame and target_frame need tf2_ros: install '
                         'ros-jazzy-tf2-ros-py') from error
    buffer = tf2_ros.Buffer()
    return FrameTransforms(buffer, tf2_ros.TransformListener(buffer, node))
