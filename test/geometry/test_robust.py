# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Median, deviation and dilation against their definitions."""

import numpy as np
import pytest

from plane_detector.geometry.robust import dilated, median, quantiles

SHARES = (0.0, 0.02, 0.5, 0.98, 1.0)


@pytest.mark.parametrize('count', [1, 2, 3, 10, 101])
def test_median_is_that_of_numpy(count):
    values = np.random.default_rng(count).normal(size=count)
    values.flags.writeable = False
    assert median(values) == np.median(values)


@pytest.mark.parametrize('count', [1, 2, 3, 10, 101])
def test_quantiles_are_those_of_numpy(count):
    values = np.random.default_rng(count).normal(size=count).astype(np.float32)
    values.flags.writeable = False
    assert quantiles(values, SHARES) == pytest.approx(
        np.quantile(values.astype(float), SHARES).tolist(), abs=1e-12)


@pytest.mark.parametrize('reach', [0, 1, 2])
def test_dilated_by_hand(reach):
    mask = np.zeros((7, 7), bool)
    mask[3, 3] = mask[0, 0] = True
    expected = np.zeros((7, 7), bool)
    expected[3 - reach:4 + reach, 3 - reach:4 + reach] = True
    expected[:1 + reach, :1 + reach] = True
    mask.flags.writeable = False
    np.testing.assert_array_equal(dilated(mask, reach), expected)
