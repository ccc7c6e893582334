# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Moments of cells against loops over pixels; regions brought to another unit."""

import numpy as np
import pytest
from cell_helpers import noisy, view, wall

from plane_detector.config import Config
from plane_detector.geometry.disparity import to_disparity
from plane_detector.segmentation.cells.grid import (
    DisparityImage,
    build_cell_grid,
    fit_plane,
    fit_planes,
    pixel_frame,
    squared_error,
)
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.segment import segment, unitless_noise_floor

SHAPE = (250, 333)


def bumpy(seed, holes=0.2):
    """Return a bumpy disparity with holes, whose sides are no multiples of the cells'."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:SHAPE[0], :SHAPE[1]]
    disparity = 0.3 + 1e-3 * u - 5e-4 * v + rng.normal(0, 0.02, SHAPE)
    valid = rng.random(SHAPE) >= holes
    valid[40:60, 100:130] = False
    return DisparityImage(np.where(valid, disparity, 0).astype(np.float32), valid)


def brute_force(image, size):
    """Return moments and least-squares plane of each cell, and pixels of the first, by loops."""
    x, y = ((np.arange(side) - (side - 1) / 2) / SHAPE[1] for side in (SHAPE[1], SHAPE[0]))
    moments, planes, first = [], [], ()
    for row in range(0, SHAPE[0], size):
        for column in range(0, SHAPE[1], size):
            part = np.s_[row:row + size, column:column + size]
            v, u = np.nonzero(image.valid[part])
            d = image.values[part][v, u].astype(float)
            px, py, one = x[column + u], y[row + v], np.ones(len(u))
            columns = np.stack([one, px, py, px * px, px * py, py * py, d, px * d, py * d, d * d])
            moments.append(columns.sum(axis=1))
            design = np.stack([px, py, one], axis=1)
            planes.append(np.linalg.lstsq(design, d, rcond=None)[0] if len(d) else np.zeros(3))
            first = first or (design, d)
    return np.array(moments), np.array(planes), first


@pytest.mark.parametrize('holes', [0.0, 0.2])
def test_moments_equal_loops_over_pixels(holes):
    image = bumpy(1, holes)
    grid = build_cell_grid(image)
    assert grid.shape == (-(-SHAPE[0] // grid.size_px), -(-SHAPE[1] // grid.size_px))
    moments, planes, (design, d) = brute_force(image, grid.size_px)
    np.testing.assert_allclose(grid.moments, moments, rtol=1e-5, atol=1e-6)
    known, usable = moments[:, 0] > 0, grid.usable
    np.testing.assert_allclose(grid.mean[known],
                               moments[known][:, [1, 2, 6]] / moments[known, :1], atol=1e-6)
    np.testing.assert_allclose(grid.slope[usable], planes[usable, :2], rtol=1e-3, atol=1e-3)
    own = fit_planes(grid.moments)
    for one, together in zip(grid.moments, own, strict=True):
        np.testing.assert_allclose(fit_plane(one), together, rtol=1e-9)
    assert squared_error(1.0, 2.0, 3.0, moments[0]) == pytest.approx(
        ((design @ [1.0, 2.0, 3.0] - d) ** 2).sum())
    misfit = [squared_error(*own[i], grid.moments[i]) for i in np.flatnonzero(usable)]
    np.testing.assert_allclose(grid.residual_rms[usable],
                               np.sqrt(misfit / grid.moments[usable, 0]), rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(('lines', 'usable'), [([3], False), ([2, 5], True)])
def test_one_line_of_a_lidar_is_no_plane_two_are(lines, usable):
    valid = np.zeros((480, 640), bool)
    for line in lines:
        valid[line::8] = True
    image = DisparityImage(np.where(valid, np.float32(0.2), np.float32(0)), valid)
    assert (build_cell_grid(image).usable == usable).all()


def test_the_cells_of_a_part_are_those_of_the_whole_image():
    image = bumpy(3)
    whole = build_cell_grid(image, 10)
    rows = DisparityImage(image.values[40:130], image.valid[40:130])
    grid = build_cell_grid(rows, 10, frame=pixel_frame(SHAPE, 40))
    assert grid.shape == (9, whole.shape[1]) and grid.width_px == whole.width_px
    for name in ('moments', 'mean', 'slope', 'residual_rms', 'usable'):
        values = getattr(whole, name).reshape(*whole.shape, -1)[4:13]
        np.testing.assert_allclose(getattr(grid, name).reshape(values.shape), values, atol=1e-9)


def test_planes_in_pixels_have_the_disparity_of_the_same_planes_in_cells():
    image = DisparityImage(np.ones((60, 640), np.float32), np.ones((60, 640), bool))
    grid = build_cell_grid(image, 10, frame=pixel_frame((480, 640), 40))
    u, v = 207, 12  # in these rows
    x, y = (u - 319.5) / 640, (40 + v - 239.5) / 640
    (a, b, c), = grid.planes_in_pixels(np.array([[0.3, -0.2, 0.5]]))
    assert a * u + b * v + c == pytest.approx(0.3 * x - 0.2 * y + 0.5)


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
    noise = Noise(0.0005, 1e-6, 0.1, 0.2, 0.3, 0.4, own_share=0.5).rescaled(2.0)
    disparity = np.array([0.2, 1.0])
    expected = 4 * Noise(0.0005, 1e-6).variance_floor(disparity)
    np.testing.assert_allclose(noise.variance_floor(2.0 * disparity), expected)
    assert (noise.source_sigma, noise.mean_sigma) == (0.2, 0.4)
    assert (noise.slope_sigma, noise.pixel_sigma, noise.own_share) == (0.6, 0.8, 0.5)
