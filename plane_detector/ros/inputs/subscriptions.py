# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The subscriptions of the node, and the frames that come of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.inputs.synchronizer import Frame, FrameAssembler, depth_use
from plane_detector.ros.qos import InputSubscription

_WARN_PERIOD_S = 5.0


def image_topic(settings: NodeConfig) -> str:
    """Return the name, not resolved, of the topic of the pictures."""
    return 'image/compressed' if settings.image_transport == 'compressed' else 'image'


class Inputs:
    """
    Subscribes to what the settings ask for.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscribes and logs.
    config : Config
        Says whether depth is needed.
    settings : NodeConfig
        Transport and quality of service.
    output : str
        What the network gives: relative disparity can use measured depth.
    on_frame : callable
        Called with each frame, in the thread of the executor.
    on_dropped : callable
        Called with the number of pictures that did not become a frame.

    """

    def __init__(self, node: Node, config: Config, settings: NodeConfig, output: str,
                 on_frame: Callable[[Frame], None], on_dropped: Callable[[int], None]):
        self._node = node
        self._on_frame, self._on_dropped = on_frame, on_dropped
        self._names = {'image': image_topic(settings)}
        depth = depth_use(config, output)
        self._assembler = FrameAssembler(depth, settings.stamp_slop, config.scale.imu_to_camera)
        compressed = settings.image_transport == 'compressed'
        wanted = [(CompressedImage if compressed else Image, self._names['image'], self._on_image),
                  (CameraInfo, 'camera_info', self._on_camera_info)]
        if depth != 'unused':
            wanted.append((Image, 'depth', self._on_depth))
        if settings.use_imu:
            wanted.append((Imu, 'imu', self._assembler.add_imu))
        self._subscriptions: list[InputSubscription] = []
        try:
            for arguments in wanted:
                self._subscriptions.append(
                    InputSubscription(node, *arguments, settings.input_reliability))
        except Exception:
            self.destroy()
            raise

    def set_stamp_slop(self, stamp_slop_s: float) -> None:
        """Change how far in time a depth image may be from its picture."""
        self._assembler.stamp_slop_s = stamp_slop_s

    def destroy(self) -> None:
        """End the subscriptions."""
        for subscription in self._subscriptions:
            subscription.destroy()

    def warn_of_missing(self) -> str:
        """Log and return which topics have not said anything yet; empty if all have."""
        topics = ', '.join(self._node.resolve_topic_name(self._names.get(name, name))
                           for name in self._assembler.missing)
        if not topics:
            return ''
        text = f'nothing received yet on {topics}'
        self._node.get_logger().warning(f'{text}: no frame can be processed',
                                        throttle_duration_sec=_WARN_PERIOD_S)
        return text

    def _on_image(self, msg: Any) -> None:
        epoch = self._assembler.epoch
        self._hand_over(self._assembler.add_image(msg))
        if self._assembler.epoch != epoch:
            self._node.get_logger().warning('time jumped back: caches and tracking start anew')

    def _on_camera_info(self, msg: CameraInfo) -> None:
        self._hand_over(self._assembler.add_camera_info(msg))

    def _on_depth(self, msg: Image) -> None:
        self._hand_over(self._assembler.add_depth(msg))

    def _hand_over(self, frames: list[Frame]) -> None:
        dropped = self._assembler.take_dropped()
        if dropped:
            self._on_dropped(dropped)
            self.warn_of_missing()
        for frame in frames:
            self._on_frame(frame)
