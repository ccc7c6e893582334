# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Faults in the log: cut, escaped, and limited by their kind."""

from types import SimpleNamespace

import pytest
from geometry_msgs.msg import PointStamped

from plane_detector._runtime.plain_text import plain
from plane_detector.ros import fault_log, point_query
from plane_detector.ros.fault_log import FaultLog


def reported(log, kind, text):
    """Raise an error of a kind, and tell the log of it."""
    def raise_value_error():
        raise ValueError(text)

    def raise_type_error():
        raise TypeError(text)
    try:
        (raise_value_error if kind is ValueError else raise_type_error)()
    except kind as error:
        return log.report(error)


@pytest.fixture
def lines():
    return []


@pytest.fixture
def log(lines):
    return FaultLog(SimpleNamespace(warning=lines.append), 'frame skipped')


@pytest.mark.parametrize('text', [
    'a\nb', 'a\rb', '\x1b[2J', '\x00', '\u202egnp', '\udce9', '\x7f', '\u2028'])
def test_control_characters_are_escaped(text):
    assert plain(text).isprintable()
    assert plain(plain(text)) == plain(text)


def test_the_kind_is_the_line_that_raised_and_not_the_text(log, lines):
    for k in range(100):
        assert reported(log, ValueError, f'fault {k}') == f'fault {k}'
    assert lines == ['frame skipped: fault 0']
    reported(log, TypeError, '5')
    reported(log, TypeError, '5')
    assert lines[1] == 'frame skipped: TypeError: 5'
    assert 'in raise_type_error' in lines[2]
    assert len(lines) == 3


def test_a_persistent_fault_is_logged_again(log, lines, monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(fault_log.time, 'monotonic', lambda: now_s[0])
    for step_s in (0, fault_log.WARN_PERIOD_S - 1, 2):
        now_s[0] += step_s
        reported(log, ValueError, 'again')
    assert len(lines) == 2


def test_the_number_of_waiting_clicks_is_limited(monkeypatch):
    monkeypatch.setattr(point_query.qos, 'overriding_options', lambda: None)
    subscribed = []
    node = SimpleNamespace(
        create_lifecycle_publisher=lambda *_, **__: SimpleNamespace(is_activated=True),
        get_logger=lambda: SimpleNamespace(warning=print),
        create_subscription=lambda _type, _topic, callback, *_, **__: subscribed.append(callback))
    query = point_query.PointQuery(node)
    for _ in range(1000):
        subscribed[0](PointStamped())
    assert len(query._clicks) < 100
