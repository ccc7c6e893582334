# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the input bag that are copied into the new one."""

from __future__ import annotations

from collections import Counter, OrderedDict
from typing import Any

from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.tools.replay.bag_reader import Recorded
from plane_detector.tools.replay.bag_topics import InputTopics
from plane_detector.tools.replay.bag_writer import BagWriter

# derived: an image waits for its partners while at most 16 others do, see FrameSynchronizer.
_WAITING = 64


class CopiedMessages:
    """
    Copies messages: all of them, or only those of the processed frames.

    Parameters
    ----------
    writer : BagWriter
    topics : tuple of str
        Topics to copy.
    inputs : InputTopics
        Image, calibration and depth belong to frames; other topics are copied completely.
    every : int
        One frame in this many is copied.
    done : Counter of str
        Number of messages of each topic that an earlier run copied: the first ones, because the
        order is the same in every run.

    """

    def __init__(self, writer: BagWriter, topics: tuple[str, ...], inputs: InputTopics, every: int,
                 done: Counter[str]):
        self.topics = frozenset(topics)
        self._writer, self._inputs, self._done = writer, inputs, Counter(done)
        of_frames = (inputs.image, inputs.camera_info, inputs.depth)
        self._waiting: dict[str, OrderedDict[tuple[int, int], Recorded]] = {
            name: OrderedDict() for name in of_frames if every > 1 and name in self.topics}

    def add(self, recorded: Recorded, msg: Any) -> None:
        """Copy a message, or keep it until its frame is taken; ``msg`` is None if damaged."""
        if recorded.topic not in self.topics:
            return
        waiting = self._waiting.get(recorded.topic)
        if waiting is None:
            self._copy(recorded)
        elif msg is not None:
            waiting[_stamp(msg)] = recorded
            while len(waiting) > _WAITING:
                waiting.popitem(last=False)

    def take(self, frame: Frame) -> None:
        """Copy the messages of a frame."""
        for topic, msg in ((self._inputs.image, frame.image), (self._inputs.depth, frame.depth),
                           (self._inputs.camera_info, frame.camera_info)):
            if msg is not None and topic in self._waiting:
                recorded = self._waiting[topic].pop(_stamp(msg), None)
                if recorded is not None:  # None: copied with an earlier frame
                    self._copy(recorded)

    def _copy(self, recorded: Recorded) -> None:
        if self._done[recorded.topic]:
            self._done[recorded.topic] -= 1
        else:
            self._writer.copy(recorded)


def _stamp(msg: Any) -> tuple[int, int]:
    return msg.header.stamp.sec, msg.header.stamp.nanosec
