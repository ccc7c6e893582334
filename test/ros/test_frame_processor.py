# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What is sought for a frame with measured depth: lines now and then, ground for its readers."""

import numpy as np
import pytest
from node_helpers import small_room
from ros_helpers import camera_info_msg, image_msg

from plane_detector.config import Config, DepthConfig, NodeConfig
from plane_detector.directions import finder
from plane_detector.ground import ground
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame

ROOM = small_room()


@pytest.fixture
def sought(monkeypatch):
    """Return a list that has one entry for each image whose lines were sought."""
    calls, detect = [], finder.detect_line_segments

    def counted(*arguments):
        calls.append(arguments)
        return detect(*arguments)
    monkeypatch.setattr(finder, 'detect_line_segments', counted)
    return calls


def process(stamps_s, noise, is_turned, wanted=()):
    """Process noisy frames of the room; those for which is_turned(k) is true are mirrored."""
    processor = FrameProcessor(PlaneDetector(Config(depth=DepthConfig(source='topic'))),
                               NodeConfig(), 'image')
    rng = np.random.default_rng(0)
    for k, stamp_s in enumerate(stamps_s):
        disparity = 1 / ROOM.depth_m + noise * rng.standard_normal(ROOM.depth_m.shape)
        rgb, depth_m = ROOM.rgb, (1 / disparity).astype(np.float32)
        if is_turned(k):
            rgb, depth_m = np.rot90(rgb, 2), np.rot90(depth_m, 2)
        processor.process(Frame(
            image_msg(np.ascontiguousarray(rgb), 'rgb8', stamp_s),
            camera_info_msg(ROOM.intrinsics, stamp_s),
            image_msg(np.ascontiguousarray(depth_m), '32FC1', stamp_s), None, 0), wanted)


@pytest.mark.parametrize('noise', [0.0, 0.001])
def test_lines_of_a_still_camera_are_sought_ever_less_often(sought, noise):
    """Half a second, one, and two after the time before."""
    process(np.arange(0, 3.4, 0.09), noise, lambda k: False)
    assert len(sought) <= 4


def test_lines_are_sought_when_the_camera_has_turned(sought):
    process(np.arange(0, 1.2, 0.04), 0.001, lambda k: k // 3 % 2)
    assert len(sought) >= 9


@pytest.mark.parametrize('wanted, is_sought', [(('planes', 'points'), False), (('ground',), True),
                                               (('points_without_floor',), True)])
def test_pixels_of_the_ground_are_sought_for_their_readers(monkeypatch, wanted, is_sought):
    calls, mark = [], ground.mark_ground
    monkeypatch.setattr(ground, 'mark_ground', lambda *given: calls.append(1) or mark(*given))
    process([0.0], 0.001, lambda k: False, wanted)
    assert len(calls) == is_sought
