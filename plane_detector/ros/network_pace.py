# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The rate of the network: fitted to the camera at configure, checked while the node runs."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from std_msgs.msg import Header

from plane_detector.config import NodeConfig
from plane_detector.depth.depth_function import DepthFunction
from plane_detector.depth.plausibility import CORRIDOR_LENS, corridor
from plane_detector.geometry.disparity import to_depth, to_disparity
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.diagnostics import Report
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.outputs.messages import rgb_to_msg
from plane_detector.stage_timer import median_seconds

# Noise and blur of a network's depth, for timing the stages after it.
_NOISE_PER_M, _BLUR_PX = 0.005, 12.0
# Smaller differences are those of the clocks.
_TOLERANCE = 1.1


def fit_to_rate(detector: PlaneDetector) -> None:
    """Choose the largest network input that keeps ``depth.target_rate``, if both are given."""
    rate_hz = detector.config.depth.target_rate
    if rate_hz > 0 and detector.config.depth.source == 'model':
        detector.source.fit_to_rate(rate_hz, _seconds_beside_the_network(detector))


def _seconds_beside_the_network(detector: PlaneDetector) -> float:
    """Return the time of all other work on a frame with depth like that of a network."""
    rgb, depth_m = corridor()
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.standard_normal(depth_m.shape), (0, 0), _BLUR_PX)
    noise = _NOISE_PER_M * (smooth / smooth.std() + rng.standard_normal(depth_m.shape))
    noisy_m = to_depth(to_disparity(depth_m) + noise)
    processor = FrameProcessor(
        PlaneDetector(detector.config, DepthFunction(lambda _: noisy_m, blur_px=_BLUR_PX)),
        NodeConfig(), 'image')
    header = Header()
    frame = Frame(rgb_to_msg(header, rgb),
                  camera_info_to_msg(header, CORRIDOR_LENS), None, None, 0)
    return median_seconds(lambda: processor.process(frame))


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
