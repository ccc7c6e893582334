# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The subscriptions of the node, their topics, and the frames made from their messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer, depth_use, ns_of
from plane_detector.ros.inputs.topic_watch import (
    COMPRESSED,
    MESSAGES_LOST,
    Arrivals,
    ImageLoss,
    TopicWatch,
)
from plane_detector.ros.qos import overriding_options
from plane_detector.ros.spinning import InputGroup

_RELIABILITY = {'auto': ReliabilityPolicy.BEST_AVAILABLE,
                'reliable': ReliabilityPolicy.RELIABLE,
                'best_effort': ReliabilityPolicy.BEST_EFFORT}
# derived: a camera's jitter is no change of the difference between its stamps.
_OFFSET_CHANGE = 0.3
# derived: a share of some 75 images in a window varies by a few percent.
_LOSS_CHANGE = 0.15


class InputSubscription:
    """
    A subscription that keeps the last message and can adapt to its publishers.

    With reliability ``auto`` it starts compatible with every publisher: best effort if none is
    known, reliable if all of them are. When `follow` finds that they have changed, it creates a
    second subscription with the other reliability, and the first one is destroyed when the second
    has received a message, so that no message is lost in between.
    """

    def __init__(self, node: Node, msg_type: Any, topic: str, callback: Callable[[Any], None],
                 reliability: str):
        self._node = node
        self._arguments = msg_type, topic
        self._callback = callback
        self._wanted = _RELIABILITY[reliability]
        self._follows = False
        self._last_sent_ns = 0
        self.topic = node.resolve_topic_name(topic)
        self._next: Subscription | None = None
        self._current = self._subscribe(self._on_message)

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._destroy_next()
        self._node.destroy_subscription(self._current)

    def follow(self) -> None:
        """Adapt to the publishers of now; to be called from time to time."""
        if not self._follows:
            return
        offered = self._offered()
        if self._next is not None and self._next.qos_profile.reliability == offered:
            return
        self._destroy_next()
        if self._current.qos_profile.reliability != offered:
            self._next = self._subscribe(self._on_first_of_next)

    def _subscribe(self, callback: Callable[..., None]) -> Subscription:
        # The executor would look at each event before every message: a quarter of its time.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        return self._node.create_subscription(
            *self._arguments, callback, QoSProfile(depth=1, reliability=self._wanted),
            event_callbacks=silent, callback_group=InputGroup(),
            qos_overriding_options=overriding_options(self._settle))

    def _settle(self, profile: QoSProfile) -> SetParametersResult:
        """Replace ``auto``, unless overridden, before the subscription is created."""
        self._follows = profile.reliability == ReliabilityPolicy.BEST_AVAILABLE
        if self._follows:
            profile.reliability = self._offered()
        return SetParametersResult(successful=True)

    def _offered(self) -> ReliabilityPolicy:
        """Return the strongest reliability compatible with all publishers, present and future."""
        infos = self._node.get_publishers_info_by_topic(self.topic)
        if infos and all(i.qos_profile.reliability == ReliabilityPolicy.RELIABLE for i in infos):
            return ReliabilityPolicy.RELIABLE
        return ReliabilityPolicy.BEST_EFFORT

    def _on_message(self, msg: Any, info: Mapping[str, int]) -> None:
        self._last_sent_ns = info['source_timestamp']
        self._callback(msg)

    def _on_first_of_next(self, msg: Any, info: Mapping[str, int]) -> None:
        """Destroy the first subscription, which may already have delivered this message."""
        self._node.destroy_subscription(self._current)
        self._current, self._next = self._next, None
        self._current.callback = self._on_message
        if info['source_timestamp'] != self._last_sent_ns:
            self._on_message(msg, info)

    def _destroy_next(self) -> None:
        if self._next is not None:
            self._node.destroy_subscription(self._next)
            self._next = None


class Subscriptions:
    """
    Subscribes to the topics that the settings require; ``on_frame`` is called with each frame.

    ``output`` is that of the network: relative disparity can use measured depth. ``on_dropped`` is
    called with the number of images that did not become a frame. Both are called in the thread of
    the executor.
    """

    def __init__(self, node: Node, config: Config, settings: NodeConfig, output: str,
                 on_frame: Callable[[Frame], None], on_dropped: Callable[[int], None]):
        self._node = node
        self._on_frame, self._on_dropped = on_frame, on_dropped
        self._names = input_topics(node, settings.image_transport)
        self._output, self._reliability = output, settings.input_reliability
        depth = depth_use(config, output)
        self._synchronizer = FrameSynchronizer(depth, settings.stamp_slop,
                                               config.scale.imu_to_camera)
        compressed = settings.image_transport == 'compressed'
        wanted = {'image': (CompressedImage if compressed else Image, self._on_image),
                  'camera_info': (CameraInfo, self._on_camera_info)}
        if depth != 'unused':
            wanted['depth'] = Image, self._on_depth
        if settings.use_imu:
            wanted['imu'] = Imu, self._synchronizer.add_imu
        self._watch = TopicWatch(node)
        self._loss = ImageLoss()
        self._depth_offset_s = self._lost_share = 0.0
        self._subscriptions: dict[str, InputSubscription] = {}
        try:
            for role, (msg_type, on_message) in wanted.items():
                self._subscribe(role, msg_type, on_message,
                                is_watched=role != 'depth' or depth == 'required')
        except Exception:
            self.destroy()
            raise

    def apply(self, config: Config, settings: NodeConfig) -> None:
        """Apply changed settings, except those that are read at configure."""
        depth = depth_use(config, self._output)
        self._synchronizer.apply(depth, settings.stamp_slop, config.scale.imu_to_camera)
        if depth == 'unused' and 'depth' in self._subscriptions:
            self._subscriptions.pop('depth').destroy()
        elif depth == 'optional' and 'depth' not in self._subscriptions:
            self._subscribe('depth', Image, self._on_depth, is_watched=False)

    def destroy(self) -> None:
        """End the subscriptions."""
        for subscription in self._subscriptions.values():
            subscription.destroy()

    def follow_publishers(self) -> None:
        """Adapt the reliability of all subscriptions to their publishers."""
        for subscription in self._subscriptions.values():
            subscription.follow()

    def problem(self) -> str:
        """Return which topic is silent and why, empty if none is; it is logged when it changes."""
        return self._watch.problem()

    def obstacle(self) -> str:
        """Return why no frame can come, as far as that is known; empty if one can."""
        return self._watch.obstacle()

    def arrivals(self) -> Arrivals:
        """Return how many of the images that the camera sent have arrived lately."""
        return self._loss.arrivals()

    def explain_loss(self) -> str:
        """Return that images are lost, and the remedy; empty if they arrive."""
        arrivals = self.arrivals()
        if not arrivals.are_few:
            return ''
        lost_share = 1 - arrivals.received / arrivals.implied
        if abs(lost_share - self._lost_share) > _LOSS_CHANGE:
            self._lost_share = lost_share
        return (f'{self._lost_share:.0%} of the images on {self._names["image"]} do not arrive, '
                f'as the stamps tell: large {MESSAGES_LOST}, or this machine is too busy to '
                'receive them')

    def explain_unpaired(self, node_name: str) -> str:
        """Return by how much the stamps of image and depth differ, and the remedy."""
        offset_s = self._synchronizer.take_unpaired_s()
        if offset_s is None:
            return ('images arrive, but no depth image with their stamp, within stamp_slop')
        if abs(offset_s - self._depth_offset_s) > _OFFSET_CHANGE * abs(self._depth_offset_s):
            self._depth_offset_s = offset_s
        offset_s = self._depth_offset_s
        return (f'images arrive, but no depth image with their stamp, within stamp_slop: the '
                f'nearest is {1e3 * abs(offset_s):.0f} ms {"later" if offset_s > 0 else "earlier"}'
                f'; synchronise the camera, or: ros2 param set {node_name} stamp_slop '
                f'{_rounded_up(abs(offset_s))}')

    def _subscribe(self, role: str, msg_type: Any, on_message: Callable[[Any], Any],
                   is_watched: bool) -> None:
        def receive(msg: Any) -> None:
            if is_watched:
                self._watch.heard(role)
            on_message(msg)

        subscription = InputSubscription(self._node, msg_type, self._names[role], receive,
                                         self._reliability)
        self._subscriptions[role] = subscription
        if is_watched:  # one CameraInfo is enough
            self._watch.add(role, subscription.topic, msg_type, may_stop=role == 'camera_info',
                            only_reliable=self._reliability == 'reliable',
                            is_needed=role != 'imu')

    def _on_image(self, msg: Any) -> None:
        self._loss.add_image(ns_of(msg))
        epoch = self._synchronizer.epoch
        self._hand_over(self._synchronizer.add_image(msg))
        if self._synchronizer.epoch != epoch:
            self._node.get_logger().warning('time jumped back: buffers and tracking are reset')

    def _on_camera_info(self, msg: CameraInfo) -> None:
        self._loss.add_camera_info(ns_of(msg))
        self._hand_over(self._synchronizer.add_camera_info(msg))

    def _on_depth(self, msg: Image) -> None:
        self._hand_over(self._synchronizer.add_depth(msg))

    def _hand_over(self, frames: list[Frame]) -> None:
        dropped = self._synchronizer.take_dropped()
        if dropped:
            self._on_dropped(dropped)
        for frame in frames:
            self._on_frame(frame)


def _rounded_up(seconds: float) -> str:
    """Return a time with one digit, a little above the given one: 0.06 s -> 0.08."""
    most_s = 1.2 * seconds
    step_s = 10.0 ** math.floor(math.log10(most_s))
    return f'{math.ceil(most_s / step_s) * step_s:.6g}'


class Resolver(Protocol):
    """The part of a node that is used: resolution of names."""

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name, with remappings unless ``only_expand``."""


def input_topics(node: Resolver, image_transport: str) -> dict[str, str]:
    """
    Return the full names of the inputs, by the names used for remapping.

    The compressed topic follows ``image``, as in image_transport, and ``camera_info`` is in the
    namespace of the image, unless they are remapped themselves.
    """
    base = node.resolve_topic_name('image').removesuffix(COMPRESSED)
    image = node.resolve_topic_name('image')
    if image_transport == 'compressed':
        image = base + COMPRESSED
        if _is_remapped(node, 'image/compressed'):
            image = node.resolve_topic_name('image/compressed')
            base = image.removesuffix(COMPRESSED)
    camera_info = node.resolve_topic_name('camera_info')
    if not _is_remapped(node, 'camera_info'):
        camera_info = f'{base.rpartition("/")[0]}/camera_info'
    return {'image': image, 'camera_info': camera_info,
            **{role: node.resolve_topic_name(role) for role in ('depth', 'imu')}}


def _is_remapped(node: Resolver, topic: str) -> bool:
    return node.resolve_topic_name(topic) != node.resolve_topic_name(topic, only_expand=True)
