# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every error of the list can be planted, and the docs name an existing test that catches it."""

import re

from plane_detector.evaluation.plant_errors import ERRORS, ROOT, TESTS, part_of


def test_every_error_can_be_planted():
    for file, errors in ERRORS.items():
        assert part_of(file) in TESTS
        for right, wrong, _ in errors:
            assert (ROOT / 'plane_detector' / file).read_text('utf-8').count(right) == 1, right
            assert right != wrong


def test_the_table_of_the_docs_names_a_test_for_each_error():
    rows = re.findall(r'^\| (\w+) \| ([^|]+) \| (\S+) \| `(\w+)` in (\S+) \|$',
                      (ROOT / 'docs' / 'development.md').read_text('utf-8'), re.MULTILINE)
    assert {(part, wrong, file) for part, wrong, file, _, _ in rows} == {
        (part_of(file), wrong, file) for file, errors in ERRORS.items() for *_, wrong in errors}
    for *_, name, tests in rows:
        assert f'def {name}(' in (ROOT / 'test' / tests).read_text('utf-8'), name
