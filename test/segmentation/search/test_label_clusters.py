# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels clustered all at once, against scikit-learn."""

import numpy as np
import pytest
from sklearn.cluster import DBSCAN

from plane_detector.config import DbscanConfig
from plane_detector.segmentation.search.dbscan import label_clusters

SHAPE = (23, 31)


def random_labels(rng, share):
    """Return labels in blotches, so that clusters have insides, with cells without label."""
    coarse = rng.integers(0, 4, (8, 11)).repeat(3, axis=0).repeat(3, axis=1)
    labels = coarse[:SHAPE[0], :SHAPE[1]]
    return np.where(rng.random(SHAPE) < share, labels, -1).astype(np.int32)


def numbered(labels):
    """Return labels numbered by where they come first, so that equal partitions are equal."""
    kinds, first, index = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.where(kinds < 0, -1, first))
    rank = np.empty(len(kinds), int)
    rank[order] = np.arange(len(kinds))
    return rank[index].reshape(labels.shape)


@pytest.mark.parametrize('eps', [1.0, 1.5, 2.5])
@pytest.mark.parametrize('min_samples', [1, 3, 7])
@pytest.mark.parametrize('share', [0.5, 0.75, 1.0])
def test_every_label_is_clustered_as_scikit_learn_does(eps, min_samples, share):
    labels = random_labels(np.random.default_rng(int(100 * share)), share)
    clusters, count = label_clusters(labels, DbscanConfig(eps, min_samples))
    assert clusters.shape == labels.shape and count == clusters.max() + 1
    assert (clusters[labels < 0] == -1).all()
    used = []
    for label in range(4):
        points = np.argwhere(labels == label)
        found, expected = clusters[labels == label], DBSCAN(
            eps=eps, min_samples=min_samples).fit(points)
        core = expected.core_sample_indices_
        np.testing.assert_array_equal(found == -1, expected.labels_ == -1)
        np.testing.assert_array_equal(numbered(found[core]), numbered(expected.labels_[core]))
        for index in np.setdiff1d(np.flatnonzero(found >= 0), core):
            near = np.linalg.norm(points[core] - points[index], axis=1) <= eps
            assert found[index] in found[core[near]], 'a border cell joins one that it touches'
        used += np.unique(found[found >= 0]).tolist()
    assert sorted(used) == list(range(clusters.max() + 1)), 'numbered from 0, none of two labels'
