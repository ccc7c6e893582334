# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a bag, in the order in which they are complete."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer
from plane_detector.tools.replay.bag_reader import BagError, BagReader, to_message
from plane_detector.tools.replay.bag_topics import InputTopics, input_class
from plane_detector.tools.replay.copies import CopiedMessages
from plane_detector.tools.replay.options import ReplayOptions


class FrameReader:
    """
    Reads the messages of a bag and assembles frames.

    Parameters
    ----------
    bag : BagReader
    topics : InputTopics
        Topics of the frames.
    part_ns : (int, int)
        Times of recording: start, and end, which is excluded.
    synchronizer : FrameSynchronizer
        Combines messages that belong together.

    Attributes
    ----------
    damaged : int
        Number of messages that could not be decoded and were skipped.

    """

    def __init__(self, bag: BagReader, topics: InputTopics, part_ns: tuple[int, int],
                 synchronizer: FrameSynchronizer):
        self.bag, self.topics, self.damaged = bag, topics, 0
        self._start_ns, self._stop_ns = part_ns
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
        """Return the number of images without calibration or depth since the last call."""
        return self._synchronizer.take_dropped()

    def expected_frames(self, every: int) -> int:
        """Return the approximate number of frames if one of ``every`` is processed."""
        count = {topic.name: topic.count for topic in self.bag.topics}[self.topics.image]
        length_ns = max(self.bag.end_ns - self.bag.start_ns, 1)
        share = np.clip((self._stop_ns - self._start_ns) / length_ns, 0, 1)
        return int(np.ceil(count * share / every))

    def _add_first_calibration(self) -> None:
        """Add the first CameraInfo for images before it, and after a late start."""
        topic = self.topics.camera_info
        kind = input_class(self.bag, topic)
        earlier = list(self.bag.messages(topic, kind, None, self._start_ns + 1))
        self._synchronizer.add_camera_info(earlier[-1] if earlier else self.bag.first(topic, kind))


def part_asked_for(bag: BagReader, image: str, options: ReplayOptions) -> tuple[int, int]:
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
