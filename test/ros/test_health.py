# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What a frame lacks for classes, obstacles and drops: its log, once, its status and its facts."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from plane_detector.ros import diagnostics
from plane_detector.ros.diagnostics import (
    DROPS,
    POINTS_WITHOUT_FLOOR,
    Health,
    Report,
    missing_for_classes,
)
from plane_detector.types import METRIC, Gravity, GroundLack, GroundResult, Mounting


def detection(classes, scale='metric', planes=2, gravity_note='', shape=(480, 640), note='',
              lack=None, mounting=None, probability=math.nan, input_note=''):
    if lack is None:
        lack = (GroundLack.GRAVITY if not any(classes) else
                GroundLack.UNIT if scale == 'relative' else GroundLack.NOTHING)
    return SimpleNamespace(labels=np.zeros(shape), planes=(None,) * planes, classes=classes,
                           scale=replace(METRIC, is_metric=scale == 'metric', method=scale,
                                         note='why'), scale_event='',
                           input_note=input_note,
                           constant_note='', plane_note='',
                           gravity=Gravity(None, 0.0, 'none', gravity_note, probability),
                           camera_height_m=1.25, tilt_deg=math.nan,
                           ground_result=GroundResult(lack, drop_note=note, mounting=mounting),
                           shapes=(), shape_note='',
                           disparity_noise=0.002, systematic_noise=0.001)


@pytest.mark.parametrize('found, wanted, expected', [
    (detection((1, 3)), (POINTS_WITHOUT_FLOOR,), ''),
    (detection((), planes=0), ('planes',), ''),
    (detection((), planes=0), (POINTS_WITHOUT_FLOOR,), 'gravity is not known'),
    (detection((), planes=0, lack=GroundLack.NOTHING), (POINTS_WITHOUT_FLOOR,), ''),
    (detection((1, 3), note='no floor is seen'), (POINTS_WITHOUT_FLOOR,), ''),
    (detection((1, 3), note='no floor is seen'), (DROPS,), 'drops is silent: no floor is seen'),
    (detection((0, 0)), ('planes',), 'the direction of gravity is not known'),
    (detection((0, 0)), (POINTS_WITHOUT_FLOOR,), 'points_without_floor is silent'),
    (detection((0, 0), gravity_note='only 3 straight lines'), (), 'not known (only 3 straight'),
    (detection((0, 0), 'relative'), ('planes',), 'neither metres nor gravity'),
    (detection((1, 0), 'relative'), ('planes',), ''),
    (detection((), planes=0, lack=GroundLack.DEPTH, note='nothing is seen: no depth'),
     (POINTS_WITHOUT_FLOOR,), 'points_without_floor is silent: nothing is seen'),
    (detection((), 'relative', planes=0, lack=GroundLack.UNIT, note='the unit is not known'),
     (POINTS_WITHOUT_FLOOR,), 'silent: the unit is not known'),
    (detection((1, 0), 'relative', note='the unit of depth is not known'),
     (POINTS_WITHOUT_FLOOR,), 'unit of depth is not known (relative, unit unknown: why)')])
def test_gaps(found, wanted, expected):
    gap = missing_for_classes(found, wanted)
    assert expected in gap
    assert bool(expected) == bool(gap)


def test_a_camera_that_is_not_mounted_as_stated_is_reported_if_it_lasts():
    lines = []
    health = Health(SimpleNamespace(warning=lines.append, info=lines.append))
    right, wrong = Mounting(0.6, 0.61, 0.02, *[math.nan] * 4), Mounting(
        0.6, 0.7, 0.02, 20.0, 23.5, 4.0, 2.5)
    for stamp_s, mounting in ((0, wrong), (4, wrong), (5, right), (6, wrong), (10.5, wrong)):
        health.note(detection((1, 3), mounting=mounting), (), stamp_s)
        assert health.status(Report(3, 0, 0, 1.0), '')[0] == DiagnosticStatus.OK and not lines
    for stamp_s in (11.0, 12.0):
        health.note(detection((1, 3), mounting=wrong), (), stamp_s)
        level, message = health.status(Report(3, 0, 0, 1.0), '')
        assert level == DiagnosticStatus.WARN
        assert all(number in message for number in ('0.70 m', '0.60 m', '23.5', '20.0'))
    assert len(lines) == 1
    assert health.facts['mounting'] == ('height 0.600 m stated, 0.700 measured, '
                                        'tilt 20.0 degrees stated, 23.5 measured')
    health.note(detection((1, 3), mounting=right), (), 13.0)
    assert health.status(Report(3, 0, 0, 1.0), '')[0] == DiagnosticStatus.OK


def test_silent_drops_are_logged_once_though_their_numbers_vary():
    lines = []
    health = Health(SimpleNamespace(warning=lines.append, info=lines.append))
    for height_m in (6.0, 6.01, 5.99):
        health.note(detection((4, 3), note=f'a level surface {height_m:.2f} m below'), (DROPS,))
        assert health.status(Report(3, 0, 0, 1.0), '')[0] == DiagnosticStatus.WARN
    assert lines == ['~/drops is silent: a level surface 5.99 m below']


def test_each_gap_is_logged_once_and_cleared_when_it_ends():
    lines = []
    health = Health(SimpleNamespace(warning=lines.append, info=lines.append))
    for _ in range(3):
        health.note(detection((0, 0)), ())
        level, message = health.status(Report(3, 0, 0, 1.0), '')
        assert level == DiagnosticStatus.WARN
        assert 'gravity' in message
    assert len(lines) == 1
    health.note(detection((1, 3), probability=0.934), ())
    assert health.status(Report(4, 0, 0, 1.0), '') == (DiagnosticStatus.OK, 'active')
    assert lines[1:] == ['gravity found in the image, probability 0.93']
    for found in (detection((0, 0)), detection((1, 3), probability=0.95)):
        health.note(found, ())
    assert len(lines) == 2


def test_a_gap_of_the_first_images_is_no_warning_but_what_ended_it_is_said():
    warnings, lines = [], []
    health = Health(SimpleNamespace(warning=warnings.append, info=lines.append))
    for found in (detection((0, 0)), detection((0, 0)), detection((1, 3), probability=0.95),
                  *[detection((1, 3), note='no floor is seen')] * 2, detection((1, 3))):
        health.note(found, (DROPS,))
    assert not warnings
    assert lines == ['gravity found in the image, probability 0.95']
    for found in (*[detection((1, 3), note='no floor is seen')] * 3, detection((1, 3))):
        health.note(found, (DROPS,))
    assert warnings == ['~/drops is silent: no floor is seen']
    assert lines[1:] == ['~/drops is back']


def test_the_facts_are_those_of_the_last_frame(monkeypatch):
    ready = {'ground_pixels'}
    monkeypatch.setattr(diagnostics, 'are_ready', lambda subject: subject in ready)
    health = Health(SimpleNamespace(warning=lambda _: None, info=lambda _: None))
    health.note(detection((1, 3), probability=0.934), ())
    assert health.facts['gravity_probability'] == '0.93' and health.facts['drops'] == '0 points'
    health.note(detection((1, 3), 'relative', note='the unit is not known'), ())
    assert 'gravity_probability' not in health.facts and 'noise' not in health.facts
    assert health.facts['drops'] == 'not searched for: the unit is not known'
    ready.clear()
    health.note(detection((1, 3)), ())
    assert health.facts['drops'] == 'not counted: their kernels are being compiled'
