# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The worker keeps two frames in flight, in order, and drops outdated ones."""

import threading
import time
from itertools import count

import numpy as np
import pytest

pytest.importorskip('rclpy')

from plane_detector.ros.frame_worker import SKIPPED, FrameWorker
from plane_detector.stopping import current_stop, raise_if_stopped

STUCK_S = 20.0


class Half:
    """Holds each frame until it is released, and records its result."""

    def __init__(self, listens=True, is_free=False):
        self.listens = listens
        self.begun, self.free, self.whole = (threading.Event() for _ in range(3))
        self.done, self.dropped, self.at_once = [], [], 0
        if is_free:
            self.free.set()

    def __call__(self, frame):
        self.at_once += 1
        assert self.at_once == 1, 'one frame at a time'
        self.begun.set()
        try:
            while not self.free.wait(0.01):
                if self.listens:
                    raise_if_stopped()
            if current_stop().is_set:
                self.dropped.append(frame)
                return SKIPPED
            self.done.append(frame)
            self.whole.set()
            return frame
        finally:
            self.at_once -= 1


def ended(worker):
    worker.stop()
    return worker.wait(STUCK_S)


def started(listens=True):
    """Return a worker whose first half is busy with a frame."""
    first, second = Half(listens), Half(is_free=True)
    worker = FrameWorker(first, second)
    assert not worker.put('first')
    assert first.begun.wait(STUCK_S)
    first.begun.clear()
    return first, second, worker


def test_the_newest_frame_waits():
    first, second, worker = started()
    assert [worker.put(frame) for frame in ('second', 'third')] == [False, True]
    first.free.set()
    assert first.begun.wait(STUCK_S)
    while second.done != ['first', 'third']:
        assert second.whole.wait(STUCK_S)
    assert ended(worker)
    assert first.done == ['first', 'third']


def test_while_the_second_half_is_busy_the_first_takes_the_next_frame():
    first, second = Half(is_free=True), Half()
    worker = FrameWorker(first, second)
    worker.put('one')
    assert second.begun.wait(STUCK_S)
    first.whole.clear()
    worker.put('two')
    assert first.whole.wait(STUCK_S), 'though the second half still has the first frame'
    assert second.done == []
    first.begun.clear()
    worker.put('three')
    assert not first.begun.wait(0.1), 'a frame waits between the halves: no work for nothing'
    assert worker.put('four'), 'the freshest frame wins'
    second.free.set()
    while len(second.done) < 3:
        assert second.whole.wait(STUCK_S)
    assert ended(worker)
    assert second.done == ['one', 'two', 'four'], 'in order'


def test_a_skipped_frame_has_no_second_half():
    second = Half(is_free=True)
    worker = FrameWorker(lambda frame: SKIPPED if frame == 'bad' else frame, second)
    taken = threading.Event()
    worker.put('bad')
    while worker.put('good'):  # until the first one is taken
        assert not taken.wait(0.001)
    assert second.whole.wait(STUCK_S)
    assert ended(worker)
    assert 'bad' not in second.done


@pytest.mark.parametrize('listens', [True, False])
def test_a_dropped_frame_is_known_as_such_and_the_next_one_comes_after_it(listens):
    first, second, worker = started(listens)
    worker.put('waiting')
    worker.drop()
    worker.put('next')
    if listens:
        assert first.begun.wait(STUCK_S)
        assert first.dropped == []
    first.free.set()
    assert second.whole.wait(STUCK_S)
    assert ended(worker)
    assert first.done == second.done == ['next']
    assert first.dropped == ([] if listens else ['first'])


@pytest.mark.parametrize('listens', [True, False])
def test_a_frame_is_dropped_in_the_second_half_too_and_between_the_halves(listens):
    first, second = Half(is_free=True), Half(listens)
    worker = FrameWorker(first, second)
    worker.put('one')
    assert second.begun.wait(STUCK_S)
    first.whole.clear()
    worker.put('between')
    assert first.whole.wait(STUCK_S)
    worker.drop()
    second.free.set()
    worker.put('next')
    assert second.whole.wait(STUCK_S)
    assert ended(worker)
    assert second.done == ['next']
    assert second.dropped in ([], ['one'])


def test_stop_does_not_wait_for_work_that_ignores_it():
    first, _, worker = started(listens=False)
    worker.stop()
    assert not worker.wait(0.05)
    first.free.set()
    assert worker.wait(STUCK_S)
    assert first.dropped == ['first']


def test_each_stage_has_a_frame_of_its_own():
    first, second, third = Half(is_free=True), Half(is_free=True), Half()
    worker = FrameWorker(first, second, third)
    worker.put('one')
    assert third.begun.wait(STUCK_S)
    for frame, stage in (('two', second), ('three', first)):
        stage.whole.clear()
        worker.put(frame)
        assert stage.whole.wait(STUCK_S), 'though the stages after it have frames'
    first.begun.clear()
    worker.put('four')
    assert not first.begun.wait(0.1), 'a frame waits before each stage'
    assert third.done == []
    third.free.set()
    while len(third.done) < 4:
        assert third.whole.wait(STUCK_S)
    assert ended(worker)
    assert first.done == second.done == third.done == ['one', 'two', 'three', 'four']


class WokenLate(FrameWorker):
    """A worker in which the others run first when a stage has handed over its result."""

    def _hand_over(self, *handed):
        super()._hand_over(*handed)
        time.sleep(0.01)


@pytest.mark.parametrize('kind', [FrameWorker, WokenLate])
@pytest.mark.parametrize('slow', [1, 2])
def test_frames_are_fresh_behind_a_slow_stage(slow, kind):
    begun, ages = {}, []

    def first(frame):
        begun[frame] = time.monotonic()
        return frame

    def later(stage):
        def run(frame):
            if stage == slow:
                ages.append(time.monotonic() - begun[frame])
                time.sleep(0.1)
            return frame
        return run
    worker, frames = kind(first, later(1), later(2)), count()
    end_s = time.monotonic() + STUCK_S
    while len(ages) < 12 and time.monotonic() < end_s:
        worker.put(next(frames))
        time.sleep(0.005)
    assert ended(worker)
    assert np.median(ages[4:12]) < 0.05, 'a frame begun at once would be 0.1 or 0.2 s old'
