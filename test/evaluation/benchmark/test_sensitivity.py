# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Constants are found, changed wherever they are used, and restored."""

from __future__ import annotations

import pytest

from plane_detector.evaluation.benchmark.sensitivity import Constant, changed, constants
from plane_detector.segmentation import fine_pass, segment
from plane_detector.segmentation.regions import depth_steps


def test_the_numbers_of_the_segmentation_are_found():
    found = {(one.module, one.name): one.value for one in constants()}
    name = 'MIN_OFFSET_DEVIATIONS'
    assert found['regions.depth_steps', name] == depth_steps.MIN_OFFSET_DEVIATIONS
    assert found['fine_pass', 'MIN_CELL_SHARE'] == fine_pass.MIN_CELL_SHARE
    assert ('search.ransac', 'MAX_TRIALS') not in found  # compiled in


def test_a_constant_is_changed_where_it_is_imported_and_restored():
    before = fine_pass.MIN_CELL_SHARE
    with changed(Constant('fine_pass', 'MIN_CELL_SHARE', before), 0.7):
        assert fine_pass.MIN_CELL_SHARE == segment.MIN_CELL_SHARE == pytest.approx(0.7 * before)
    assert fine_pass.MIN_CELL_SHARE == segment.MIN_CELL_SHARE == before


def test_a_constant_is_restored_after_an_error():
    before = depth_steps.MIN_OFFSET_DEVIATIONS
    with pytest.raises(ZeroDivisionError), changed(
            Constant('regions.depth_steps', 'MIN_OFFSET_DEVIATIONS', before), 1.4):
        raise ZeroDivisionError
    assert before == depth_steps.MIN_OFFSET_DEVIATIONS
