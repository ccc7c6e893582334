# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Counts, times and the last error of the diagnostics."""

import output_scene as scene
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros import diagnostics
from plane_detector.ros.diagnostics import Statistics, planes_status, status_to_msg


@pytest.fixture
def now_s(monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(diagnostics.time, 'monotonic', lambda: now_s[0])
    return now_s


def values_of(statistics):
    msg = status_to_msg('node', DiagnosticStatus.OK, 'active', statistics.report(), {})
    return {value.key: value.value for value in msg.values}


@pytest.mark.parametrize('add', [Statistics.add_skipped, Statistics.set_error])
def test_the_last_error_stays_and_says_how_long_ago_it_was(now_s, add):
    statistics = Statistics()
    add(statistics, 'encoding 8UC7')
    for age_s in ('0.0', '30.0'):
        values = values_of(statistics)
        assert values['last_error'] == 'encoding 8UC7'
        assert values['last_error_age_s'] == age_s
        statistics.add_processed({'depth': 0.01})
        now_s[0] += 30.0


def test_rates_and_times_are_those_since_the_last_report(now_s):
    statistics = Statistics()
    for seconds in (0.1, 0.3):
        statistics.add_processed({'depth': seconds})
    statistics.add_dropped(2)
    now_s[0] += 2.0
    report = statistics.report()
    assert (report.rate_hz, report.arrival_hz) == (1.0, 2.0)
    assert report.stage_seconds['depth'] == pytest.approx(0.2)
    now_s[0] += 1.0
    report = statistics.report()
    assert (report.rate_hz, report.arrival_hz, report.stage_seconds) == (0.0, 0.0, {})
    assert (report.processed, report.dropped) == (2, 2)


def table_of(found, **options):
    msg = planes_status('front', scene.frame(found), **options)
    assert (msg.name, msg.hardware_id) == ('front: planes', 'plane_detector planes')
    return [(value.key, value.value) for value in msg.values]


def test_the_planes_are_a_table_after_their_number():
    (_, number), (_, in_all), (wall, measures), (floor, _) = table_of(scene.detection(),
                                                                      planes_in_all=12)
    assert (number, in_all, wall, floor) == ('2', '12', '7 wall', '3 floor')
    width, height = scene.frame().rectangles[0].width_m, scene.frame().rectangles[0].height_m
    assert measures == f'3.00 m, {width:.2f} x {height:.2f} m, rms 3 mm, 75 %'
    others = scene.detection(classes=(PlaneClass.OTHER, PlaneClass.OTHER_HORIZONTAL))
    assert [key for key, _ in table_of(others)] == ['planes', '7', '3 horizontal']
