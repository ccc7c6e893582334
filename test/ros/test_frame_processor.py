# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The processing of a frame: its state and its reset, and what it waits for."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_helpers import camera_info_msg, image_msg

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, DirectionsConfig, NodeConfig
from plane_detector.directions import finder
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.inputs.transforms import FrameTransforms
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
ROOM = random_room(np.random.default_rng(3), CAMERA)
STAMPS = [1.0, 1.03, 1.09, 1.2, 1.1, 1.1, 1.21, 1.25]
LOOKED = [1.0, 1.2, 1.1, 1.1, 1.21]
"""Of these, the stamps at which lines held for 0.1 s are found anew."""


def frame(stamp_s, epoch=0):
    return Frame(image_msg(ROOM.rgb, 'rgb8', stamp_s), camera_info_msg(CAMERA, stamp_s), None,
                 None, epoch)


@pytest.fixture
def processor():
    return FrameProcessor(PlaneDetector(Config(), lambda rgb: ROOM.depth_m), NodeConfig(), 'image')


def test_times_of_all_stages_are_told(processor):
    seconds = processor.process(frame(1.0), ('planes',)).stage_seconds
    assert {'convert', 'depth', 'wait', 'segmentation', 'messages'} <= set(seconds)
    assert all(value >= 0 for value in seconds.values())


@pytest.mark.parametrize(('source', 'moves_px', 'hold_time', 'expected'), [
    ('topic', 5, 0.1, LOOKED), ('topic', 0, 0.0, STAMPS),
    ('model', 0, 0.1, LOOKED), ('model', 0, 0.0, STAMPS), ('model', 5, 0.1, STAMPS)])
def test_lines_are_kept_for_a_short_time_unless_planes_need_them_and_something_moves(
        source, moves_px, hold_time, expected, monkeypatch):
    config = replace(Config(), depth=DepthConfig(source=source),
                     directions=DirectionsConfig(hold_time=hold_time))
    model = (lambda rgb: ROOM.depth_m) if source == 'model' else None
    processor, looked = FrameProcessor(PlaneDetector(config, model), NodeConfig(), 'image'), []
    find = finder.find_in_image
    monkeypatch.setattr(finder, 'find_in_image',
                        lambda *args: looked.append(stamp) or find(*args))
    depth_msg, sources = image_msg(ROOM.depth_m.astype(np.float32), '32FC1', 1.0), []
    for turn, stamp in enumerate(STAMPS):
        image = image_msg(np.roll(ROOM.rgb, turn * moves_px, axis=1), 'rgb8', stamp)
        one = replace(frame(stamp), image=image, depth=depth_msg if source == 'topic' else None)
        before = len(looked)
        sources.append(processor.process(one, ()).result.detection.gravity_source)
        assert len(looked) > before or sources[-1] == sources[-2]  # kept is the last answer
    assert looked == expected


@pytest.mark.parametrize('how', ['reset', 'epoch'])
def test_the_past_is_forgotten_once(processor, how, monkeypatch):
    calls = []
    monkeypatch.setattr(processor.detector, 'reset', lambda: calls.append(how))
    processor.process(frame(1.0), ())
    assert calls == []
    if how == 'reset':
        processor.reset()
    for stamp_s in (2.0, 3.0):
        processor.process(frame(stamp_s, epoch=int(how == 'epoch')), ())
    assert calls == [how]


class LateTransforms(FrameTransforms):
    """TF that knows the frames after a while; `events` tells what happened in which order."""

    def __init__(self, events, known):
        super().__init__(None)
        self.events, self.known = events, known

    def to_target(self, header, settings, timeout_s=0.0):
        self.events.append('transform')
        if not self.known:
            raise ValueError('no transform')
        return RigidTransform.identity()


def test_transforms_are_awaited_while_the_network_runs_unless_they_were_missing_before():
    events = []
    transforms = LateTransforms(events, known=False)
    processor = FrameProcessor(
        PlaneDetector(Config(), lambda rgb: events.append('network') or ROOM.depth_m),
        NodeConfig(target_frame='odom'), 'image', transforms)
    for expected in (['network', 'transform'], ['transform'], ['transform']):
        events.clear()
        with pytest.raises(ValueError, match='no transform'):
            processor.process(frame(1.0), ())
        assert events == expected, 'no work in vain but for the first frame'
    transforms.known = True
    for expected in (['transform', 'network'], ['network', 'transform']):
        events.clear()
        processor.process(frame(2.0), ())
        assert events == expected
