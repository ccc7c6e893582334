# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rounded disparities are known as such, correlations of the errors found as they were made."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from cell_helpers import (
    bare_wall,
    cells_and_noise,
    disparity_image,
    millimetres,
    noisy,
    one_patch,
    rough_wall,
)

from plane_detector import segment_planes
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid, fit_planes
from plane_detector.segmentation.cells.model import (
    LOCAL_RATIO,
    MAX_LOCAL_RATIO,
    MEAN_WEIGHT,
    SLOPE_WEIGHT,
    SQUARED_ERROR,
    weigh_cells,
)
from plane_detector.segmentation.cells.noise import (
    Noise,
    estimate_noise,
    least_around,
    roughness_of,
    with_quantisation,
)
from plane_detector.segmentation.cells.noise_correlation import Correlation

FLOOR = Noise(0.0005)


def rounded(depth_m, step):
    """Return depth whose inverse is a multiple of the step."""
    return (1 / (np.rint(1 / depth_m / step) * step)).astype(np.float32)


def step_of(depth_m):
    """Return the step between disparities whose uniform error is the floor."""
    return with_quantisation(FLOOR, disparity_image(depth_m)).disparity_floor * 12**0.5


@pytest.mark.parametrize('step', [0.001, 0.003, 0.01])
@pytest.mark.parametrize('yaw_deg', [10, 40])
def test_the_step_of_rounded_disparities_is_found(step, yaw_deg):
    depth_m = rounded(single_wall(yaw_deg=yaw_deg).depth_m, step)
    assert step_of(depth_m) == pytest.approx(step, rel=0.01)
    assert len(segment_planes(depth_m, VGA).planes) == 1


def test_exact_and_noisy_depth_and_that_in_millimetres_are_not_rounded(room):
    for distance_m, yaw_deg in product((1.0, 6.0), (0, 5)):
        depth_m = single_wall(yaw_deg=yaw_deg, distance_m=distance_m).depth_m
        assert step_of(depth_m) == step_of(millimetres(depth_m)) == 0
    for seed, sigma in product(range(3), (0.0, 0.004)):
        assert step_of(noisy(room(seed), seed, sigma)) == 0


def test_cells_of_few_pixels_are_known_to_be_noisier():
    rng = np.random.default_rng(0)
    depth_m = with_disparity_noise(single_wall(yaw_deg=20).depth_m, 0.004, rng, smooth_share=0.0)
    full = build_cell_grid(disparity_image(depth_m))
    depth_m = np.where(rng.random(depth_m.shape) > 0.25, np.float32(np.nan), depth_m)
    grid = build_cell_grid(disparity_image(depth_m))
    noise = estimate_noise(grid, FLOOR)
    assert noise.mean_sigma < 0.7 * 0.004 / 4  # sixteen of 64 pixels
    plane = fit_planes(full.moments.sum(axis=0)[None])[0]
    residual = grid.mean[:, 2] - grid.mean[:, :2] @ plane[:2] - plane[2]
    table = weigh_cells(grid, noise).table
    assert np.mean(residual**2 * table[:, 5]) == pytest.approx(1, abs=0.3)
    tilt = ((grid.slope - plane[:2])**2).sum(axis=1) / 2
    assert np.mean(tilt * table[:, 6]) == pytest.approx(1, abs=0.3)


@pytest.mark.parametrize(('bending', 'smooth_ratio'), [(1.0, 9.0), (2.0, 3.0)])
def test_a_cell_has_the_noise_that_its_pixels_show(bending, smooth_ratio):
    """Of a systematic error, which bends planes, it has no more than the others."""
    grid = build_cell_grid(disparity_image(bare_wall().depth_m))
    noise = Noise(0.0, mean_sigma=0.003, slope_sigma=0.1, pixel_sigma=0.004, own_share=0.5,
                  bending=bending)
    rough = np.resize([0.1, 1e4, 0.1, 9.0], len(grid.mean)) * 0.5 * 0.004**2
    table, even = (weigh_cells(replace(grid, roughness=one), noise).table[:4]
                   for one in (rough, np.empty(0)))
    assert table[:, LOCAL_RATIO] == pytest.approx([1, MAX_LOCAL_RATIO, 1, 9])
    assert (even[:, LOCAL_RATIO] == 1).all()
    for weight in (MEAN_WEIGHT, SLOPE_WEIGHT):
        assert even[2:, weight] / table[2:, weight] == pytest.approx([1, smooth_ratio])
    assert table[2:, SQUARED_ERROR] == pytest.approx(
        64 * np.array([0.003**2 + 0.004**2, smooth_ratio * 0.003**2 + 9 * 0.004**2]))


def test_the_roughness_of_a_cell_is_that_along_its_contours():
    """Half the mean squared difference of neighbours, without slopes and steps."""
    v, u = np.mgrid[:480, :640]
    slanted = 0.5 + 0.01 * (u + v) + np.random.default_rng(0).normal(0, 0.002, v.shape)
    for disparity in (slanted, slanted + 0.5 * (u >= 324)):
        image = DisparityImage(disparity.astype(np.float32), np.ones(v.shape, bool))
        grid = build_cell_grid(image)
        rough = roughness_of(image.values, image.valid, grid.slope, grid.size_px, grid.width_px)
        assert np.sqrt(rough.mean()) == pytest.approx(0.002, rel=0.05)


def test_the_roughness_around_is_the_third_least_or_the_own():
    values = np.random.default_rng(0).uniform(1, 2, (7, 9))
    usable = np.random.default_rng(1).random(values.shape) < 0.8
    found = least_around(values.ravel(), usable.ravel(), 9).reshape(values.shape)
    for row, column in np.ndindex(values.shape):
        near = np.s_[max(row - 1, 0):row + 2, max(column - 1, 0):column + 2]
        around = np.append(np.sort(values[near][usable[near]]), [np.inf] * 3)
        expected = min(values[row, column], around[2]) if usable[row, column] else 0.0
        assert found[row, column] == expected


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
