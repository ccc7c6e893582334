# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The pipeline can be stopped between its stages and within its search."""

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import RansacConfig, SegmentationConfig
from plane_detector.segmentation.search import ransac
from plane_detector.stopping import Stop, Stopped

CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
RGB = np.zeros((120, 160, 3), np.uint8)


def test_no_stage_starts_after_a_stop():
    stop = Stop()

    def estimate(rgb):
        stop.set()
        return np.full(rgb.shape[:2], 2.0, np.float32)

    detector = PlaneDetector(Config(), estimate)
    with pytest.raises(Stopped), stop.applies():
        detector.detect(RGB, CAMERA)


def test_the_search_looks_at_the_stop_before_every_pass(monkeypatch):
    """Over curved depth and with the largest settings, where one pass finds many planes."""
    stop, passes, find = Stop(), [], ransac.find_planes

    def counted(*arguments):
        passes.append(1)
        stop.set()
        return find(*arguments)

    monkeypatch.setattr(ransac, 'find_planes', counted)
    rows, columns = np.mgrid[:120, :160] / 120
    noise = np.random.default_rng(0).normal(0, 0.02, rows.shape)
    depth_m = (2 + np.sin(9 * rows) * np.cos(7 * columns) + noise).astype(np.float32)
    config = Config(segmentation=SegmentationConfig(max_planes=255, min_plane_share=0.0),
                    ransac=RansacConfig(max_iterations=1000000))
    with pytest.raises(Stopped), stop.applies():
        PlaneDetector(config, lambda rgb: depth_m).detect(RGB, CAMERA)
    assert len(passes) == 1
