# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells go to the plane that explains them, and those that none explains to none."""

import numpy as np
import pytest
from cell_helpers import EXACT, cell_model, view, wall

from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells.model import Patches
from plane_detector.segmentation.regions import icm as relabelling
from plane_detector.segmentation.regions.icm import relabel


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


def competed(cost, labels):
    """Return the labels after sweeps over all cells, as the energy is defined."""
    count = cost.shape[1] - 1
    labels = np.where(labels < 0, count, labels)
    for _ in range(relabelling.SWEEPS):
        padded = np.pad(labels, 1, mode='edge')
        around = np.stack([padded[i:i + labels.shape[0], j:j + labels.shape[1]]
                           for i in range(3) for j in range(3)], axis=-1)
        votes = (around[..., None] == np.arange(count + 1)).sum(axis=2).reshape(-1, count + 1)
        updated = (cost - np.float32(relabelling.AGREEMENT) * votes.astype(np.float32)).argmin(1)
        changed, labels = (updated != labels.ravel()).sum(), updated.reshape(labels.shape)
        if changed <= relabelling.SETTLED_SHARE * labels.size:
            break
    return np.where(labels == count, -1, labels)


@pytest.mark.parametrize('seed', range(8))
def test_only_cells_that_may_change_compete(seed):
    """Leaving out the others changes nothing, whatever labels the sweeps start from."""
    rng = np.random.default_rng(seed)
    model = cell_model(view([wall(2.0)]).depth_m)
    # The second strays from the wall by 2 to 6 deviations, whose squares votes may outweigh.
    deviation = np.sqrt(EXACT.floor(0.5))
    planes = np.array([[0, 0, 0.5], [4 * deviation, 0, 0.5 + 4 * deviation]])
    labels = rng.integers(-1, 2, (12, 16)).astype(np.int32).repeat(5, axis=0).repeat(5, axis=1)
    labels = labels[:model.grid.shape[0], :model.grid.shape[1]]
    labels[rng.random(labels.shape) < 0.02 * seed] = seed % 3 - 1
    patches = Patches(labels, planes)
    expected = competed(relabelling._costs(model, patches, 3.0), labels)
    assert (expected != labels).any()
    np.testing.assert_array_equal(relabelling._compete(model, patches, 3.0), expected)
