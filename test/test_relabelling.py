# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells go to the plane that explains them, and those that none explains to none."""

import numpy as np
import pytest
from cell_helpers import cell_model, view, wall

from plane_detector.config import DbscanConfig
from plane_detector.ransac import Patches
from plane_detector.relabelling import relabel


def halves():
    """Return the model and the planes of two walls, left at 2 m and right at 3 m."""
    model = cell_model(view([wall(2.0, right_m=0), wall(3.0, 0)]).depth_m)
    return model, np.array([[0, 0, 0.5], [0, 0, 1 / 3]])


def labels_of(model, left, right):
    """Return labels of the left and the right half of the cells."""
    labels = np.full(model.grid.shape, left, np.int32)
    labels[:, model.grid.shape[1] // 2:] = right
    return labels


def relabelled(model, labels, planes):
    return relabel(model, Patches(labels, planes), 3.0, 600, DbscanConfig())


@pytest.mark.parametrize(('left', 'right', 'kept'), [(0, -1, 0), (-1, 0, 1)])
def test_what_no_plane_explains_has_none(left, right, kept):
    model, planes = halves()
    found = relabelled(model, labels_of(model, left, right), planes[[kept]])
    assert len(found.planes) == 1
    np.testing.assert_allclose(found.planes[0], planes[kept], atol=1e-6)
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
    np.testing.assert_allclose(found.planes, planes, atol=1e-6)


def test_pieces_far_apart_become_planes_of_their_own():
    model, planes = halves()
    labels = labels_of(model, 0, -1)
    labels[20:40] = -1
    mask = model.planar.reshape(labels.shape).copy()
    mask[20:40] = False
    model = type(model)(model.grid, model.variances, mask.ravel(), model.quadratic)
    labels[22:38] = -1
    found = relabelled(model, labels, planes[:1])
    assert len(found.planes) == 2
    np.testing.assert_allclose(found.planes, planes[[0, 0]], atol=1e-6)


def test_no_planes_are_no_planes():
    model, _ = halves()
    none = Patches(labels_of(model, -1, -1), np.zeros((0, 3)))
    assert relabel(model, none, 3.0, 600, DbscanConfig()) is none
