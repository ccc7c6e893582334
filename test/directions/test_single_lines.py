# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of answers that must not depend on a single line."""

import numpy as np
import pytest

from plane_detector.directions.line_segments import segments_from_pixels
from plane_detector.directions.single_lines import depends_on_one_line
from plane_detector.evaluation.scenes.rendering import VGA

IS_SAME = np.array([True, True, False])


def rows(*heights):
    """Return horizontal segments, each at this row of the image."""
    return segments_from_pixels(np.array([[[100.0, v], [200.0, v]] for v in heights]), VGA)


@pytest.mark.parametrize(('heights', 'depends'), [((100, 104, 300), True),
                                                  ((100, 180, 300), False)])
def test_two_edges_of_a_bar_are_one_line(heights, depends):
    points = np.array([[2.0, 0, 0], [0, 2.0, 0], [0, 0, 1.0]])
    assert depends_on_one_line(rows(*heights), points, IS_SAME) == depends


@pytest.mark.parametrize(('other', 'depends'), [(1.0, True), (0.9, False)])
def test_an_answer_that_is_only_equally_good_without_a_line_depends_on_it(other, depends):
    points = np.array([[1.0, 0, other], [1.0, 0, other], [0.5, 0, 0]])
    assert depends_on_one_line(rows(100, 200, 300), points, IS_SAME) == depends
