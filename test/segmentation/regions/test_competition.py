# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells go to the plane that explains them, or to none; borders lie on steps of the depth."""

from functools import cache

import numpy as np
import pytest
from cell_helpers import EXACT, cell_model, frame_of, noisy, view, wall

from plane_detector.segmentation.cells.model import PlaneRegions, at_borders
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions import competition

SIGMA = 0.004
NOISE = Noise(0.001, 0.0, 0.0, SIGMA / 2**0.5, 0.05, SIGMA / 2**0.5)
# Of the blur of the rendered noise, 12 pixels, in cells of 8 pixels.
CORRELATION = Correlation(SIGMA**2 / 2, SIGMA**2 / 128, (8 / 24)**2, 2.0, (60, 80))
NEAR_M, FAR_M = 2.0, 2.04
"""A gap of 0.01 per metre, 3.5 deviations of the smooth part."""
HALF = 40
"""The first column of cells of the near wall."""


def energy(model, labels, planes):
    """Return what each plane, and last none, costs each cell."""
    table = model.table
    cost = np.full((labels.size, len(planes) + 1), competition.OUTLIER_COST * 9)
    for k, (a, b, c) in enumerate(planes):
        residual = table[:, 2] - (a * table[:, 0] + b * table[:, 1] + c)
        tilt = (table[:, 3] - a) ** 2 + (table[:, 4] - b) ** 2
        cost[:, k] = residual**2 * table[:, 5] + tilt * table[:, 6]
    return cost


def test_no_cell_would_rather_have_the_label_of_a_neighbour():
    rng = np.random.default_rng(0)
    model = cell_model(view([wall(2.0)]).depth_m)
    # The second strays from the wall by 2 to 6 deviations, whose squares votes may outweigh.
    deviation = np.sqrt(EXACT.variance_floor(0.5))
    planes = np.array([[0, 0, 0.5], [4 * deviation, 0, 0.5 + 4 * deviation]])
    labels = rng.integers(-1, 2, (12, 16)).astype(np.int32).repeat(5, axis=0).repeat(5, axis=1)
    given = labels.copy()
    found = competition._compete(labels, at_borders(labels), (planes, model.table), 9.0)
    np.testing.assert_array_equal(labels, given)
    assert (found != given).any()
    padded = np.pad(found, 1, mode='edge')
    around = np.stack([padded[i:i + 60, j:j + 80] for i in range(3) for j in range(3)], axis=-1)
    votes = (around[..., None] == [0, 1, -1]).sum(axis=2).reshape(-1, 3)
    cost = energy(model, found, planes) - competition.POTTS_WEIGHT * votes
    is_asked = votes > 0
    is_asked[:, 2] |= (votes[:, :2].max(axis=1) < 9)
    best = np.where(is_asked, cost, np.inf).argmin(axis=1)
    np.testing.assert_array_equal(np.array([0, 1, -1])[best], found.ravel())


@cache
def cells_of(near_from_m):
    """Return the cells of a far wall with a near one, from left to right, under noise."""
    scene = view([wall(FAR_M), wall(NEAR_M, near_from_m)])
    return cell_model(noisy(scene, 0, SIGMA), NOISE)


def reassigned(model, labels, correlation=CORRELATION):
    regions = PlaneRegions(labels, np.array([[0, 0, 1 / FAR_M], [0, 0, 1 / NEAR_M]]))
    return competition.reassign_cells(frame_of(None, model, NOISE), regions, correlation)


def test_a_piece_without_a_step_around_it_goes_as_a_whole():
    """Its cells differ from their neighbours by the gap between the planes, if they stay."""
    model = cells_of(49.0)
    labels = np.zeros(model.grid.shape, np.int32)
    labels[20:28, 30:38] = 1
    labels[24:34, 36:40] = 1
    found = reassigned(model, labels)
    assert (found.labels == 0).all()
    assert len(found.coefficients) == 1


@pytest.mark.parametrize(('reach', 'most_wrong'), [(1, 0), (2, 10)])
@pytest.mark.parametrize('seed', range(3))
def test_a_ragged_border_returns_to_the_step(seed, reach, most_wrong):
    model = cells_of(0.0)
    columns = np.indices(model.grid.shape)[1]
    true = (columns >= HALF).astype(np.int32)
    shift = np.random.default_rng(seed).integers(-reach, reach + 1, (len(true), 1))
    ragged = (columns >= HALF + shift).astype(np.int32)
    found = reassigned(model, ragged)
    assert (ragged != true).sum() > 35 * reach
    assert (found.labels != true).sum() <= most_wrong
    np.testing.assert_allclose(found.coefficients[:, 2], [1 / FAR_M, 1 / NEAR_M], atol=SIGMA / 2)
