# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From TF: gravity and height of the camera, and the transform to the frame of the outputs."""

from __future__ import annotations

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
    """
    Pose of the camera relative to the floor.

    Attributes
    ----------
    gravity_camera : (3,) float64
        Unit direction of gravity in the optical frame.
    height_m : float
        Of the camera above the origin of the base frame.

    """

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
        Object that fills the buffer; kept alive with this one.

    """

    def __init__(self, buffer: Buffer, listener: Any = None):
        self._buffer, self._listener = buffer, listener

    def camera_pose(self, header: Header, settings: NodeConfig) -> CameraPose | None:
        """
        Return the pose of the camera relative to ``base_frame``; None if none is named.

        Raises
        ------
        ValueError
            The transform is not available within ``tf_timeout``.

        """
        if not settings.base_frame:
            return None
        to_base = self._lookup(settings.base_frame, header, settings.tf_timeout)
        up_base = unit_direction(settings.base_up)
        return CameraPose(-to_base.rotation.T @ up_base, float(to_base.translation_m @ up_base))

    def to_target(self, header: Header, settings: NodeConfig) -> RigidTransform | None:
        """Return the transform into ``target_frame``; as :meth:`camera_pose`."""
        if settings.target_frame in ('', header.frame_id):
            return None
        return self._lookup(settings.target_frame, header, settings.tf_timeout)

    def _lookup(self, frame: str, header: Header, timeout_s: float) -> RigidTransform:
        stamp, timeout = Time.from_msg(header.stamp), Duration(seconds=timeout_s)
        try:
            msg = self._buffer.lookup_transform(frame, header.frame_id, stamp, timeout)
        except Exception as error:  # tf2's classes cannot be imported where it is not installed
            raise ValueError(
                f'no transform from {header.frame_id} to {frame} at the time of the image, within '
                f'tf_timeout ({timeout_s:g} s): {error}') from error
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
