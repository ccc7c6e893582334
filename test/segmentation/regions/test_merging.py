# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Hand-made regions: which become one, and that merging them is exact."""

from dataclasses import replace

import numpy as np
import pytest
from cell_helpers import EXACT, cell_model, hand_made, view, wall

from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.adjacency import (
    BORDER_REACH_CELLS,
    MAX_JOINT_VARIANCES,
    find_adjacency,
    joint_misfit,
    merge,
)
from plane_detector.segmentation.regions.merging import merge_adjacent

SIGMAS = (0.0, 0.004, 0.01)
WEIGHED = replace(EXACT, mean_sigma=0.005, slope_sigma=0.2, pixel_sigma=0.005)


def stripes(shape, count):
    """Return labels of upright stripes of equal width."""
    return np.tile(np.arange(shape[1]) * count // shape[1], (shape[0], 1))


def noise_of(sigma):
    """Return what cells show of noise half of which is smooth."""
    part = sigma * np.sqrt(0.5)
    # Blurred with a Gaussian of 12 pixels it tilts by 1 / (12 sqrt(2)) of itself per pixel.
    return replace(EXACT, mean_sigma=part, slope_sigma=part * 640 / (12 * np.sqrt(2)),
                   pixel_sigma=part)


def noisy_model(scene, sigma):
    """Return the cells of a view under such noise, weighed by it."""
    depth_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(0))
    return cell_model(depth_m, noise_of(sigma))


def correlation_of(model, regions, sigma):
    """Return the correlation of the noise, None where there is none."""
    return Correlation.of(model, regions, noise_of(sigma)) if sigma else None


def two_walls(step_m):
    return view([wall(2, right_m=0), wall(2 + step_m, 0)])


@pytest.mark.parametrize('sigma', SIGMAS)
@pytest.mark.parametrize('count', [2, 5, 8])
def test_stripes_of_one_wall_become_one(sigma, count):
    model = noisy_model(view([wall(2.5)], angles_deg=(30, 0, 0)), sigma)
    regions = hand_made(model, stripes(model.grid.shape, count))
    result = merge_adjacent(model, regions, correlation_of(model, regions, sigma))
    assert (result.labels == 0).all()
    whole = hand_made(model, np.zeros(model.grid.shape, int)).coefficients
    np.testing.assert_allclose(result.coefficients, whole, rtol=1e-9)


@pytest.mark.parametrize(('step_m', 'sigma'), [(0.01, 0.0), (0.1, 0.004), (0.3, 0.01)])
@pytest.mark.parametrize('turned', [False, True])
def test_stripes_of_two_walls_become_two(step_m, sigma, turned):
    model = noisy_model(two_walls(step_m), sigma)
    labels = stripes(model.grid.shape, 8)
    # The numbers say nothing: neighbours need not be neighbours in number.
    labels = np.array([5, 2, 7, 0, 3, 6, 1, 4])[labels] if turned else labels
    result = merge_adjacent(model, regions := hand_made(model, labels),
                            correlation_of(model, regions, sigma))
    assert len(result.coefficients) == 2
    left, right = result.labels[:, :40], result.labels[:, 40:]
    assert (left == left[0, 0]).all()
    assert (right == 1 - left[0, 0]).all()


def bulging_wall(height, width_px, is_box):
    """Return the cells of a wall with a bulge of so many deviations, and how far each is off."""
    v, u = np.mgrid[:480, :640]
    off_px = np.hypot(u - 320, v - 240)
    bulge = off_px < width_px if is_box else np.exp(-off_px**2 / (2 * width_px**2))
    disparity = 0.4 + height * WEIGHED.mean_sigma * bulge
    return cell_model((1 / disparity).astype(np.float32), WEIGHED), off_px[4::8, 4::8]


@pytest.mark.parametrize(('height', 'width_px', 'radius_px', 'is_box', 'count'), [
    (4, 60, 60, False, 1), (5, 60, 60, False, 2), (5, 150, 150, False, 1),
    (5, 150, 190, False, 2), (2.7, 60, 60, True, 2)])
def test_a_low_small_bulge_without_a_step_is_part_of_the_wall(height, width_px, radius_px, is_box,
                                                              count):
    model, off_px = bulging_wall(height, width_px, is_box)
    regions = hand_made(model, (off_px < radius_px).astype(int))
    assert joint_misfit(model, regions, np.array([0]), np.array([1]))[0] > 1
    assert len(merge_adjacent(model, regions, None).coefficients) == count


@pytest.mark.parametrize(('bend', 'count'), [(0.01, 1), (0.04, 3), (0.15, 5), (0.4, 8)])
def test_of_what_bends_only_neighbours_merge_and_fit_what_they_hold(bend, count):
    disparity = np.tile(0.4 + bend * np.linspace(-0.5, 0.5, 640) ** 2, (480, 1))
    model = cell_model((1 / disparity).astype(np.float32), replace(WEIGHED, mean_sigma=0.001))
    result = merge_adjacent(model, hand_made(model, stripes(model.grid.shape, 8)), None)
    assert len(result.coefficients) == count
    assert np.count_nonzero(np.diff(result.labels[0])) == count - 1
    refitted = hand_made(model, result.labels).coefficients
    np.testing.assert_allclose(result.coefficients, refitted, atol=1e-9)


@pytest.mark.parametrize(('gap', 'count'), [(0, 1), (1, 1), (2, 2), (9, 2)])
def test_patches_that_do_not_touch_stay_apart(gap, count):
    model = cell_model(view([wall(2.5)]).depth_m)
    labels = np.full(model.grid.shape, -1)
    labels[:, :30], labels[:, 30 + gap:] = 0, 1
    assert len(merge_adjacent(model, hand_made(model, labels), None).coefficients) == count


@pytest.mark.parametrize('length', [1, 2])
def test_a_border_needs_more_than_one_pair_of_cells(length):
    model = cell_model(view([wall(2.5)]).depth_m)
    labels = np.full(model.grid.shape, -1)
    labels[10:20, 10:20], labels[20 - length:30, 22:32] = 0, 1
    labels[20 - length:20, 20] = 0
    found = find_adjacency(model, labels.astype(np.int32))
    assert found.count.tolist() == [length] * (length > 1)
    assert len(merge_adjacent(model, hand_made(model, labels), None).coefficients) == 3 - length


def test_several_disjoint_pairs_at_once():
    model = noisy_model(view([wall(2.5)]), 0.004)
    regions = hand_made(model, labels := stripes(model.grid.shape, 8))
    result = merge(model, regions, np.array([0, 4, 2]), np.array([1, 7, 3]))
    expected = np.array([0, 0, 1, 1, 2, 3, 4, 2])[labels]
    np.testing.assert_array_equal(result.labels, expected)
    refitted = hand_made(model, expected).coefficients
    np.testing.assert_allclose(result.coefficients[:3], refitted[:3], rtol=1e-9)
    np.testing.assert_array_equal(result.coefficients[3:], regions.coefficients[5:7])


def test_joint_misfit_by_hand():
    """The worse side's mean square about the joint plane, in variances, over the most."""
    model = noisy_model(two_walls(0.05), 0.004)
    regions = hand_made(model, stripes(model.grid.shape, 2))
    x, y, d = model.grid.mean[model.is_planar].T
    design = np.stack([x, y, np.ones_like(x)], axis=1)
    error = d - design @ np.linalg.lstsq(design, d, rcond=None)[0]
    label = regions.labels.ravel()[model.is_planar]
    variance = 1 / model.table[model.is_planar, 5]
    worse = max(np.mean(error[label == k]**2) / variance[label == k].mean() for k in (0, 1))
    misfit, _ = joint_misfit(model, regions, np.array([0]), np.array([1]))
    assert misfit == pytest.approx([worse / MAX_JOINT_VARIANCES], rel=1e-3)


def test_adjacency_equals_a_loop_over_pairs_of_cells():
    model = cell_model(view([wall(2.5)]).depth_m)
    labels = np.random.default_rng(0).integers(-1, 5, model.grid.shape).astype(np.int32)
    mean = model.grid.mean.reshape(*labels.shape, 3)
    pairs = {}
    for row, column in np.ndindex(labels.shape):
        for gap in range(1, BORDER_REACH_CELLS + 1):
            for other in ((row + gap, column), (row, column + gap)):
                if other[0] < labels.shape[0] and other[1] < labels.shape[1]:
                    ends = sorted([(row, column), other], key=lambda at: labels[at])
                    if 0 <= labels[ends[0]] < labels[ends[1]]:
                        key = labels[ends[0]], labels[ends[1]]
                        pairs.setdefault(key, []).append([mean[end] for end in ends])
    found = find_adjacency(model, labels)
    assert sorted(pairs) == list(zip(found.first, found.second, strict=True))
    for k, key in enumerate(sorted(pairs)):
        assert found.count[k] == len(pairs[key])
        np.testing.assert_allclose([found.mean_first[k], found.mean_second[k]],
                                   np.mean(pairs[key], axis=0), atol=1e-9)
