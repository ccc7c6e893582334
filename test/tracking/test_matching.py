# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The Hungarian method finds what that of scipy finds."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from plane_detector.tracking.matching import best_pairs


@pytest.mark.parametrize('shape', [(1, 1), (3, 3), (12, 12), (4, 9), (9, 4), (30, 25)])
@pytest.mark.parametrize('seed', range(5))
def test_the_pairs_are_those_of_scipy(shape, seed):
    score = np.random.default_rng(seed).normal(size=shape)
    rows, columns = best_pairs(score)
    expected_rows, expected_columns = linear_sum_assignment(score, maximize=True)
    np.testing.assert_array_equal(rows, expected_rows)
    np.testing.assert_array_equal(columns, expected_columns)


def test_equal_scores_give_the_same_sum_and_each_column_once():
    score = np.random.default_rng(0).integers(0, 3, (8, 10)).astype(float)
    rows, columns = best_pairs(score)
    assert len(set(columns.tolist())) == 8
    expected = linear_sum_assignment(score, maximize=True)
    assert score[rows, columns].sum() == score[expected].sum()
