# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the network keeps the pace of the camera: made so at configure, told while it runs."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from plane_detector.depth.plausibility import CORRIDOR_LENS, corridor
from plane_detector.geometry.disparity import to_depth, to_disparity
from plane_detector.pipeline import PlaneDetector, segment_planes
from plane_detector.ros.diagnostics import Report

# Like a network's depth: the plane stage is timed on it.
_NOISE_PER_M, _BLUR_PX = 0.005, 12.0
# A pace that differs by less is that of the clocks.
_TOLERANCE = 1.1


def fit_to_rate(detector: PlaneDetector) -> None:
    """Let the network become as large as ``depth.target_rate`` allows beside the plane stage."""
    _, depth_m = corridor()
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.standard_normal(depth_m.shape), (0, 0), _BLUR_PX)
    noise = _NOISE_PER_M * (smooth / smooth.std() + rng.standard_normal(depth_m.shape))
    noisy_m = to_depth(to_disparity(depth_m) + noise)
    detector.source.fit_to_rate(
        detector.config.depth.target_rate,
        lambda: segment_planes(noisy_m, CORRIDOR_LENS, detector.config))


def slow_network(report: Report, advise: Callable[[float], str]) -> str:
    """
    Return that the network takes longer than the camera's period and what would not; or nothing.

    Parameters
    ----------
    report : Report
        Of the last second or so.
    advise : callable
        Share of the present time to what brings the network there.

    """
    depth_s = report.stage_seconds.get('depth', 0.0)
    if report.arrival_hz == 0 or depth_s * report.arrival_hz <= _TOLERANCE:
        return ''
    advice = advise(1 / (depth_s * report.arrival_hz))
    if not advice:
        return ''
    return (f'the network takes {1e3 * depth_s:.0f} ms, the camera sends an image every '
            f'{1e3 / report.arrival_hz:.0f} ms: {advice}')
