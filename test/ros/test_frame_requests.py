# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Assignment of frames to calls."""

import pytest

from plane_detector.ros.frame_requests import ANSWERED_WITHIN_S, FrameRequests


class Clock:
    """A clock set by the test."""

    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def requests(clock):
    return FrameRequests(lambda: None, clock)


def test_a_frame_from_before_the_call_does_not_answer_it(requests):
    early, late = object(), object()
    requests.accept(early)
    future = requests.add()
    assert requests.are_waiting
    requests.finish(early, True, 'early')
    assert not future.done()
    requests.accept(late)
    assert not requests.are_waiting, 'its frame is on the way'
    requests.finish(late, True, 'late')
    assert future.result() == (True, 'late')


def test_a_newer_frame_answers_for_one_that_it_replaced(requests):
    future = requests.add()
    replaced, newest = object(), object()
    requests.accept(replaced)
    requests.accept(newest)
    requests.finish(newest, False, 'skipped')
    assert future.result() == (False, 'skipped')


def test_a_call_without_frames_is_answered_after_a_time(requests, clock):
    future = requests.add()
    clock.now_s = ANSWERED_WITHIN_S - 0.1
    requests.expire('')
    assert not future.done()
    clock.now_s = ANSWERED_WITHIN_S
    requests.expire('')
    assert future.result() == (False, 'no frame within 30 s')
    assert not requests.are_waiting


def test_a_call_is_answered_as_soon_as_it_is_known_that_no_frame_comes(requests):
    future = requests.add()
    requests.expire('nobody publishes /image')
    assert future.result() == (False, 'no frame: nobody publishes /image')


def test_all_are_refused_at_once(requests):
    futures = [requests.add(), requests.add()]
    requests.refuse_all('the node is not active')
    assert [future.result() for future in futures] == [(False, 'the node is not active')] * 2
