# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The stages of the processing of a frame: their state and its reset."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_helpers import camera_info_msg, image_msg

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, DirectionsConfig, NodeConfig
from plane_detector.directions import finder
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
ROOM = random_room(np.random.default_rng(3), CAMERA)
STAMPS = [1.0, 1.03, 1.09, 1.2, 1.1, 1.1, 1.21, 1.25]
LOOKED = [1.0, 1.2, 1.1, 1.1, 1.21]
"""Of these, the stamps at which lines held for 0.1 s are found anew."""


def frame(stamp_s, epoch=0):
    return Frame(image_msg(ROOM.rgb, 'rgb8', stamp_s), camera_info_msg(CAMERA, stamp_s), None,
                 None, epoch)


def finish(processor, observed, wanted):
    return processor.make(processor.find_planes(processor.look(observed)), wanted)


@pytest.fixture
def processor():
    return FrameProcessor(PlaneDetector(Config(), lambda rgb: ROOM.depth_m), NodeConfig(), 'image')


def test_two_frames_in_flight_give_what_one_by_one_gives(processor):
    one_by_one = [processor.process(frame(stamp), ('planes',)) for stamp in (1.0, 2.0, 3.0)]
    processor.reset()
    first = processor.observe(frame(1.0))
    in_flight = []
    for stamp in (2.0, 3.0):
        second = processor.observe(frame(stamp))
        in_flight.append(finish(processor, first, ('planes',)))
        first = second
    in_flight.append(finish(processor, first, ('planes',)))
    for alone, together in zip(one_by_one, in_flight, strict=True):
        assert alone.result.header.stamp == together.result.header.stamp
        assert bytes(alone.messages['planes'].data) == bytes(together.messages['planes'].data)


def test_times_of_all_stages_add_up_to_the_latency(processor):
    observed = processor.observe(frame(1.0))
    seconds = finish(processor, observed, ('planes',)).stage_seconds
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
        sources.append(processor.look(processor.observe(one)).around.gravity.source)
        assert len(looked) > before or sources[-1] == sources[-2]  # kept is the last answer
    assert looked == expected


@pytest.mark.parametrize('how', ['reset', 'epoch'])
def test_each_stage_forgets_before_its_own_first_new_frame(processor, how, monkeypatch):
    calls = []
    for name in ('reset_depth', 'reset_directions', 'reset_planes'):
        monkeypatch.setattr(processor.detector, name, lambda name=name: calls.append(name))
    old = processor.observe(frame(1.0))
    if how == 'reset':
        processor.reset()
    new = processor.observe(frame(2.0, epoch=int(how == 'epoch')))
    assert calls == ['reset_depth']
    finish(processor, old, ())
    assert calls == ['reset_depth'], 'an old frame in flight still belongs to the past'
    finish(processor, new, ())
    assert calls == ['reset_depth', 'reset_directions', 'reset_planes']
    finish(processor, processor.observe(frame(3.0, new.past[0])), ())
    assert len(calls) == 3


def test_a_frame_keeps_the_settings_that_it_began_with(processor):
    before = processor.observe(frame(1.0))
    processor.detector.config = replace(Config(), depth=DepthConfig(max_depth=0.1))
    processor.settings = replace(processor.settings, stamp_slop=0.5)
    assert finish(processor, before, ('planes',)).result.detection.planes
    assert before.settings.stamp_slop != 0.5
    after = finish(processor, processor.observe(frame(2.0)), ('planes',))
    assert after.result.detection.planes == ()
