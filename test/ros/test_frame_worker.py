# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The worker processes frames in order, keeps the newest, and drops outdated ones."""

import threading

import pytest

pytest.importorskip('rclpy')

from plane_detector.ros.frame_worker import FrameWorker
from plane_detector.stopping import current_stop, raise_if_stopped

STUCK_S = 20.0


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
