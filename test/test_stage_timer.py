# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Timing of stages."""

from plane_detector.stage_timer import StageTimer


def test_stages_are_timed_by_name():
    stages = StageTimer()
    with stages('one'):
        pass
    with stages('two'):
        pass
    assert list(stages.seconds) == ['one', 'two']
    assert all(seconds >= 0 for seconds in stages.seconds.values())
