# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a bag in the order in which they are complete, their copies, and its transforms."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import numpy as np

from plane_detector.config import NodeConfig
from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer
from plane_detector.ros.inputs.transform_buffer import TransformBuffer
from plane_detector.ros.inputs.transforms import FrameTransforms
from plane_detector.tools.replay.bag_reader import BagError, BagReader, Recorded, to_message
from plane_detector.tools.replay.bag_writer import BagWriter
from plane_detector.tools.replay.input_topics import InputTopics, input_class
from plane_detector.tools.replay.options import ReplayOptions

# derived: an image waits for its partners while at most 16 others do, see FrameSynchronizer.
_WAITING = 64
_TRANSFORM_TYPES = ('tf2_msgs/msg/TFMessage', 'tf/msg/tfMessage')


class FrameReader:
    """
    Reads messages recorded from one time up to another, and assembles frames.

    Messages that cannot be decoded are skipped and counted in ``damaged``.
    """

    def __init__(self, bag: BagReader, topics: InputTopics, times_ns: tuple[int, int],
                 synchronizer: FrameSynchronizer):
        self.bag, self.topics, self.damaged = bag, topics, 0
        self._start_ns, self._stop_ns = times_ns
        self._synchronizer = synchronizer

    def frames(self, copies: CopiedMessages) -> Iterator[tuple[int, Frame]]:
        """Yield frames, each with the time at which its last message was recorded."""
        topics, synchronizer, time_ns = self.topics, self._synchronizer, self._start_ns
        add = {topics.image: synchronizer.add_image,
               topics.camera_info: synchronizer.add_camera_info,
               topics.depth: synchronizer.add_depth, topics.imu: synchronizer.add_imu}
        classes = {name: input_class(self.bag, name) for name in topics.names}
        self._add_first_calibration()
        for recorded in self.bag.read({*topics.names, *copies.topics}, self._start_ns,
                                      self._stop_ns):
            time_ns, msg = recorded.time_ns, None
            if recorded.topic in classes:
                try:
                    msg = to_message(recorded, classes[recorded.topic])
                except BagError:
                    self.damaged += 1
            copies.add(recorded, msg)
            if msg is not None:
                yield from ((time_ns, frame) for frame in add[recorded.topic](msg) or ())
        yield from ((time_ns, frame) for frame in synchronizer.finish())

    def take_dropped(self) -> int:
        """Return the number of images without calibration or depth."""
        return self._synchronizer.take_dropped()

    def expected_frames(self, every: int) -> int:
        """Return the approximate number of frames if one of ``every`` is processed."""
        count = {topic.name: topic.count for topic in self.bag.topics}[self.topics.image]
        length_ns = max(self.bag.end_ns - self.bag.start_ns, 1)
        share = np.clip((self._stop_ns - self._start_ns) / length_ns, 0, 1)
        return int(np.ceil(count * share / every))

    def _add_first_calibration(self) -> None:
        """Add a CameraInfo for the images before the first one, and after a late start."""
        topic = self.topics.camera_info
        kind = input_class(self.bag, topic)
        self._synchronizer.add_camera_info(
            self.bag.last_before(self._start_ns + 1, topic, kind) or self.bag.first(topic, kind))


class CopiedMessages:
    """
    Copies messages of some topics into the new bag.

    If only one frame of ``every`` is processed, only its image, calibration and depth are copied,
    but all messages of other topics.
    """

    def __init__(self, writer: BagWriter, topics: tuple[str, ...], inputs: InputTopics,
                 every: int):
        self.topics = frozenset(topics)
        self._writer, self._inputs = writer, inputs
        of_frames = (inputs.image, inputs.camera_info, inputs.depth)
        self._waiting: dict[str, OrderedDict[tuple[int, int], Recorded]] = {
            name: OrderedDict() for name in of_frames if every > 1 and name in self.topics}

    def add(self, recorded: Recorded, msg: Any) -> None:
        """Copy a message, or keep it until its frame is taken; ``msg`` is None if damaged."""
        if recorded.topic not in self.topics:
            return
        waiting = self._waiting.get(recorded.topic)
        if waiting is None:
            self._writer.copy(recorded)
        elif msg is not None:
            waiting[_stamp(msg)] = recorded
            while len(waiting) > _WAITING:
                waiting.popitem(last=False)

    def take(self, frame: Frame) -> None:
        """Copy the messages of a frame that were not copied with an earlier one."""
        for topic, msg in ((self._inputs.image, frame.image), (self._inputs.depth, frame.depth),
                           (self._inputs.camera_info, frame.camera_info)):
            if msg is not None and topic in self._waiting:
                recorded = self._waiting[topic].pop(_stamp(msg), None)
                if recorded is not None:
                    self._writer.copy(recorded)


def requested_times(bag: BagReader, image: str, options: ReplayOptions) -> tuple[int, int]:
    """Return start and end of the replay; raise BagError if there is no image between them."""
    length_ns = bag.end_ns - bag.start_ns
    start_ns = bag.start_ns + round(min(options.start_s * 1e9, length_ns))
    stop_ns = start_ns + round(min(options.duration_s * 1e9, bag.end_ns - start_ns))
    if start_ns == stop_ns or not any(bag.read([image], start_ns, stop_ns)):
        raise BagError(
            f'{options.source} spans 0 to {length_ns * 1e-9:.3f} s, and in the requested part, '
            f'--start {options.start_s:g} --duration {options.duration_s:g}, there is '
            f'no image on {image}')
    return start_ns, stop_ns


def read_transforms(bag: BagReader, settings: NodeConfig) -> FrameTransforms | None:
    """
    Return all transforms of a bag; None if the settings name no frame.

    All are read before the first image, because they may be recorded after the image they precede.
    Damaged messages and invalid transforms are skipped and counted in ``bag.damaged``.

    Raises
    ------
    BagError
        A frame is named, but the bag has no transforms.

    """
    if not (settings.base_frame or settings.target_frame):
        return None
    topics = [topic.name for topic in bag.topics
              if topic.msg_type in _TRANSFORM_TYPES and topic.count]
    if not topics:
        raise BagError('base_frame and target_frame need transforms, tf2_msgs/msg/TFMessage on '
                       f'/tf and /tf_static. {bag.describe()}')
    buffer = TransformBuffer()
    for recorded in bag.read(topics):
        is_static = recorded.topic.rpartition('/')[2] == 'tf_static'
        try:
            transforms = bag.plain(recorded).transforms
        except Exception:  # damaged bytes may cause any exception in a parser
            bag.damaged += 1
            continue
        for transform in transforms:
            try:
                buffer.add(transform, is_static)
            except ValueError:  # recorders keep them, tf2 ignores them
                bag.damaged += 1
    return FrameTransforms(buffer)


def _stamp(msg: Any) -> tuple[int, int]:
    return msg.header.stamp.sec, msg.header.stamp.nanosec
