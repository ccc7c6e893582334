# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Why messages do not arrive: silent topics, and fewer images than CameraInfo."""

from __future__ import annotations

import difflib
import statistics
import time
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from plane_detector.ros.inputs.depth_decoding import COMPRESSED_DEPTH
from plane_detector.ros.inputs.synchronizer import JUMP_NS

# chosen: discovery takes about a second on a busy machine; silence before that means nothing.
GRACE_S = 2.0
# chosen: a topic has stopped after this many of its usual intervals, which allows for slow
# cameras; before the second message the interval is assumed to be this.
_STOPPED_INTERVALS = 3.0
_FIRST_INTERVAL_S = 5.0
_REMEMBERED = 6
_LISTED = 8
COMPRESSED = '/compressed'
_RAW_TYPE, _COMPRESSED_TYPE = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
# By role: the parameter of the transport, and its value for compressed messages.
_TRANSPORTS = {'image': ('image_transport', 'compressed'),
               'depth': ('depth.transport', 'compressedDepth')}
MESSAGES_LOST = (
    'messages of Fast DDS are lost between processes unless the camera, too, was started after '
    'export FASTRTPS_DEFAULT_PROFILES_FILE=$(ros2 pkg prefix --share '
    'plane_detector)/config/fastdds_large_messages.xml')


@dataclass
class _Topic:
    """State of one input."""

    name: str  # resolved
    type_name: str  # as in sensor_msgs/msg/Image
    may_stop: bool  # a single message is enough
    only_reliable: bool  # best-effort publishers are rejected
    is_needed: bool = True  # no frame is possible without it
    heard_s: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))  # arrivals
    offered_s: float | None = None  # when a publisher was first seen
    problem: str = ''  # last logged one; empty if there is none


class TopicWatch:
    """Records the arrival of messages, and reports which topic is silent and why."""

    def __init__(self, node: Node):
        self._node, self._start_s = node, time.monotonic()
        self._topics: dict[str, _Topic] = {}

    def add(self, role: str, topic: str, msg_type: Any, may_stop: bool = False,
            only_reliable: bool = False, is_needed: bool = True) -> None:
        """Watch a topic by its resolved name; ``role`` is its name for remapping."""
        package = msg_type.__module__.split('.')[0]
        self._topics[role] = _Topic(topic, f'{package}/msg/{msg_type.__name__}', may_stop,
                                    only_reliable, is_needed)

    def heard(self, role: str) -> None:
        """Record the arrival of a message."""
        self._topics[role].heard_s.append(time.monotonic())

    def problem(self) -> str:
        """Return the problems, silent topics first; log changes."""
        now_s = time.monotonic()
        for role, topic in self._topics.items():
            self._note(topic, self._problem_of(role, topic, now_s))
        unheard_first = sorted(self._topics.values(), key=lambda topic: bool(topic.heard_s))
        return next((topic.problem for topic in unheard_first if topic.problem), '')

    def obstacle(self) -> str:
        """Return the last problem that prevents frames; empty if there is none."""
        return next((topic.problem for topic in self._topics.values()
                     if topic.is_needed and topic.problem), '')

    def _problem_of(self, role: str, topic: _Topic, now_s: float) -> str:
        if not topic.heard_s:
            return self._unheard(role, topic, now_s)
        interval_s = _usual_interval(topic.heard_s, _FIRST_INTERVAL_S)
        patience_s = max(GRACE_S, _STOPPED_INTERVALS * interval_s)
        if topic.may_stop or now_s - topic.heard_s[-1] < patience_s:
            return ''
        stopped = f'{topic.name} has stopped: no message for over {patience_s:.0f} s'
        if topic.problem.startswith(stopped):  # logged once, even if its publisher leaves later
            return topic.problem
        may_be_lost = ReliabilityPolicy.BEST_EFFORT in self._reliabilities(topic)
        return stopped + (f'; if the camera still sends: large best-effort {MESSAGES_LOST}'
                          if may_be_lost else '')

    def _unheard(self, role: str, topic: _Topic, now_s: float) -> str:
        """Return why no message has arrived; a new publisher has time for its first message."""
        offered = self._reliabilities(topic)
        if not offered:
            topic.offered_s = None
            return self._explain(role, topic) if now_s - self._start_s >= GRACE_S else ''
        topic.offered_s = now_s if topic.offered_s is None else topic.offered_s
        if now_s - max(topic.offered_s, self._start_s) < GRACE_S:
            return topic.problem
        if topic.only_reliable and ReliabilityPolicy.BEST_EFFORT in offered:
            return (f'nothing arrives on {topic.name}: the parameter input_reliability asks for '
                    'reliable, the publisher is best effort: set it to auto or best_effort')
        publishers = 'a publisher' if len(offered) == 1 else f'{len(offered)} publishers'
        return (f'nothing arrives on {topic.name}, though it has {publishers}. Either nothing is '
                'sent (check with ros2 topic hz), or the QoS does not match, or messages are '
                f'lost: large {MESSAGES_LOST}')

    def _reliabilities(self, topic: _Topic) -> list[ReliabilityPolicy]:
        """Return the reliabilities offered by publishers of the right type."""
        return [info.qos_profile.reliability
                for info in self._node.get_publishers_info_by_topic(topic.name)
                if info.topic_type == topic.type_name]

    def _explain(self, role: str, topic: _Topic) -> str:
        types = [info.topic_type for info in self._node.get_publishers_info_by_topic(topic.name)]
        own = self._node.get_fully_qualified_name() + '/'
        used = {other.name for other in self._topics.values() if other.heard_s}
        published = {name: types[0] for name, types in self._node.get_topic_names_and_types()
                     if not name.startswith(own) and name not in used
                     and self._node.count_publishers(name)}
        return explain_silence(role, topic.name, topic.type_name, types, published)

    def _note(self, topic: _Topic, problem: str) -> None:
        if problem and problem != topic.problem:
            self._node.get_logger().warning(problem)
        elif topic.problem and not problem:
            self._node.get_logger().info(f'messages arrive on {topic.name}')
        topic.problem = problem


def explain_silence(role: str, topic: str, type_name: str, offered: Sequence[str],
                    published: Mapping[str, str]) -> str:
    """
    Return why a topic has no publisher of its type, and the remedy.

    ``offered`` are the types of its publishers, all different from that of the subscription;
    ``published`` are the types of all topics that other nodes publish and no input uses. Topics
    are remapped by their ``role``.
    """
    if offered:
        return (f'{topic} is published as {offered[0]}, not as {type_name}'
                + _transport_hint(role, topic, offered[0]))
    same = _nearest_first(topic, [name for name, kind in published.items()
                                  if kind == type_name and _fits(role, name, kind)])
    if not same:
        by_name = {'depth': ' with depth in its name', 'image': ' without depth in its name'}
        return (f'nobody publishes {topic}, and there is no other topic of type {type_name}'
                + by_name.get(role, '')
                + _other_transport(role, topic, type_name, published))
    listed = ', '.join(same[:_LISTED]) + (', ...' if len(same) > _LISTED else '')
    return (f'nobody publishes {topic}; of type {type_name} there are {listed}: remap with '
            f'--ros-args -r {role}:={_without_transport(same[0])}')


def _fits(role: str, name: str, kind: str) -> bool:
    """Return whether the name of a topic fits: depth, and only depth, has depth in its name."""
    if role not in _TRANSPORTS:
        return True
    is_depth = 'depth' in name.lower()
    suffix_fits = role == 'image' or kind != _COMPRESSED_TYPE or name.endswith(COMPRESSED_DEPTH)
    return is_depth == (role == 'depth') and suffix_fits


def _without_transport(name: str) -> str:
    return name.removesuffix(COMPRESSED).removesuffix(COMPRESSED_DEPTH)


def _nearest_first(topic: str, names: Collection[str]) -> list[str]:
    """Return names in the order of their similarity to that of the topic."""
    return sorted(names, key=lambda name: (
        -difflib.SequenceMatcher(None, topic, name).ratio(), name))


def _transport_hint(role: str, topic: str, offered: str) -> str:
    """Return the setting that accepts the type of a topic."""
    if role not in _TRANSPORTS or offered not in (_RAW_TYPE, _COMPRESSED_TYPE):
        return ''
    parameter, compressed = _TRANSPORTS[role]
    if offered == _COMPRESSED_TYPE:
        return f': set {parameter} to {compressed} and remap {role} to {_without_transport(topic)}'
    return f': set {parameter} to raw'


def _other_transport(role: str, topic: str, type_name: str, published: Mapping[str, str]) -> str:
    """Return the setting that accepts the published images, if they use the other transport."""
    other = {_RAW_TYPE: _COMPRESSED_TYPE, _COMPRESSED_TYPE: _RAW_TYPE}.get(type_name, '')
    names = _nearest_first(topic, [name for name, kind in published.items()
                                   if kind == other and _fits(role, name, kind)])
    if role not in _TRANSPORTS or not names:
        return ''
    parameter, compressed = _TRANSPORTS[role]
    value = compressed if other == _COMPRESSED_TYPE else 'raw'
    return f'; {names[0]} is a {other}: set {parameter} to {value}'


def _usual_interval(times: Iterable[float], before_second: float) -> float:
    """Return the median interval, or the assumed one before the second message."""
    return statistics.median([after - before for before, after in pairwise(times)]
                             or [before_second])


# chosen: long enough to count losses of a fifth, short enough to follow a camera.
_WINDOW_NS = 5_000_000_000
_MOST_STAMPS = 1000
_FEWEST_INFOS = 20
WARNED_SHARE = 0.2
"""The node warns if at least this share of the images is missing, compared with CameraInfo."""


class Arrivals(NamedTuple):
    """Images and CameraInfo that arrived in a window."""

    images: int
    camera_infos: int

    @property
    def are_few(self) -> bool:
        """Whether enough images are missing for a warning."""
        return (self.camera_infos >= _FEWEST_INFOS
                and self.images <= (1 - WARNED_SHARE) * self.camera_infos)


class ArrivalCount:
    """Counts images and CameraInfo, which is small and arrives even if its image is lost."""

    def __init__(self) -> None:
        self._images: deque[int] = deque(maxlen=_MOST_STAMPS)
        self._infos: deque[int] = deque(maxlen=_MOST_STAMPS)

    def add(self, stamp_ns: int, is_image: bool) -> None:
        """Count an image or a CameraInfo."""
        stamps = self._images if is_image else self._infos
        if stamps and stamp_ns < stamps[-1] - JUMP_NS:  # time jumped back
            stamps.clear()
        stamps.append(stamp_ns)

    @property
    def period_s(self) -> float:
        """Usual time between two images; infinite before the second."""
        return _usual_interval(sorted(set(self._images)), float('inf')) * 1e-9

    def arrivals(self) -> Arrivals:
        """Return the counts for the last seconds before the last image."""
        if not self._images:
            return Arrivals(0, 0)
        last_ns = self._images[-1]
        first_ns = max(min(self._images), last_ns - _WINDOW_NS)
        return Arrivals(*(len({stamp_ns for stamp_ns in stamps if first_ns <= stamp_ns <= last_ns})
                          for stamps in (self._images, self._infos)))
