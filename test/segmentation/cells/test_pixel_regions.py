# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Regions brought to another unit are those of the disparity in that unit."""

import numpy as np
import pytest
from cell_helpers import noisy, view, wall

from plane_detector.config import Config
from plane_detector.geometry.disparity import to_disparity
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.segment import segment, unitless_noise_floor

UNITS = [(1.0, 0.0), (0.02, 0.0), (3.0, 0.25), (0.5, -0.1)]


@pytest.fixture(scope='module')
def regions():
    depth_m = noisy(view([wall(2.0)], angles_deg=(20, 5, 0)), 0, 0.004).copy()
    depth_m[:40] = np.nan
    disparity = to_disparity(depth_m)
    return segment(disparity, unitless_noise_floor(disparity), Config())


@pytest.mark.parametrize(('scale', 'shift'), UNITS)
def test_the_grid_and_the_planes_are_those_of_the_rescaled_disparity(regions, scale, shift):
    valid = regions.disparity > 0
    rescaled = np.where(valid, scale * regions.disparity.astype(float) + shift, 0)
    expected = build_cell_grid(DisparityImage(rescaled.astype(np.float32), valid))
    found = regions.rescaled(scale, shift)
    for name in ('moments', 'mean', 'slope', 'residual_rms'):
        values = getattr(expected, name)
        # The rms within a cell is a small difference of float32 sums.
        np.testing.assert_allclose(getattr(found.grid, name), values, rtol=1e-4,
                                   atol=2e-5 * np.abs(values).max(), err_msg=name)
    np.testing.assert_array_equal(found.grid.usable, expected.usable)
    assert found.grid.typical_disparity == pytest.approx(expected.typical_disparity, rel=1e-5)
    v, u = np.nonzero(found.labels == 0)
    height, width = found.labels.shape
    x, y = (u - (width - 1) / 2) / width, (v - (height - 1) / 2) / width
    residual = found.disparity[v, u] - found.coefficients[0] @ [x, y, np.ones(len(x))]
    assert np.abs(residual).mean() < 0.01 * scale
    assert found.noise.mean_sigma == pytest.approx(scale * regions.noise.mean_sigma)
    assert (found is regions) == ((scale, shift) == (1.0, 0.0))


def test_restricted_to_where_depth_is_valid(regions):
    valid = np.zeros(regions.labels.shape, bool)
    valid[:, :100] = True
    found = regions.restricted_to(valid)
    assert (found.labels[:, 100:] == -1).all()
    np.testing.assert_array_equal(found.labels[:, :100], regions.labels[:, :100])
    assert (regions.labels[:, 100:] == 0).any(), 'the given ones stay'


def test_the_floor_of_depth_scales_with_depth():
    noise = Noise(0.0005, 1e-6, 0.1, 0.2, 0.3, 0.4).rescaled(2.0)
    disparity = np.array([0.2, 1.0])
    expected = 4 * Noise(0.0005, 1e-6).variance_floor(disparity)
    np.testing.assert_allclose(noise.variance_floor(2.0 * disparity), expected)
    assert (noise.source_sigma, noise.mean_sigma) == (0.2, 0.4)
    assert (noise.slope_sigma, noise.pixel_sigma) == (0.6, 0.8)
