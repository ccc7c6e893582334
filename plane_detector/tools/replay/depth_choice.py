# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the depth for a bag, with the reason: measured if available, else a network."""

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
    Source of depth.

    Attributes
    ----------
    config : Config
        With this source set.
    topic : str
        Topic of measured depth if one was found, else empty.
    why : str
        Readable reason.

    """

    config: Config
    topic: str
    why: str

    def describe(self, detector: PlaneDetector) -> str:
        """Return one line with the source and the reason."""
        if self.config.depth.source == 'topic':
            return f'measured: {self.why}'
        facts = detector.source.facts
        reason = facts.get('depth_model_reason', '')
        return (f'network {facts["depth_model"]}{f" ({reason})" if reason else ""}, '
                f'{self.why}')


def choose_depth(bag: BagReader, camera: InputTopics, options: ReplayOptions) -> DepthChoice:
    """
    Return measured depth if the bag has it for this image, unless another source is requested.

    Raises
    ------
    BagError
        Several depth topics fit.

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
    return DepthChoice(measured, topic, f'{what}; --network uses a network instead')


def make_detector(config: Config, depth_model: ModelOrFunction | None,
                  thread: int) -> PlaneDetector:
    """
    Return a pipeline; its network is reused if this thread has loaded it before.

    Parameters
    ----------
    config : Config
    depth_model : DepthModel, callable or None
        Used instead of the network.
    thread : int
        Id of the thread that will use it: threads do not share a network.

    """
    if depth_model is None and config.depth.source == 'model':
        depth_model = _network(config.depth, thread)
    return PlaneDetector(config, depth_model)


@lru_cache(maxsize=8)
def _network(config: DepthConfig, _thread: int) -> DepthEstimator:
    """Return a network, cached per thread: a worker loads it once for all its bags."""
    return DepthEstimator(config)
