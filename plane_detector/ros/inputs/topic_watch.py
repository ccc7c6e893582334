# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Why messages do not arrive: silent topics, and images lost on their way."""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

# derived: discovery takes about a second on a busy machine; silence before that means nothing.
GRACE_S = 2.0
# derived: a topic has stopped after this many of its usual intervals, which allows for slow
# cameras; before the second message the interval is assumed to be this.
_STOPPED_INTERVALS = 3.0
_FIRST_INTERVAL_S = 5.0
_REMEMBERED = 6
_LISTED = 8
COMPRESSED = '/compressed'
MESSAGES_LOST = 'messages get lost between processes without config/fastdds_large_messages.xml'


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

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic):
        self._node, self._clock = node, clock
        self._start_s = clock()
        self._topics: dict[str, _Topic] = {}

    def add(self, role: str, topic: str, msg_type: Any, may_stop: bool = False,
            only_reliable: bool = False, is_needed: bool = True) -> None:
        """Watch a topic by its resolved name; ``role`` is its name for remapping."""
        package = msg_type.__module__.split('.')[0]
        self._topics[role] = _Topic(topic, f'{package}/msg/{msg_type.__name__}', may_stop,
                                    only_reliable, is_needed)

    def heard(self, role: str) -> None:
        """Record the arrival of a message."""
        self._topics[role].heard_s.append(self._clock())

    def problem(self) -> str:
        """Return the problems, silent topics first; log changes."""
        now_s = self._clock()
        for role, topic in self._topics.items():
            self._note(topic, self._problem_of(role, topic, now_s))
        unheard_first = sorted(self._topics.values(), key=lambda topic: bool(topic.heard_s))
        return next((topic.problem for topic in unheard_first if topic.problem), '')

    def obstacle(self) -> str:
        """Return the last problem because of which no frame can come; empty if there is none."""
        return next((topic.problem for topic in self._topics.values()
                     if topic.is_needed and topic.problem), '')

    def _problem_of(self, role: str, topic: _Topic, now_s: float) -> str:
        if not topic.heard_s:
            return self._unheard(role, topic, now_s)
        interval_s = _interval_s(topic.heard_s)
        patience_s = max(GRACE_S, _STOPPED_INTERVALS * interval_s)
        if topic.may_stop or now_s - topic.heard_s[-1] < patience_s:
            return ''
        stopped = f'{topic.name} has stopped: no message for over {patience_s:.0f} s'
        if topic.problem.startswith(stopped):  # logged once, even if its publisher goes later
            return topic.problem
        return stopped + _hint_of_loss(self._reliabilities(topic))

    def _unheard(self, role: str, topic: _Topic, now_s: float) -> str:
        """Return why no message has arrived; a new publisher has time for its first message."""
        offered = self._reliabilities(topic)
        if not offered:
            topic.offered_s = None
            return self._explain(role, topic) if now_s - self._start_s >= GRACE_S else ''
        topic.offered_s = now_s if topic.offered_s is None else topic.offered_s
        if now_s - max(topic.offered_s, self._start_s) < GRACE_S:
            return topic.problem
        return explain_loss(topic.name, offered, topic.only_reliable)

    def _reliabilities(self, topic: _Topic) -> list[ReliabilityPolicy]:
        """Return the reliabilities offered by publishers of the right type."""
        return [info.qos_profile.reliability
                for info in self._node.get_publishers_info_by_topic(topic.name)
                if info.topic_type == topic.type_name]

    def _explain(self, role: str, topic: _Topic) -> str:
        types = [info.topic_type for info in self._node.get_publishers_info_by_topic(topic.name)]
        own = self._node.get_fully_qualified_name() + '/'
        published = {name: types[0] for name, types in self._node.get_topic_names_and_types()
                     if not name.startswith(own) and self._node.count_publishers(name)}
        return explain_silence(role, topic.name, topic.type_name, types, published)

    def _note(self, topic: _Topic, problem: str) -> None:
        if problem and problem != topic.problem:
            self._node.get_logger().warning(problem)
        elif topic.problem and not problem:
            self._node.get_logger().info(f'messages arrive on {topic.name}')
        topic.problem = problem


def explain_loss(topic: str, offered: Sequence[ReliabilityPolicy], only_reliable: bool) -> str:
    """Return why nothing has arrived on a topic that has publishers, and the remedy."""
    if only_reliable and ReliabilityPolicy.BEST_EFFORT in offered:
        return (f'nothing arrives on {topic}: the parameter input_reliability asks for reliable, '
                'the publisher is best effort: set it to auto or best_effort')
    return (f'nothing arrives on {topic}, though it has {len(offered)} publisher(s): it sends '
            f'nothing, large {MESSAGES_LOST}, or the QoS does not fit')


def _hint_of_loss(offered: Sequence[ReliabilityPolicy]) -> str:
    """Return another possible cause than a stopped camera; empty if there is none."""
    if ReliabilityPolicy.BEST_EFFORT not in offered:
        return ''
    return f'; if the camera still sends: large best-effort {MESSAGES_LOST}'


def explain_silence(role: str, topic: str, type_name: str, offered: Sequence[str],
                    published: Mapping[str, str]) -> str:
    """
    Return why a topic has no publisher of its type, and the remedy.

    ``offered`` are the types of its publishers, all different from that of the subscription;
    ``published`` are the types of all topics that other nodes publish. Topics are remapped by
    their ``role``.
    """
    if offered:
        return (f'{topic} is published as {offered[0]}, not as {type_name}'
                + _transport_hint(topic, offered[0]))
    same = sorted(name for name, kind in published.items() if kind == type_name)
    if not same:
        return (f'nobody publishes {topic}, nor any other topic of type {type_name}'
                + _other_transport(type_name, published))
    listed = ', '.join(same[:_LISTED]) + (', ...' if len(same) > _LISTED else '')
    return (f'nobody publishes {topic}; of type {type_name} there are {listed}: remap with '
            f'--ros-args -r {role}:={same[0].removesuffix(COMPRESSED)}')


def _transport_hint(topic: str, offered: str) -> str:
    if offered.endswith('/CompressedImage'):
        return (f': set image_transport to compressed and remap image to '
                f'{topic.removesuffix(COMPRESSED)}')
    return ': set image_transport to raw' if offered.endswith('/Image') else ''


def _other_transport(type_name: str, published: Mapping[str, str]) -> str:
    """Return the parameter that accepts the published images, if they use the other transport."""
    other = {'sensor_msgs/msg/Image': ('CompressedImage', 'compressed'),
             'sensor_msgs/msg/CompressedImage': ('Image', 'raw')}.get(type_name)
    if other is None:
        return ''
    names = sorted(name for name, kind in published.items() if kind.endswith(f'/{other[0]}'))
    return (f'; {names[0]} is a sensor_msgs/msg/{other[0]}: set image_transport to {other[1]}'
            if names else '')


def _interval_s(heard_s: Sequence[float]) -> float:
    """Return the usual time between two messages."""
    times_s = list(heard_s)
    intervals_s = [after - before for before, after in zip(times_s, times_s[1:], strict=False)]
    return statistics.median(intervals_s) if intervals_s else _FIRST_INTERVAL_S


# derived: a window long enough to count losses of a fifth, short enough to follow a camera that
# changes its rate.
_WINDOW_NS = 5_000_000_000
_MOST_STAMPS = 1000
# derived: of half of the images lost at random, ten in a row are one in a thousand; a longer gap
# is a pause of the camera.
_LONGEST_GAP = 10
_FEWEST_IMPLIED = 20
# derived: stamps without any period are on average .25 of a period off its multiples; those of a
# constant rate with a jitter of .15 of the period .1.
_MOST_OFF = 0.15
# derived: of images lost at random, a fifth or more, two thirds of the intervals at most equal one
# that comes a fixed number of intervals later.
_LONGEST_RHYTHM, _REPEATED_SHARE = 6, 0.9
# derived: a camera that sends a CameraInfo with each image gives both the same stamp.
_PAIRED_SHARE = 0.5
_JUMP_NS = 1_000_000_000
WARNED_SHARE = 0.2
"""From this share of lost images on, the node warns."""


class Arrivals(NamedTuple):
    """Images that arrived in a window, and images that the stamps imply for it."""

    received: int
    implied: int

    @property
    def are_few(self) -> bool:
        """Whether so many images are missing that a warning is due."""
        return (self.implied >= _FEWEST_IMPLIED
                and self.received <= (1 - WARNED_SHARE) * self.implied)


class ImageLoss:
    """
    Counts images, and the stamps between which the camera sends at a constant rate.

    A CameraInfo is small and arrives where its image is lost: its stamp counts as sent. Stamps
    without a period, such as those of a camera that is triggered, imply no other images, nor does
    a rhythm that repeats, such as that of a throttled topic, or a new rate.
    """

    def __init__(self) -> None:
        self._images: deque[int] = deque(maxlen=_MOST_STAMPS)
        self._infos: deque[int] = deque(maxlen=_MOST_STAMPS)

    def add_image(self, stamp_ns: int) -> None:
        """Count an image."""
        if self._images and stamp_ns < self._images[-1] - _JUMP_NS:  # time jumped back
            self._images.clear()
            self._infos = deque((other_ns for other_ns in self._infos
                                 if other_ns <= stamp_ns + _JUMP_NS), _MOST_STAMPS)
        self._images.append(stamp_ns)

    def add_camera_info(self, stamp_ns: int) -> None:
        """Count a stamp."""
        self._infos.append(stamp_ns)

    def arrivals(self) -> Arrivals:
        """Return the numbers for the last seconds before the last image."""
        if not self._images:
            return Arrivals(0, 0)
        images = np.unique(self._images)
        images = images[images >= images[-1] - _WINDOW_NS]
        infos = np.unique(self._infos)
        infos = infos[(infos >= images[0]) & (infos <= images[-1])]
        is_paired = np.isin(images, infos).mean() > _PAIRED_SHARE
        sent = np.union1d(images, infos) if is_paired else images
        return Arrivals(len(images), _implied(sent))


def _implied(stamps_ns: np.ndarray) -> int:
    """Return how many stamps a camera has given, from sorted ones of which some are missing."""
    intervals = np.diff(stamps_ns)
    if len(stamps_ns) < _FEWEST_IMPLIED:
        return len(stamps_ns)
    # The shortest intervals are one period, the others several; stamps may jitter.
    periods = intervals / np.median(intervals[intervals < 1.5 * np.quantile(intervals, 0.2)])
    steps = np.rint(periods)
    steps[steps > _LONGEST_GAP] = 1
    repeats = max((steps[lag:] == steps[:-lag]).mean() for lag in range(1, _LONGEST_RHYTHM + 1))
    if abs(periods - np.rint(periods)).mean() > _MOST_OFF or repeats > _REPEATED_SHARE:
        return len(stamps_ns)
    return 1 + int(steps.sum())
