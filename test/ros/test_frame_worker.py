# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The worker drops what nobody waits for, and never works on two frames at once."""

import threading

import pytest

pytest.importorskip('rclpy')

from plane_detector.ros.frame_worker import FrameWorker
from plane_detector.stopping import current_stop, raise_if_stopped

STUCK_S = 20.0


class Work:
    """Takes each frame until it is let go, and notes what becomes of it."""

    def __init__(self, listens):
        self.listens = listens
        self.begun, self.free, self.whole = (threading.Event() for _ in range(3))
        self.done, self.dropped, self.at_once = [], [], 0

    def __call__(self, frame):
        self.at_once += 1
        assert self.at_once == 1
        self.begun.set()
        try:
            while not self.free.wait(0.01):
                if self.listens:
                    raise_if_stopped()
            if current_stop().is_set:
                self.dropped.append(frame)
            else:
                self.done.append(frame)
                self.whole.set()
        finally:
            self.at_once -= 1


def started(listens=True):
    work = Work(listens)
    worker = FrameWorker(work)
    assert not worker.put('first')
    assert work.begun.wait(STUCK_S)
    work.begun.clear()
    return work, worker


def test_the_freshest_frame_waits():
    work, worker = started()
    assert [worker.put(frame) for frame in ('second', 'third')] == [False, True]
    work.free.set()
    assert work.begun.wait(STUCK_S)
    worker.stop()
    assert worker.wait(STUCK_S)
    assert work.done[0] == 'first'
    assert 'second' not in work.done


@pytest.mark.parametrize('listens', [True, False])
def test_a_dropped_frame_is_known_as_such_and_the_next_one_comes_after_it(listens):
    work, worker = started(listens)
    worker.put('waiting')
    worker.drop()
    worker.put('next')
    if listens:
        assert work.begun.wait(STUCK_S)
        assert work.dropped == []
    work.free.set()
    assert work.begun.wait(STUCK_S)
    assert work.whole.wait(STUCK_S)
    worker.stop()
    assert worker.wait(STUCK_S)
    assert work.done == ['next']
    assert work.dropped == ([] if listens else ['first'])


def test_stop_does_not_wait_for_work_that_does_not_listen():
    work, worker = started(listens=False)
    worker.stop()
    assert not worker.wait(0.05)
    work.free.set()
    assert worker.wait(STUCK_S)
    assert work.dropped == ['first']
