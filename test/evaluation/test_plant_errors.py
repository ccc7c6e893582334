# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every error of the list can be planted: its text stands once in its file."""

from plane_detector.evaluation.plant_errors import ERRORS, ROOT, TESTS


def test_every_error_can_be_planted():
    for part, file, right, wrong, _ in ERRORS:
        assert (ROOT / 'plane_detector' / file).read_text('utf-8').count(right) == 1, right
        assert part in TESTS
        assert right != wrong
