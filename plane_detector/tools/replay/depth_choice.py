# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Where the depth of a bag comes from, and why: measured where it is there, else a network."""

from __future__ import annotations

from dataclasses import dataclass, replace

from plane_detector.config import Config
from plane_detector.pipeline import PlaneDetector
from plane_detector.tools.replay.bag_reader import BagReader
from plane_detector.tools.replay.bag_topics import InputTopics, registered_depth
from plane_detector.tools.replay.options import ReplayOptions


@dataclass(frozen=True)
class DepthChoice:
    """
    Where depth comes from.

    Attributes
    ----------
    config : Config
        With that source.
    topic : str
        Of measured depth, where it was looked for and found; else empty.
    why : str
        The reason, for people.

    """

    config: Config
    topic: str
    why: str

    def describe(self, detector: PlaneDetector) -> str:
        """Return in one line what depth it is and why."""
        if self.config.depth.source == 'topic':
            return f'measured: {self.why}'
        facts = detector.source.facts
        reason = facts.get('depth_model_reason', '')
        return (f'network {facts["depth_model"]}{f" ({reason})" if reason else ""}, '
                f'{self.why}')


def choose_depth(bag: BagReader, camera: InputTopics, options: ReplayOptions) -> DepthChoice:
    """
    Take measured depth where the bag has it for this image, unless another source is asked for.

    Raises
    ------
    BagError
        Several depth topics may be meant.

    """
    config, asked = options.config, options.topics.get('depth', '')
    if not options.depth_by_bag:
        source = config.depth.source
        if source == 'model':
            return DepthChoice(config, '', 'not measured depth, as asked for')
        return DepthChoice(config, '', f'{asked or "the depth topic"}, as asked for')
    topic, what = registered_depth(bag, camera)
    if not topic:
        return DepthChoice(config, '', f'because {what}')
    measured = replace(config, depth=replace(config.depth, source='topic'))
    return DepthChoice(measured, topic, f'{what}; --network takes a network instead')
