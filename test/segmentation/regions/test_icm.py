# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells go to the plane that explains them, and those that none explains to none."""

from dataclasses import replace

import numpy as np
import pytest
from cell_helpers import EXACT, cell_model, frame_of, view, wall

from plane_detector.segmentation.cells.labels import at_borders
from plane_detector.segmentation.cells.model import PlaneRegions, weigh_cells
from plane_detector.segmentation.regions import icm
from plane_detector.segmentation.regions.icm import compete_for_cells


def halves():
    """Return the cells and the planes of two walls, left at 2 m and right at 3 m."""
    model = cell_model(view([wall(2.0, right_m=0), wall(3.0, 0)]).depth_m)
    return model, np.array([[0, 0, 0.5], [0, 0, 1 / 3]])


def labels_of(model, left, right):
    """Return labels of the left and the right half of the cells."""
    labels = np.full(model.grid.shape, left, np.int32)
    labels[:, model.grid.shape[1] // 2:] = right
    return labels


def relabelled(model, labels, planes):
    return compete_for_cells(frame_of(None, model), PlaneRegions(labels, planes))


@pytest.mark.parametrize(('left', 'right', 'kept'), [(0, -1, 0), (-1, 0, 1)])
def test_what_no_plane_explains_has_none(left, right, kept):
    model, planes = halves()
    found = relabelled(model, labels_of(model, left, right), planes[[kept]])
    assert len(found.coefficients) == 1
    np.testing.assert_allclose(found.coefficients[0], planes[kept], atol=1e-6)
    own = labels_of(model, 0, -1) if kept == 0 else labels_of(model, -1, 0)
    assert (found.labels == own).mean() > 0.97
    assert set(np.unique(found.labels)) == {-1, 0}


def test_cells_near_their_plane_change_over():
    model, planes = halves()
    labels = labels_of(model, 0, 1)
    columns = labels.shape[1] // 2
    labels[:, columns - 2:columns] = 1
    found = relabelled(model, labels, planes)
    assert (found.labels == labels_of(model, 0, 1)).mean() > 0.99
    np.testing.assert_allclose(found.coefficients, planes, atol=1e-6)


def test_pieces_far_apart_become_planes_of_their_own():
    model, planes = halves()
    labels = labels_of(model, 0, -1)
    labels[20:40] = -1
    mean = model.grid.mean.copy()
    mean.reshape(*labels.shape, 3)[20:40, :, 2] = 0.8  # something nearer between the pieces
    model = weigh_cells(replace(model.grid, mean=mean), EXACT)
    found = relabelled(model, labels, planes[:1])
    assert len(found.coefficients) == 2
    np.testing.assert_allclose(found.coefficients, planes[[0, 0]], atol=1e-6)


def test_no_planes_are_no_planes():
    model, _ = halves()
    none = PlaneRegions(labels_of(model, -1, -1), np.zeros((0, 3)))
    assert compete_for_cells(frame_of(None, model), none) is none


def energy(model, labels, planes):
    """Return what each plane, and last none, costs each cell."""
    table = model.table
    cost = np.full((labels.size, len(planes) + 1), icm.OUTLIER_COST * 9)
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
    found = icm._compete(labels, at_borders(labels), (planes, model.table), 9.0)
    np.testing.assert_array_equal(labels, given)
    assert (found != given).any()
    padded = np.pad(found, 1, mode='edge')
    around = np.stack([padded[i:i + 60, j:j + 80] for i in range(3) for j in range(3)], axis=-1)
    votes = (around[..., None] == [0, 1, -1]).sum(axis=2).reshape(-1, 3)
    cost = energy(model, found, planes) - icm.POTTS_WEIGHT * votes
    is_asked = votes > 0
    is_asked[:, 2] |= (votes[:, :2].max(axis=1) < 9)
    best = np.where(is_asked, cost, np.inf).argmin(axis=1)
    np.testing.assert_array_equal(np.array([0, 1, -1])[best], found.ravel())
