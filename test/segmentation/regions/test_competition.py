# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells go to the plane that explains them, or to none."""

import numpy as np
from cell_helpers import EXACT, cell_model, view, wall

from plane_detector.segmentation.cells.labels import at_borders
from plane_detector.segmentation.regions import competition


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
    found = competition._compete(labels, at_borders(labels, 1), (planes, model.table), 9.0)
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
