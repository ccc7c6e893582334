# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames are processed in order, the newest kept; what is sought in them, and how often."""

import threading

import numpy as np
import pytest
from node_helpers import small_room
from ros_helpers import camera_info_msg, image_msg

from plane_detector.config import Config, DepthConfig, DirectionsConfig, NodeConfig
from plane_detector.directions import finder
from plane_detector.ground import seen_ground
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame

pytest.importorskip('rclpy')

from plane_detector._runtime.stopping import current_stop, raise_if_stopped
from plane_detector.ros.frame_worker import FrameWorker

STUCK_S = 120.0


class Work:
    """Holds each frame until it is released, and records what became of it."""

    def __init__(self, listens=True):
        self.listens = listens
        self.begun, self.free, self.ended = (threading.Semaphore(0) for _ in range(3))
        self.done, self.dropped = [], []

    def __call__(self, frame):
        return lambda: self.hold(frame)

    def hold(self, frame):
        self.begun.release()
        try:
            while not self.free.acquire(timeout=0.01):
                if self.listens:
                    raise_if_stopped()
            (self.dropped if current_stop().is_set else self.done).append(frame)
        finally:
            self.ended.release()


def started(listens=True, overlaps=False):
    """Return a worker that is busy with a frame."""
    work = Work(listens)
    worker = FrameWorker(work, overlaps)
    assert not worker.put('first')
    assert work.begun.acquire(timeout=STUCK_S)
    return work, worker


def test_the_newest_frame_waits():
    work, worker = started()
    assert [worker.put(frame) for frame in ('second', 'third')] == [False, True]
    for _ in range(2):
        work.free.release()
        assert work.ended.acquire(timeout=STUCK_S)
    worker.stop()
    assert worker.wait(STUCK_S)
    assert work.done == ['first', 'third']


def test_the_next_frame_is_begun_while_one_is_finished_and_finished_after_it():
    begun, free = threading.Semaphore(0), threading.Event()
    finished, has_finished = [], threading.Semaphore(0)

    def begin(frame):
        begun.release()
        return lambda: (free.wait(STUCK_S), finished.append(frame), has_finished.release())

    worker = FrameWorker(begin, overlaps=True)
    for frame in ('first', 'second'):
        worker.put(frame)
        assert begun.acquire(timeout=STUCK_S)
    assert not worker.put('third')
    assert not begun.acquire(timeout=0.05), 'begun before the first one is finished'
    free.set()
    assert begun.acquire(timeout=STUCK_S)
    assert all(has_finished.acquire(timeout=STUCK_S) for _ in range(2))  # a stop drops the rest
    worker.stop()
    assert worker.wait(STUCK_S)
    assert finished[:2] == ['first', 'second']


@pytest.mark.parametrize('overlaps', [True, False])
@pytest.mark.parametrize('listens', [True, False])
def test_a_dropped_frame_is_known_as_such_and_the_next_one_comes_after_it(listens, overlaps):
    work, worker = started(listens, overlaps)
    worker.put('waiting')
    worker.drop()
    worker.put('next')
    if not listens:
        work.free.release()
    assert work.ended.acquire(timeout=STUCK_S)
    work.free.release()
    assert work.ended.acquire(timeout=STUCK_S)
    worker.stop()
    assert worker.wait(STUCK_S)
    assert work.done == ['next']
    assert work.dropped == ([] if listens else ['first'])


@pytest.mark.parametrize('overlaps', [True, False])
def test_stop_does_not_wait_for_work_that_ignores_it(overlaps):
    work, worker = started(listens=False, overlaps=overlaps)
    worker.stop()
    assert not worker.wait(0.05)
    work.free.release()
    assert worker.wait(STUCK_S)
    assert work.dropped == ['first']


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
    """Process noisy frames of the room, upside down where is_turned(k) is true."""
    processor = FrameProcessor(PlaneDetector(Config(
        depth=DepthConfig(source='topic'), directions=DirectionsConfig(mounting='upright'))),
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


def test_lines_beside_a_network_are_held_for_a_tenth_of_a_second_only(sought):
    """Its planes do not tell whether the camera turns."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, ROOM.rgb.shape, np.uint8)
    detector = PlaneDetector(Config(), lambda _: (
        ROOM.depth_m + rng.normal(0, 0.004, ROOM.depth_m.shape)).astype(np.float32))
    for stamp_s in np.arange(1.0, 1.6, 0.06):
        detector.detect(rgb, ROOM.intrinsics, stamp_s=stamp_s)
    assert 5 <= len(sought) <= 7, 'of ten images'


@pytest.mark.parametrize('wanted, is_sought', [(('planes', 'points'), False), (('ground',), True),
                                               (('points_without_floor',), True)])
def test_pixels_of_the_ground_are_sought_for_their_readers(monkeypatch, wanted, is_sought):
    calls, mark = [], seen_ground.mark_ground
    monkeypatch.setattr(seen_ground, 'mark_ground', lambda *given: calls.append(1) or mark(*given))
    process([0.0], 0.001, lambda k: False, wanted)
    assert len(calls) == is_sought
