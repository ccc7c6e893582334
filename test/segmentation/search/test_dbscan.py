# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clusters in the grid against scikit-learn's DBSCAN."""

import numpy as np
import pytest
from sklearn.cluster import DBSCAN

from plane_detector.config import DbscanConfig
from plane_detector.segmentation.search.dbscan import label_clusters


def grid_clusters(mask, eps, min_samples):
    """Return the clusters of the set cells."""
    labels = np.where(mask, 0, -1).astype(np.int32)
    return label_clusters(labels, DbscanConfig(eps, min_samples))[0]


def same_partition(first, second):
    """Return whether two labellings differ only in the numbers of the clusters."""
    pairs = set(zip(first.tolist(), second.tolist(), strict=True))
    return len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})


@pytest.mark.parametrize('eps', [1.0, 1.5, 2.0, 2.5])
@pytest.mark.parametrize('min_samples', [1, 3, 4, 5, 8])
@pytest.mark.parametrize('density', [0.2, 0.5, 0.8])
def test_equals_scikit_learn(eps, min_samples, density):
    mask = np.random.default_rng(int(100 * density)).random((23, 31)) < density
    points = np.argwhere(mask)
    expected = DBSCAN(eps=eps, min_samples=min_samples).fit(points)
    clusters = grid_clusters(mask, eps, min_samples)
    found, core = clusters[mask], expected.core_sample_indices_
    assert (clusters[~mask] == -1).all()
    assert same_partition(found[core], expected.labels_[core])
    np.testing.assert_array_equal(found == -1, expected.labels_ == -1)
    for index in np.setdiff1d(np.flatnonzero(found >= 0), core):
        near = np.linalg.norm(points[core] - points[index], axis=1) <= eps
        assert found[index] in found[core[near]], 'a border cell joins a cluster that it touches'


def test_two_squares_by_hand():
    mask = np.zeros((6, 9), bool)
    mask[1:4, 1:4] = mask[1:4, 5:8] = True
    clusters = grid_clusters(mask, 1.5, 3)
    assert set(clusters[1:4, 1:4].ravel()) != set(clusters[1:4, 5:8].ravel())
    assert sorted(np.unique(clusters)) == [-1, 0, 1]
    joined = grid_clusters(mask, 2.0, 3)
    assert sorted(np.unique(joined)) == [-1, 0]


def test_the_radius_includes_its_end():
    mask = np.eye(4, dtype=bool)
    assert (grid_clusters(mask, np.sqrt(2), 2)[mask] == 0).all()
    assert (grid_clusters(mask, 1.4, 2)[mask] == -1).all()


def test_a_lonely_cell_is_noise_unless_one_sample_is_enough():
    mask = np.zeros((3, 3), bool)
    mask[1, 1] = True
    assert grid_clusters(mask, 1.5, 2)[1, 1] == -1
    assert grid_clusters(mask, 1.5, 1)[1, 1] == 0


@pytest.mark.parametrize('eps', [1.5, 2.5])
def test_nothing_set_is_nothing_found(eps):
    assert (grid_clusters(np.zeros((4, 5), bool), eps, 3) == -1).all()


def test_more_clusters_than_a_byte_counts():
    mask = np.zeros((60, 60), bool)
    mask[::3, ::3] = True
    clusters = grid_clusters(mask, 1.0, 1)
    assert np.unique(clusters[mask]).size == mask.sum() == 400


def test_input_is_not_modified():
    mask = np.random.default_rng(0).random((9, 9)) < 0.5
    before = mask.copy()
    grid_clusters(mask, 1.5, 3)
    np.testing.assert_array_equal(mask, before)
