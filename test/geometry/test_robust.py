# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Median, deviation and dilation against their definitions."""

import numpy as np
import pytest

from plane_detector.geometry.robust import dilated, median, order_statistics, quantiles

SHARES = (0.0, 0.02, 0.5, 0.98, 1.0)


@pytest.mark.parametrize('count', [1, 2, 3, 10, 101, 5000, 5001])
def test_median_is_that_of_numpy(count):
    values = np.random.default_rng(count).normal(size=count)
    values.flags.writeable = False
    assert median(values) == np.median(values)


@pytest.mark.parametrize('values', [
    np.random.default_rng(0).normal(size=3000)**9, np.random.default_rng(0).integers(0, 5, 900),
    np.full(400, 7.0), np.append(np.full(400, 5e-324), [0.0, 1e-320]),
    np.append(np.linspace(0, 1e-9, 300), [-1e30, 1e300]),
    np.append(np.linspace(0, 1, 300), [-1.7e308, 1.7e308]),
    np.append(np.linspace(0, 1, 300), [np.inf, -np.inf, np.inf])],
    ids=['heavy tails', 'few values', 'one value', 'denormal', 'outliers', 'range', 'infinite'])
def test_order_statistics_are_those_of_sorted_values(values):
    ordered = [-np.inf, *np.sort(values).astype(float)]
    for rank in {0, 1, len(values) // 4, len(values) // 2, len(values) - 1}:
        assert order_statistics(values, rank) == tuple(ordered[rank:rank + 2])


def test_values_that_are_not_numbers_come_last():
    """A network may return anything: no value may be counted outside of the buckets."""
    values = np.append(np.linspace(0, 1, 300), np.full(100, np.nan))
    assert order_statistics(values, 150) == (values[149], values[150])
    assert np.isnan(order_statistics(values, 399)).all()


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
