# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth, disparity and their validity."""

import warnings

import numpy as np
import pytest

from plane_detector.geometry.disparity import (
    disparity_range,
    to_depth,
    to_disparity,
    valid_depth,
)

INVALID = [0.0, -0.0, -1.0, np.inf, -np.inf, np.nan, 0.9e-3, 1e-40]


@pytest.mark.parametrize('value', INVALID)
def test_invalid_depth_has_no_disparity(value):
    depth_m = np.array([[value, 4.0]], np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        disparity = to_disparity(depth_m)
    np.testing.assert_array_equal(valid_depth(depth_m), [[False, True]])
    np.testing.assert_array_equal(disparity, np.array([[np.nan, 0.25]], np.float32))


def test_depth_to_disparity_and_back():
    depth_m = np.array([[0.5, 2.0, np.nan, 60.0]], np.float32)
    np.testing.assert_allclose(to_depth(to_disparity(depth_m)), depth_m, rtol=1e-6)
    assert to_depth(to_disparity(depth_m)).dtype == np.float32


@pytest.mark.parametrize('disparity', [0.0, -0.1, np.nan, np.inf, 2e3, 0.124])
def test_disparity_of_no_depth_up_to_the_largest_is_invalid(disparity):
    found = to_depth(np.array([[disparity, 0.125]]), max_depth_m=8.0)
    np.testing.assert_array_equal(found, [[np.nan, 8.0]])


def test_the_range_ignores_outliers():
    disparity = np.tile(np.linspace(1.0, 3.0, 400, dtype=np.float32), (400, 1))
    disparity[:4] = 1000.0
    disparity[4:8] = np.nan
    assert disparity_range(disparity) == pytest.approx(2.0, rel=0.05)
