# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scale and shift over time, with hand-made estimates."""

from dataclasses import replace

import pytest

from plane_detector.config import ScaleConfig
from plane_detector.scale.estimate import ScaleEstimate
from plane_detector.scale.temporal_filter import ScaleState, depth_change, update_scale

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


def test_depth_change_is_the_largest_share():
    assert depth_change(FLOOR, FLOOR) == 0.0
    assert depth_change(FLOOR, farther(FLOOR, 1.25)) == pytest.approx(0.25)
    assert depth_change(FLOOR, farther(FLOOR, 0.8)) == pytest.approx(0.25)
    assert depth_change(FLOOR, replace(FLOOR, shift=-1.0)) == float('inf')


def test_small_changes_are_blended_in():
    state = run(FLOOR, farther(FLOOR, 1.1))[-1]
    assert state.estimate.scale == pytest.approx(0.5 * (0.5 + 0.5 / 1.1))
    assert state.event == ''


def test_an_outlier_changes_nothing_and_is_reported():
    states = run(FLOOR, farther(FLOOR, 3.0), FLOOR)
    assert [s.estimate.scale for s in states] == [0.5] * 3
    assert 'outlier' in states[1].event and '200%' in states[1].event
    assert states[2].event == '' and states[2].outliers == ()


def test_outliers_that_disagree_never_add_up():
    states = run(FLOOR, *[farther(FLOOR, factor) for factor in (3.0, 0.3, 3.0, 0.3, 3.0)])
    assert states[-1].estimate.scale == 0.5


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


def test_an_estimate_ends_the_holding():
    states = run(FLOOR, *[RELATIVE] * 4, FLOOR, *[RELATIVE] * 4)
    assert {s.estimate.method for s in states} == {'camera_height'}


def test_right_angles_without_metres_do_not_replace_metres_at_once():
    states = run(FLOOR, ANGLES, FLOOR)
    assert all(s.estimate.is_metric for s in states)


def test_a_better_method_is_taken_at_once():
    depth = replace(farther(FLOOR, 2.0), method='depth_topic')
    assert run(ANGLES, FLOOR)[-1].estimate is FLOOR
    assert run(FLOOR, depth)[-1].estimate is depth
    assert run(RELATIVE, ANGLES)[-1].event


def test_the_unknown_unit_stays_that_of_the_first_frame():
    states = run(ANGLES, farther(ANGLES, 7.0), replace(farther(ANGLES, 7.0), shift=0.02))
    assert states[1].estimate.scale == pytest.approx(ANGLES.scale)
    assert depth_change(states[1].estimate, states[2].estimate) < 0.2


@pytest.mark.parametrize('method', ['fixed', 'metric'])
def test_methods_that_do_not_measure_are_not_filtered(method):
    given = replace(farther(FLOOR, 5.0), method=method)
    assert run(FLOOR, given)[-1].estimate is given
    other = replace(given, scale=9.0)
    assert run(given, other)[-1] == ScaleState(other)


def test_uncertainty_and_note_are_those_of_the_last_answer():
    new = replace(FLOOR, uncertainty=0.5, note='another floor')
    state = run(FLOOR, new)[-1]
    assert (state.estimate.uncertainty, state.estimate.note) == (0.5, 'another floor')
