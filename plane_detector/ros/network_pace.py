# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The rate of the network: fitted to the camera at configure, checked while the node runs."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
from sensor_msgs.msg import CameraInfo, Image

from plane_detector.config import NodeConfig
from plane_detector.depth.observation import Observation
from plane_detector.depth.plausibility import CORRIDOR_LENS, corridor
from plane_detector.geometry.disparity import to_depth, to_disparity
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.diagnostics import Report
from plane_detector.ros.frame_processor import FrameProcessor, ObservedFrame
from plane_detector.ros.inputs.frame_conversion import ConvertedFrame
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.types import Prediction

# Noise and blur of a network's depth, for timing the stages after it.
_NOISE_PER_M, _BLUR_PX = 0.005, 12.0
# Smaller differences are those of the clocks.
_TOLERANCE = 1.1


def fit_to_rate(detector: PlaneDetector) -> None:
    """Choose the largest network input that keeps ``depth.target_rate`` beside all other work."""
    processor = FrameProcessor(detector, NodeConfig(), 'image')
    observed = _observed_corridor(detector)
    detector.source.fit_to_rate(
        detector.config.depth.target_rate,
        lambda: processor.make(processor.find_planes(processor.look(observed))))
    detector.reset_directions()
    detector.reset_planes()


def _observed_corridor(detector: PlaneDetector) -> ObservedFrame:
    """Return a frame with depth like that of a network: what the other stages work on."""
    rgb, depth_m = corridor()
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.standard_normal(depth_m.shape), (0, 0), _BLUR_PX)
    noise = _NOISE_PER_M * (smooth / smooth.std() + rng.standard_normal(depth_m.shape))
    noisy_m = to_depth(to_disparity(depth_m) + noise)
    seen = Observation(rgb, CORRIDOR_LENS, detector.config, Prediction('metric_depth', noisy_m),
                       edge_blur_px=_BLUR_PX)
    return ObservedFrame(Frame(Image(), CameraInfo(), None, None, 0),
                         ConvertedFrame(rgb, CORRIDOR_LENS, None), None, seen, NodeConfig(),
                         (0, 0), {}, time.perf_counter())


def slow_network(report: Report, advise: Callable[[float], str]) -> str:
    """
    Return a message if the network takes longer than the period of the camera, else nothing.

    Parameters
    ----------
    report : Report
        Since the last one.
    advise : callable
        Returns advice for a share of the present time, see
        :class:`~plane_detector.types.DepthModel`.

    """
    depth_s = report.stage_seconds.get('depth', 0.0)
    if report.arrival_hz == 0 or depth_s * report.arrival_hz <= _TOLERANCE:
        return ''
    advice = advise(1 / (depth_s * report.arrival_hz))
    if not advice:
        return ''
    return (f'the network takes {1e3 * depth_s:.0f} ms, the camera sends an image every '
            f'{1e3 / report.arrival_hz:.0f} ms: {advice}')
