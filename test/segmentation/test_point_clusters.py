# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Density clusters of points: those of scikit-learn."""

import numpy as np
import pytest
from sklearn.cluster import DBSCAN

from plane_detector.segmentation.baselines import point_clusters
from plane_detector.stopping import Stop, Stopped


def test_two_heaps_and_a_stray_point():
    heap = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    points_m = np.vstack([heap + 5, heap, [[2, 2, 2]]])
    np.testing.assert_array_equal(point_clusters(points_m, 0.2, 3), [0, 0, 0, 1, 1, 1, -1])


def test_the_radius_is_inclusive_and_the_point_itself_counts():
    points_m = np.array([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]])
    np.testing.assert_array_equal(point_clusters(points_m, 0.5, 3), [0, 0, 0])
    np.testing.assert_array_equal(point_clusters(points_m, 0.499, 2), [-1, -1, -1])
    np.testing.assert_array_equal(point_clusters(points_m, 0.499, 1), [0, 1, 2])


@pytest.mark.parametrize('count', [0, 1])
def test_hardly_any_points(count):
    assert (point_clusters(np.zeros((count, 3)), 0.1, 2) == -1).all()


@pytest.mark.parametrize('seed', range(4))
def test_the_clusters_are_those_of_scikit_learn(seed):
    rng = np.random.default_rng(seed)
    points_m = rng.random((rng.integers(5, 150), 3)) * [1, 1, 0.1]
    eps_m, min_samples = rng.uniform(0.02, 0.3), int(rng.integers(1, 8))
    expected = DBSCAN(eps=eps_m, min_samples=min_samples).fit_predict(points_m)
    np.testing.assert_array_equal(point_clusters(points_m, eps_m, min_samples), expected)


def test_it_can_be_stopped():
    stop = Stop()
    stop.set()
    with pytest.raises(Stopped), stop.applies():
        point_clusters(np.zeros((10, 3)), 0.1, 2)
