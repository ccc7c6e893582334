# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The correlation of the errors is found as it was made, and its inverse undoes it."""

from dataclasses import replace

import numpy as np
import pytest
from cell_helpers import bare_wall, cells_and_noise, noisy, one_patch, rough_wall

from plane_detector.segmentation.cells.noise_correlation import Correlation

SIGMA = 0.01


def correlation_of(depth_m):
    model, noise = cells_and_noise(depth_m)
    return Correlation.of(model, one_patch(model), noise)


@pytest.mark.parametrize('sigma', [0.002, 0.004, 0.01])
def test_the_correlation_of_blurred_noise(sigma):
    """A Gaussian of 12 pixels and the mean over cells of 8 blur, half the variance is grain."""
    lag = np.arange(1, 5)
    expected = np.exp(-(8 * lag) ** 2 / (4 * (12**2 + 8**2 / 12)))
    found = [correlation_of(noisy(bare_wall(), seed, sigma)) for seed in range(4)]
    shape = np.mean([c.table[0, lag] / c.smooth for c in found], axis=0)
    np.testing.assert_allclose(shape, expected, atol=0.08)
    assert np.mean([c.power for c in found]) == pytest.approx(1.9, abs=0.15)
    assert np.mean([c.own for c in found]) == pytest.approx(sigma**2 / 2 / 64, rel=0.15)
    assert np.mean([c.smooth for c in found]) == pytest.approx(0.42 * sigma**2, rel=0.2)


@pytest.mark.parametrize('power', [0.7, 1.0, 1.4])
def test_the_correlation_of_rougher_noise(power):
    found = [correlation_of(rough_wall(power, seed)) for seed in range(6)]
    assert np.mean([c.power for c in found]) == pytest.approx(power, abs=0.2)


def test_grain_alone_is_no_correlation():
    found = correlation_of(noisy(bare_wall(), 0, smooth_share=0.0))
    assert found.own == pytest.approx(SIGMA**2 / 64, rel=0.15)
    assert found.smooth < 0.1 * found.own


def test_the_covariance_goes_by_rows_and_columns():
    model, noise = cells_and_noise(noisy(bare_wall(), 0))
    correlation = Correlation.of(model, one_patch(model), noise)
    row, column = np.divmod(np.array([0, 1, 80, 82, 4799]), 80)
    table = correlation.table
    matrix = table[np.abs(row[:, None] - row), np.abs(column[:, None] - column)]
    assert np.linalg.eigvalsh(matrix).min() > 0
    assert matrix[0, 1] == pytest.approx(correlation.smooth * np.exp(-correlation.decay))
    assert matrix[0, 1] == matrix[0, 2]
    assert matrix[1, 3] == table[1, 1] < table[0, 1]
    assert matrix[0, 4] == table[59, 79]
    np.testing.assert_allclose(matrix[0, 0], correlation.smooth + correlation.own, rtol=0.01)


def test_the_bend_of_planes_is_less_between_neighbours():
    """It enlarges the variance by its square, the variance of differences by itself."""
    straight = Correlation(1.0, 0.0, 0.01, 1.0, (3, 4))
    bent = Correlation(4.0, 0.0, 0.01, 1.0, (3, 4), bending=2.0)
    np.testing.assert_array_equal(straight.of_neighbours, straight.table)
    assert bent.of_neighbours[0, 0] == bent.table[0, 0] == 4
    differences = [table[0, 0] - table for table in (straight.table, bent.of_neighbours)]
    np.testing.assert_allclose(differences[1], 2 * differences[0], rtol=0.03)


def test_steps_without_pixel_noise_have_no_correlation():
    """Such errors jump from cell to cell, as no smooth noise does."""
    model, noise = cells_and_noise(noisy(bare_wall(), 0))
    regions = one_patch(model)
    assert Correlation.of(model, regions, replace(noise, disparity_floor=noise.pixel_sigma))
    steps = replace(noise, disparity_floor=1.01 * noise.pixel_sigma)
    assert Correlation.of(model, regions, steps) is None
