# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scale and shift over time, with hand-made estimates."""

from dataclasses import replace

import pytest

from plane_detector.config import ScaleConfig
from plane_detector.scale.temporal_filter import update_scale
from plane_detector.types import ScaleEstimate

CONFIG = ScaleConfig(smoothing=0.5, max_jump=0.2, reset_after=3, hold_frames=4)
FLOOR = ScaleEstimate(0.5, 0.1, 'camera_height', True, True, 0.01, 'floor 1 m below',
                      (0.2, 0.5, 0.8))
ANGLES = replace(FLOOR, method='manhattan', is_metric=False, note='right angles')
RELATIVE = replace(FLOOR, method='relative', is_metric=False, has_true_angles=False,
                   note='no plane can be the floor')


def farther(estimate, factor):
    """Return an estimate that puts everything farther away by a factor."""
    return replace(estimate, scale=estimate.scale / factor, shift=estimate.shift / factor)


def run(*estimates, state=None):
    """Return the state after each frame."""
    states = []
    for estimate in estimates:
        state = update_scale(state, estimate, CONFIG)
        states.append(state)
    return states


def test_the_first_frame_is_used_and_reported():
    state, = run(FLOOR)
    assert state.estimate is FLOOR
    assert 'camera_height' in state.event and 'floor 1 m below' in state.event


def test_small_changes_are_blended_in():
    state = run(FLOOR, farther(FLOOR, 1.1))[-1]
    assert state.estimate.scale == pytest.approx(0.5 * (0.5 + 0.5 / 1.1))
    assert state.event == ''


def test_an_outlier_changes_nothing_and_is_reported():
    states = run(FLOOR, farther(FLOOR, 3.0), FLOOR)
    assert [s.estimate.scale for s in states] == [0.5] * 3
    assert 'outlier' in states[1].event and '200%' in states[1].event
    assert states[2].event == '' and states[2].outliers == ()


@pytest.mark.parametrize(('shift', 'event'), [
    (0.05, 'depth differs by 33%'), (-0.15, 'a part of it is behind the camera')])
def test_the_change_is_that_of_the_depth_where_it_changes_most(shift, event):
    """Of the far end: from .2 to .15 of 1/z, or beyond what is infinitely far."""
    assert run(replace(FLOOR, shift=shift), FLOOR)[1].event.endswith(event)


def test_a_new_scene_resets_after_frames_that_agree():
    new = farther(FLOOR, 3.0)
    states = run(FLOOR, new, farther(new, 1.1), new)
    assert [s.estimate.scale for s in states[:3]] == [0.5] * 3
    assert states[3].estimate.scale == new.scale
    assert 'reset' in states[3].event


def test_the_scale_is_held_for_a_while_without_estimates():
    states = run(FLOOR, *[RELATIVE] * 5)
    assert [s.estimate.method for s in states] == ['camera_height'] * 5 + ['relative']
    assert 'held' in states[1].event and states[2].event == ''
    assert 'no longer camera_height' in states[5].event


def test_right_angles_without_metres_do_not_replace_metres_at_once():
    states = run(FLOOR, ANGLES, FLOOR)
    assert all(s.estimate.is_metric for s in states)


@pytest.mark.parametrize('factor', [0.3, 3.0])
def test_an_arbitrary_unit_is_that_of_the_first_frame(factor):
    first, second = run(ANGLES, farther(ANGLES, factor))
    assert (second.estimate.scale, second.estimate.shift) == pytest.approx(
        (first.estimate.scale, first.estimate.shift))
    assert not second.event
    other = run(ANGLES, replace(ANGLES, scale=factor, shift=0.18 * factor))[1].estimate
    assert other.scale * 0.5 + other.shift == pytest.approx(0.35)  # its middle stays there


def test_a_better_method_is_taken_at_once():
    depth = replace(farther(FLOOR, 2.0), method='depth_topic')
    assert run(ANGLES, FLOOR)[-1].estimate is FLOOR
    assert run(FLOOR, depth)[-1].estimate is depth
    assert run(RELATIVE, ANGLES)[-1].event


def test_another_method_resets_the_filter():
    (state,) = run(FLOOR)
    off = update_scale(state, RELATIVE, replace(CONFIG, method='none'))
    assert off.estimate is RELATIVE, 'metres are not held'
    assert update_scale(off, RELATIVE, replace(CONFIG, method='none')).event == ''
