# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Moments of cells against loops over pixels."""

import numpy as np
import pytest

from plane_detector.segmentation.cells import grid as cells

SHAPE = (250, 333)


def disparity_image(rng, holes=0.2):
    """Return a bumpy disparity with holes, whose sides are no multiples of the cells'."""
    v, u = np.mgrid[:SHAPE[0], :SHAPE[1]]
    disparity = 0.3 + 1e-3 * u - 5e-4 * v + rng.normal(0, 0.02, SHAPE)
    valid = rng.random(SHAPE) >= holes
    valid[40:60, 100:130] = False
    return np.where(valid, disparity, 0).astype(np.float32), valid


def brute_force(disparity, valid, size):
    """Return the moments of each cell and the cell's least-squares plane, by loops."""
    x, y = cells.picture_coordinates(disparity.shape)
    moments, planes = [], []
    for row in range(0, SHAPE[0], size):
        for column in range(0, SHAPE[1], size):
            part = np.s_[row:row + size, column:column + size]
            v, u = np.nonzero(valid[part])
            d = disparity[part][v, u].astype(float)
            px, py, one = x[column + u], y[row + v], np.ones(len(u))
            columns = np.stack([one, px, py, px * px, px * py, py * py, d, px * d, py * d, d * d])
            moments.append(columns.sum(axis=1))
            design = np.stack([px, py, one], axis=1)
            planes.append(np.linalg.lstsq(design, d, rcond=None)[0] if len(d) else np.zeros(3))
    return np.array(moments), np.array(planes)


@pytest.mark.parametrize('holes', [0.0, 0.2])
def test_moments_equal_loops_over_pixels(holes):
    disparity, valid = disparity_image(np.random.default_rng(1), holes)
    grid = cells.make_cells(disparity, valid)
    assert grid.shape == (-(-SHAPE[0] // grid.size_px), -(-SHAPE[1] // grid.size_px))
    moments, planes = brute_force(disparity, valid, grid.size_px)
    np.testing.assert_allclose(grid.moments, moments, rtol=1e-5, atol=1e-6)
    known = moments[:, 0] > 0
    np.testing.assert_allclose(grid.mean[known],
                               moments[known][:, [1, 2, 6]] / moments[known, :1], atol=1e-6)
    np.testing.assert_allclose(grid.slope[grid.usable], planes[grid.usable, :2], rtol=1e-3,
                               atol=1e-3)


def test_inner_rms_is_the_misfit_of_the_cells_own_plane():
    disparity, valid = disparity_image(np.random.default_rng(2))
    grid = cells.make_cells(disparity, valid)
    own = cells.fit_planes(grid.moments)
    usable = np.flatnonzero(grid.usable)
    expected = np.sqrt(cells.squared_error(own, grid.moments)[usable] / grid.moments[usable, 0])
    np.testing.assert_allclose(grid.inner_rms[usable], expected, rtol=1e-3, atol=1e-6)


def test_cells_that_are_nearly_all_holes_are_not_usable():
    disparity, valid = disparity_image(np.random.default_rng(3))
    grid = cells.make_cells(disparity, valid)
    share = grid.moments[:, 0] / grid.size_px**2
    assert (share[grid.usable] >= cells.MIN_VALID_SHARE).all()
    assert grid.usable[share == 1].all()


@pytest.mark.parametrize(('lines', 'usable'), [([3], False), ([2, 5], True)])
def test_one_line_of_a_lidar_is_no_plane_two_are(lines, usable):
    valid = np.zeros((480, 640), bool)
    for line in lines:
        valid[line::8] = True
    grid = cells.make_cells(np.where(valid, np.float32(0.2), np.float32(0)), valid)
    assert (grid.usable == usable).all()


def test_far_and_near_planes_are_summed_exactly_enough():
    """A float32 sum of x*d over a picture loses digits; sums about each cell's centre do not."""
    v, u = np.mgrid[:480, :640]
    for scale in (1e-3, 1.0, 1e3):
        disparity = scale * (1 + 1e-3 * (u - 319.5) / 640 - 2e-3 * (v - 239.5) / 640)
        grid = cells.make_cells(disparity.astype(np.float32), np.ones(disparity.shape, bool))
        fitted = cells.fit_planes(grid.moments.sum(axis=0)) / scale
        np.testing.assert_allclose(fitted, [1e-3, -2e-3, 1.0], atol=1e-7)


def test_fit_planes_equals_least_squares():
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-0.5, 0.5, (2, 200))
    d = 0.3 * x - 0.7 * y + 0.5 + rng.normal(0, 0.1, 200)
    one = np.ones(200)
    moments = np.stack([one, x, y, x * x, x * y, y * y, d, x * d, y * d, d * d]).sum(axis=1)
    design = np.stack([x, y, one], axis=1)
    expected, error, *_ = np.linalg.lstsq(design, d, rcond=None)
    plane = cells.fit_planes(moments)
    np.testing.assert_allclose(plane, expected, rtol=1e-9)
    assert cells.squared_error(plane, moments) == pytest.approx(error[0], rel=1e-9)
    other = np.array([1.0, 2.0, 3.0])
    assert cells.squared_error(other, moments) == pytest.approx(((design @ other - d)**2).sum())


@pytest.mark.parametrize('points', [
    np.zeros((0, 2)), np.zeros((1, 2)), np.array([[0, 0], [1, 1.0]]),
    np.stack([np.linspace(0, 1, 50), np.linspace(0, 2, 50)], axis=1)])
def test_points_on_a_line_have_no_plane(points):
    x, y, one = points[:, 0], points[:, 1], np.ones(len(points))
    d = x + y
    moments = np.stack([one, x, y, x * x, x * y, y * y, d, x * d, y * d, d * d]).sum(axis=1)
    assert np.isnan(cells.fit_planes(moments)).all()


@pytest.mark.parametrize('seed', range(5))
def test_one_plane_is_fitted_as_many_are(seed):
    disparity, valid = disparity_image(np.random.default_rng(seed))
    moments = cells.make_cells(disparity, valid).moments
    for one, together in zip(moments, cells.fit_planes(moments), strict=True):
        np.testing.assert_allclose(cells.fit_plane(one), together, rtol=1e-9)


def test_a_cut_out_has_the_cells_of_the_picture():
    disparity, valid = disparity_image(np.random.default_rng(5))
    whole = cells.make_cells(disparity, valid, 4)
    cut = cells.make_cells(disparity[8:20, 12:], valid[8:20, 12:], 4, (8, 12), disparity.shape)
    for name in ('moments', 'mean', 'slope', 'inner_rms', 'usable'):
        all_of_them = getattr(whole, name).reshape(*whole.shape, -1)
        np.testing.assert_allclose(getattr(cut, name).reshape(*cut.shape, -1),
                                   all_of_them[2:5, 3:], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize('shape', [(1, 1), (2, 2), (1, 500), (480, 640), (3000, 4000)])
def test_the_number_of_cells_hardly_grows_with_the_picture(shape):
    size = cells.cell_size(shape)
    assert size >= 1
    count = np.ceil(shape[0] / size) * np.ceil(shape[1] / size)
    assert count <= 2.5 * cells.CELLS_PER_PICTURE


def test_input_is_not_modified():
    disparity, valid = disparity_image(np.random.default_rng(6))
    before = disparity.copy(), valid.copy()
    cells.make_cells(disparity, valid)
    np.testing.assert_array_equal(disparity, before[0])
    np.testing.assert_array_equal(valid, before[1])


@pytest.mark.parametrize('dtype', [np.float32, np.int32, bool])
@pytest.mark.parametrize(('shape', 'size'), [
    ((24, 40), 8), ((23, 41), 8), ((9, 7), 3), ((4, 5), 1)])
def test_pixels_of_cells_are_those_of_the_picture(dtype, shape, size):
    image = np.random.default_rng(0).integers(0, 100, shape).astype(dtype)
    rows, columns = (-(-side // size) for side in shape)
    padded = np.ones((rows * size, columns * size), dtype)
    padded[:shape[0], :shape[1]] = image
    expected = [padded[i:i + size, j:j + size] for i in range(0, rows * size, size)
                for j in range(0, columns * size, size)]
    np.testing.assert_array_equal(cells.pixels_of_cells(image, size, fill=1), expected)
    some = np.array([rows * columns - 1, 0])
    np.testing.assert_array_equal(
        cells.pixels_of_cells(image, size, *np.divmod(some, columns), fill=1),
        [expected[k] for k in some])


@pytest.mark.parametrize('shape', [(5, 7), (1, 4), (1, 1)])
def test_around_a_cell_are_its_neighbours(shape):
    labels = np.arange(shape[0] * shape[1]).reshape(shape) + 10
    cell = np.arange(labels.size)
    for k, found in zip(cell, cells.around(labels, cell), strict=True):
        row, column = divmod(k, shape[1])
        near = labels[max(row - 1, 0):row + 2, max(column - 1, 0):column + 2]
        assert len(found) == 9
        assert set(found) == set(near.ravel())


@pytest.mark.parametrize('count', [1, 2, 3, 10, 11])
def test_median_is_that_of_numpy(count):
    values = np.random.default_rng(count).normal(size=count)
    assert cells.median(values) == np.median(values)
