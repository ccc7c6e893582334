# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms of a bag."""

from __future__ import annotations

from plane_detector.config import NodeConfig
from plane_detector.ros.inputs.transform_buffer import TransformBuffer
from plane_detector.ros.inputs.transforms import FrameTransforms
from plane_detector.tools.replay.bag_reader import BagError, BagReader

_TYPES = ('tf2_msgs/msg/TFMessage', 'tf/msg/tfMessage')
_STATIC_NAME = 'tf_static'


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
    topics = [topic.name for topic in bag.topics if topic.msg_type in _TYPES and topic.count]
    if not topics:
        raise BagError('base_frame and target_frame need transforms, tf2_msgs/msg/TFMessage on '
                       f'/tf and /tf_static. {bag.describe()}')
    buffer = TransformBuffer()
    for recorded in bag.read(topics):
        is_static = recorded.topic.rpartition('/')[2] == _STATIC_NAME
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
