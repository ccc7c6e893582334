# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The subscriptions of the node, their topics, and the frames made from their messages."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2
from std_msgs.msg import Header

from plane_detector._runtime.plain_text import plain
from plane_detector.config import Config, DepthConfig, NodeConfig
from plane_detector.geometry.gravity import is_identity
from plane_detector.ros.inputs.depth_decoding import COMPRESSED_DEPTH
from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer, depth_use, ns_of
from plane_detector.ros.inputs.topic_watch import (
    COMPRESSED,
    GRACE_S,
    MESSAGES_LOST,
    ArrivalCount,
    TopicWatch,
)
from plane_detector.ros.inputs.transforms import FrameTransforms
from plane_detector.ros.qos import SILENT_SUBSCRIPTION, overriding_options

_RELIABILITY = {'auto': ReliabilityPolicy.BEST_AVAILABLE,
                'reliable': ReliabilityPolicy.RELIABLE,
                'best_effort': ReliabilityPolicy.BEST_EFFORT}
# The policies that adapt to the publishers, and the stronger and the weaker value of each.
_BEST = {'reliability': ReliabilityPolicy.BEST_AVAILABLE,
         'durability': DurabilityPolicy.BEST_AVAILABLE}
_STRENGTHS = {'reliability': (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT),
              'durability': (DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE)}
# chosen: jitter of a camera does not count as a change of the difference between its stamps.
_OFFSET_CHANGE = 0.3
# chosen: three jumps within this time are not a looping bag; they are logged no more often than
# this.
_MOST_JUMPS, _JUMPS_WITHIN_S = 3, 5.0
_MOST_FRAME_IDS, _SHOWN = 16, 80
# chosen: with some 75 images in a window, a share varies by a few percent.
_LOSS_CHANGE = 0.15


class InputSubscription:
    """
    A subscription that keeps the last message and can adapt to its publishers.

    With reliability ``auto`` it starts compatible with every publisher: best effort if none is
    known, reliable if all of them are. So does durability: transient local, by which a message
    that was published once arrives later, if all publishers offer it. When `follow` finds that
    they have changed, it creates a second subscription with the other policies, and the first one
    is destroyed when the second has received a message, so that no message is lost in between.
    """

    def __init__(self, node: Node, msg_type: Any, topic: str, callback: Callable[[Any], None],
                 reliability: str):
        self._node = node
        self._arguments = msg_type, topic
        self._callback = callback
        self._wanted = QoSProfile(depth=1, reliability=_RELIABILITY[reliability],
                                  durability=DurabilityPolicy.BEST_AVAILABLE)
        self._followed: tuple[str, ...] = ()
        self._last_sent_ns = 0
        self.topic = node.resolve_topic_name(topic)
        self._next: Subscription | None = None
        self._current = self._subscribe(self._on_message)

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._destroy_next()
        self._node.destroy_subscription(self._current)

    def follow(self) -> None:
        """Adapt to the current publishers; to be called from time to time."""
        if self._next is not None and self._fits(self._next):
            return
        self._destroy_next()
        if not self._fits(self._current):
            self._next = self._subscribe(self._on_first_of_next)

    def _subscribe(self, callback: Callable[..., None]) -> Subscription:
        return self._node.create_subscription(
            *self._arguments, callback, copy(self._wanted), event_callbacks=SILENT_SUBSCRIPTION,
            callback_group=ReentrantCallbackGroup(),
            qos_overriding_options=overriding_options(self._settle))

    def _settle(self, profile: QoSProfile) -> SetParametersResult:
        """Replace the policies that adapt to publishers before the subscription is created."""
        self._followed = tuple(name for name, best in _BEST.items()
                               if getattr(profile, name) == best)
        for name in self._followed:
            setattr(profile, name, self._offered(name))
        return SetParametersResult(successful=True)

    def _fits(self, subscription: Subscription) -> bool:
        return all(getattr(subscription.qos_profile, name) == self._offered(name)
                   for name in self._followed)

    def _offered(self, name: str) -> ReliabilityPolicy | DurabilityPolicy:
        """Return the strongest policy compatible with all publishers, present and future."""
        infos = self._node.get_publishers_info_by_topic(self.topic)
        strong, weak = _STRENGTHS[name]
        are_strong = infos and all(getattr(i.qos_profile, name) == strong for i in infos)
        return strong if are_strong else weak

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

    ``output`` is the output of the network: relative disparity can use measured depth.
    ``on_dropped`` is called with the number of images that did not become a frame. Both callbacks
    run in the thread of the executor. ``transforms`` provide the mounting of an IMU that has its
    own frame.

    Attributes
    ----------
    watch : TopicWatch
        Which topics are silent, and why.
    count : ArrivalCount
        How many images and CameraInfo arrive.

    """

    def __init__(self, node: Node, config: Config, settings: NodeConfig, output: str,
                 on_frame: Callable[[Frame], None], on_dropped: Callable[[int], None],
                 transforms: FrameTransforms | None):
        self._node = node
        self._on_frame, self._on_dropped = on_frame, on_dropped
        self._transforms = transforms
        self._names = input_topics(node, settings.image_transport, config.depth)
        self._output, self._reliability = output, settings.input_reliability
        depth = depth_use(config, output)
        self._synchronizer = FrameSynchronizer(depth, settings.stamp_slop,
                                               config.scale.imu_to_camera)
        # The messages each of which starts a frame, and their role in remapping.
        self._anchor = anchor_role(config.depth)
        compressed = settings.image_transport == 'compressed'
        of_anchor = CompressedImage if compressed else Image
        if self._anchor != 'image':
            of_anchor = depth_type(config.depth)
        wanted = {self._anchor: (of_anchor, self._on_image),
                  'camera_info': (CameraInfo, self._on_camera_info)}
        self._depth_role, self._depth_type = depth_role(config.depth), depth_type(config.depth)
        if depth != 'unused':
            wanted[self._depth_role] = self._depth_type, self._on_depth
        if settings.use_imu:
            wanted['imu'] = Imu, self._on_imu
        self.watch = TopicWatch(node)
        self._is_depth_watched = depth == 'required'
        self.count = ArrivalCount()
        self._epoch = self._synchronizer.epoch
        self._depth_offset_s = self._lost_share = 0.0
        self._unpaired_since_s = math.inf
        self._jumps_s: deque[float] = deque(maxlen=_MOST_JUMPS)
        self._frame_ids: set[tuple[str, ...]] = set()
        self._camera_header: Header | None = None
        self._config = config
        self._is_mounted, self._mounted_by_s = False, math.inf
        self._has_tf_for_imu_only = not (settings.base_frame or settings.target_frame)
        self._subscriptions: dict[str, InputSubscription] = {}
        try:
            for role, (msg_type, on_message) in wanted.items():
                self._subscribe(role, msg_type, on_message,
                                is_watched=role != self._depth_role or depth != 'optional')
        except Exception:
            self.destroy()
            raise

    def apply(self, config: Config, settings: NodeConfig) -> None:
        """Apply changed settings, except those that are fixed while the node is configured."""
        depth = depth_use(config, self._output)
        self._synchronizer.apply(depth, settings.stamp_slop)
        if config.scale.imu_to_camera != self._config.scale.imu_to_camera:
            self._synchronizer.mount_imu(config.scale.imu_to_camera)
            self._is_mounted = False
        self._config = config
        has_depth = self._depth_role in self._subscriptions
        if depth == 'unused' and has_depth and self._anchor == 'image':
            self._subscriptions.pop(self._depth_role).destroy()
        elif depth == 'optional' and not has_depth:
            self._subscribe(self._depth_role, self._depth_type, self._on_depth, is_watched=False)

    def destroy(self) -> None:
        """End the subscriptions."""
        for subscription in self._subscriptions.values():
            subscription.destroy()

    def follow_publishers(self) -> None:
        """Adapt the reliability of all subscriptions to their publishers."""
        for subscription in self._subscriptions.values():
            subscription.follow()

    def explain_loss(self) -> str:
        """Return that there are fewer images than CameraInfo, and the remedy; empty if not."""
        arrivals = self.count.arrivals()
        if not arrivals.are_few:
            return ''
        lost_share = 1 - arrivals.images / arrivals.camera_infos
        if abs(lost_share - self._lost_share) > _LOSS_CHANGE:
            self._lost_share = lost_share
        topic, of_camera = self._names[self._anchor], self._names['camera_info']
        return (f'{self._lost_share:.0%} of the images on {topic} are missing: {of_camera} has '
                f'more messages. Large {MESSAGES_LOST}, this machine is too busy to receive them, '
                'or the images are throttled')

    def explain_unpaired(self, node_name: str) -> str:
        """
        Return by how much the stamps of image and required depth differ, and the remedy.

        Empty until this has lasted a while; to be called while images find no partner.
        """
        offset_s, now_s = self._synchronizer.take_unpaired_s(), time.monotonic()
        if offset_s is None:
            return ''
        self._unpaired_since_s = min(self._unpaired_since_s, now_s)
        if now_s - self._unpaired_since_s < GRACE_S or self.count.arrivals().are_few:
            return ''
        if abs(offset_s - self._depth_offset_s) > _OFFSET_CHANGE * abs(self._depth_offset_s):
            self._depth_offset_s = offset_s
        offset_s = self._depth_offset_s
        when = 'later' if offset_s > 0 else 'earlier'
        found = ('images arrive, but no depth image with their stamp, within stamp_slop: the '
                 f'nearest is {1e3 * abs(offset_s):.0f} ms {when}; ')
        slop_s = _rounded_up(abs(offset_s))
        if float(slop_s) > self.count.period_s / 2:
            return found + ('synchronise the camera: a larger stamp_slop would pair images with '
                            'the depth of others')
        return found + ('synchronise the camera, or: ros2 param set '
                        f'{node_name} stamp_slop {slop_s}')

    def _subscribe(self, role: str, msg_type: Any, on_message: Callable[[Any], None],
                   is_watched: bool) -> None:
        subscription = InputSubscription(self._node, msg_type, self._names[role], on_message,
                                         self._reliability)
        self._subscriptions[role] = subscription
        if is_watched:  # one CameraInfo is enough
            self.watch.add(role, subscription.topic, msg_type, may_stop=role == 'camera_info',
                            only_reliable=self._reliability == 'reliable',
                            is_needed=role != 'imu')

    def _on_image(self, msg: Any) -> None:
        self.watch.heard(self._anchor)
        self.count.add(ns_of(msg), is_image=True)
        self._camera_header = msg.header
        self._hand_over(self._synchronizer.add_image(msg))
        if self._synchronizer.epoch != self._epoch:
            self._epoch = self._synchronizer.epoch
            self._note_jump()

    def _note_jump(self) -> None:
        """Forget earlier transforms and log the jump, rarely if it is frequent."""
        if self._transforms is not None:
            self._transforms.forget()
        now_s = time.monotonic()
        self._jumps_s.append(now_s)
        if now_s - self._jumps_s[0] > _JUMPS_WITHIN_S or len(self._jumps_s) < _MOST_JUMPS:
            self._node.get_logger().warning('time jumped back: buffers and tracking are reset')
            return
        topic = self._names[self._anchor]
        senders = sorted({f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                          for info in self._node.get_publishers_info_by_topic(topic)})
        self._node.get_logger().warning(
            f'time keeps jumping back on {topic}: two publishers with different clocks? It is '
            f'published by {", ".join(senders)}', throttle_duration_sec=_JUMPS_WITHIN_S)

    def _on_camera_info(self, msg: CameraInfo) -> None:
        self.watch.heard('camera_info')
        self.count.add(ns_of(msg), is_image=False)
        self._hand_over(self._synchronizer.add_camera_info(msg))

    def _on_depth(self, msg: Any) -> None:
        if self._is_depth_watched:
            self.watch.heard(self._depth_role)
        self._hand_over(self._synchronizer.add_depth(msg))

    def _on_imu(self, msg: Imu) -> None:
        self.watch.heard('imu')
        if not self._is_mounted:
            self._is_mounted = self._mount(msg.header.frame_id)
            if self._is_mounted and self._has_tf_for_imu_only and self._transforms is not None:
                self._transforms.destroy()  # listening takes time
        if self._is_mounted:
            self._synchronizer.add_imu(msg)

    def _mount(self, imu_frame: str) -> bool:
        """Return whether the mounting of the IMU is known: set, no rotation needed, or from TF."""
        if not is_identity(self._config.scale.imu_to_camera):
            return True
        camera = self._camera_header
        if camera is None:
            return False
        if not (imu_frame and camera.frame_id) or imu_frame == camera.frame_id:
            return True
        log, now_s = self._node.get_logger(), time.monotonic()
        imu, image = plain(imu_frame, _SHOWN), plain(camera.frame_id, _SHOWN)
        if self._transforms is not None:
            found = self._transforms.rotation(imu_frame, camera)
            if found is not None:
                self._synchronizer.mount_imu(found)
                log.info(f'mounting of the IMU: by TF, from {imu} to {image}')
                return True
            self._mounted_by_s = min(self._mounted_by_s, now_s + GRACE_S)
            if now_s < self._mounted_by_s:
                return False
        log.warning(f'the IMU is in {imu}, the image in {image}, TF has no transform between them '
                    'and scale.imu_to_camera is the identity: if their axes differ, gravity is '
                    'wrong; publish the transform or set scale.imu_to_camera')
        return True

    def _hand_over(self, frames: list[Frame]) -> None:
        dropped = self._synchronizer.take_dropped()
        if dropped:
            self._on_dropped(dropped)
        for frame in frames:
            self._unpaired_since_s = math.inf
            self._compare_frame_ids(frame)
            self._on_frame(frame)

    def _compare_frame_ids(self, frame: Frame) -> None:
        """Warn once if the frame_ids of image, depth and CameraInfo are of different cameras."""
        ids = (frame.image.header.frame_id, frame.camera_info.header.frame_id,
               (frame.depth or frame.image).header.frame_id)
        if ids in self._frame_ids or len(self._frame_ids) >= _MOST_FRAME_IDS:
            return
        self._frame_ids.add(ids)
        if len(set(filter(None, ids))) > 1:
            roles = dict(zip((self._anchor, 'camera_info', self._depth_role), ids, strict=True))
            named = ', '.join(f'"{plain(frame_id, _SHOWN)}" of {self._names[role]}'
                              for role, frame_id in roles.items())
            self._node.get_logger().warning(
                f'the frame_ids differ: {named}. Depth must be registered to the image, and '
                'CameraInfo must belong to the image: check whether the driver has such topics')


def _rounded_up(seconds: float) -> str:
    """Return a time with one digit, slightly above the given one: 0.06 s -> 0.08."""
    most_s = 1.2 * seconds
    step_s = 10.0 ** math.floor(math.log10(most_s))
    return f'{math.ceil(most_s / step_s) * step_s:.6g}'


def depth_role(depth: DepthConfig) -> str:
    """Return the name by which the topic of measured depth is remapped."""
    return 'depth/points' if depth.source == 'points' else 'depth'


def anchor_role(depth: DepthConfig) -> str:
    """Return the role of the messages that start a frame: images, or depth without images."""
    return 'image' if depth.colour == 'image' else depth_role(depth)


def depth_type(depth: DepthConfig) -> Any:
    """Return the type of the messages of measured depth."""
    if depth.source == 'points':
        return PointCloud2
    return CompressedImage if depth.transport == 'compressedDepth' else Image


def input_topics(node: Node, image_transport: str, depth: DepthConfig) -> dict[str, str]:
    """
    Return the full names of the inputs, by the names used for remapping.

    The compressed topics follow ``image`` and ``depth``, as in image_transport, and
    ``camera_info`` is in the namespace of the image, or of depth without one, unless they are
    remapped themselves.
    """
    of_image = COMPRESSED if image_transport == 'compressed' else ''
    of_depth = COMPRESSED_DEPTH if depth.transport == 'compressedDepth' else ''
    names = {'image': _in_transport(node, 'image', of_image),
             'depth': _in_transport(node, 'depth', of_depth),
             'depth/points': node.resolve_topic_name('depth/points'),
             'imu': node.resolve_topic_name('imu')}
    camera_info = node.resolve_topic_name('camera_info')
    if not _is_remapped(node, 'camera_info'):
        base = names[anchor_role(depth)].removesuffix(COMPRESSED).removesuffix(COMPRESSED_DEPTH)
        camera_info = f'{base.rpartition("/")[0]}/camera_info'
    return {**names, 'camera_info': camera_info}


def _in_transport(node: Node, topic: str, suffix: str) -> str:
    """Return the name of a topic in a transport, which can be remapped itself."""
    if suffix and _is_remapped(node, topic + suffix):
        return node.resolve_topic_name(topic + suffix)
    name = node.resolve_topic_name(topic)
    return name.removesuffix(suffix) + suffix if suffix else name


def _is_remapped(node: Node, topic: str) -> bool:
    return node.resolve_topic_name(topic) != node.resolve_topic_name(topic, only_expand=True)
