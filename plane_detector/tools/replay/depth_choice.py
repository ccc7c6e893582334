# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Where the depth of a bag comes from, and why: measured where it is there, else a network."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

from plane_detector.config import Config, DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.observation import ModelOrFunction
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
            return DepthChoice(config, '', 'not measured depth, as requested')
        return DepthChoice(config, '', f'{asked or "the depth topic"}, as requested')
    topic, what = registered_depth(bag, camera)
    if not topic:
        return DepthChoice(config, '', f'because {what}')
    measured = replace(config, depth=replace(config.depth, source='topic'))
    return DepthChoice(measured, topic, f'{what}; --network takes a network instead')


def make_detector(config: Config, depth_model: ModelOrFunction | None,
                  thread: int) -> PlaneDetector:
    """
    Return a pipeline; its network is the one that this thread has loaded before, if it is.

    Parameters
    ----------
    config : Config
    depth_model : DepthModel, callable or None
        Takes the place of the network.
    thread : int
        Who will use it: two threads do not share a network.

    """
    if depth_model is None and config.depth.source == 'model':
        depth_model = _network(config.depth, thread)
    return PlaneDetector(config, depth_model)


@lru_cache(maxsize=8)
def _network(config: DepthConfig, _thread: int) -> DepthEstimator:
    """Return a network, one for each thread: a worker loads it once for all its bags."""
    return DepthEstimator(config)
