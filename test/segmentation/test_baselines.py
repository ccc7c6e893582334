# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The baseline: the paper's method with the real pyRANSAC-3D."""

import sys

import numpy as np
import pytest
from cell_helpers import scored
from sklearn.cluster import DBSCAN

from plane_detector import CameraIntrinsics, Config, PlaneDetector, segment_planes
from plane_detector._runtime.stopping import Background, Stopped
from plane_detector.config import PaperConfig, SegmentationConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.scenes.rendering import box, camera_rotation, rectangle, render
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.segmentation.baselines import paper_labels, point_clusters, ransac_alone

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
PAPER = Config(segmentation=SegmentationConfig(method='paper'))


@pytest.fixture(autouse=True)
def _pyransac3d():
    pytest.importorskip('pyransac3d', reason='pyransac3d, the extra "paper", is not installed')


def corner():
    """Return a floor and a wall with a box before it."""
    faces = [rectangle([-4, 0.5, 0], [8, 0, 0], [0, 3.5, 0]),
             rectangle([-4, 4, 0], [8, 0, 0], [0, 0, 4]),
             *box(np.array([0, 2.5, 0.4]), np.array([1.0, 0.6, 0.8]))]
    return render(faces, camera_rotation(0, -15, 0), np.array([0, 0, 1.5]), SMALL,
                  np.random.default_rng(0))


def test_large_planes_are_found_behind_the_same_interface():
    scene = corner()
    result = scored(scene, segment_planes(scene.depth_m, SMALL, PAPER), min_pixels=1000)
    assert result.recall >= 0.66
    assert result.segmentation_covering > 0.7
    assert result.normal_error_deg < 2


def test_a_wall_is_one_plane_and_its_pixels_are_near_it():
    depth_m = single_wall(SMALL).depth_m.copy()
    depth_m[40:45, 60:70] -= 0.2
    labels = paper_labels(depth_m, SMALL, PAPER, np.random.default_rng(0))
    assert labels.max() == 0
    assert (labels == 0).mean() > 0.95
    assert (labels[40:45, 60:70] == -1).all(), 'off the plane by more than the threshold'


@pytest.mark.parametrize('depth_m', [np.nan, 0.0])
def test_without_depth_there_is_no_plane(depth_m):
    found = segment_planes(np.full((120, 160), depth_m, np.float32), SMALL, PAPER)
    assert not len(found.planes) and (found.labels == -1).all()


def test_a_plane_without_clustering_takes_its_inliers_wherever_they_are():
    left, right = (box(np.array([x, 3.0, 0]), np.array([1.0, 0.5, 1.0]))
                   for x in (-0.9, 0.9))
    scene = render(left + right, camera_rotation(0, 0, 0), np.zeros(3), SMALL,
                   np.random.default_rng(0))
    alone = ransac_alone(scene.depth_m)[60, [45, 115]]
    ours = segment_planes(scene.depth_m, SMALL).labels[60, [45, 115]]
    assert alone[0] == alone[1] >= 0
    assert ours.min() >= 0 and ours[0] != ours[1]


def test_the_paper_needs_metres():
    relative = DepthFunction(lambda rgb: 1 / single_wall(SMALL).depth_m, 'relative_disparity')
    with pytest.raises(ValueError, match='paper needs depth in metres'):
        PlaneDetector(PAPER, relative).detect(np.zeros((120, 160, 3), np.uint8), SMALL)


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'pyransac3d', None)
    with pytest.raises(ModuleNotFoundError, match='pip install pyransac3d'):
        segment_planes(single_wall(SMALL).depth_m, SMALL, PAPER)


def test_the_search_can_be_stopped():
    """With the largest settings that there are: one search for a plane is some seconds then."""
    paper = PaperConfig(max_points=50000, max_iterations=10000, dbscan_eps=1.0)
    config = Config(segmentation=SegmentationConfig(method='paper', max_planes=255,
                                                    min_plane_share=0.0), paper=paper)
    scene = corner()
    call = Background(lambda: segment_planes(scene.depth_m, SMALL, config), 'search')
    assert not call.wait(0.2)
    call.stop.set()
    with pytest.raises(Stopped):
        call.result()


def test_the_radius_is_inclusive_and_the_point_itself_counts():
    points_m = np.array([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]])
    np.testing.assert_array_equal(point_clusters(points_m, 0.5, 3), [0, 0, 0])
    np.testing.assert_array_equal(point_clusters(points_m, 0.499, 2), [-1, -1, -1])
    np.testing.assert_array_equal(point_clusters(points_m, 0.499, 1), [0, 1, 2])
    np.testing.assert_array_equal(point_clusters(points_m[:1], 0.5, 2), [-1])
    assert point_clusters(points_m[:0], 0.5, 2).shape == (0,)


@pytest.mark.parametrize('seed', range(4))
def test_the_clusters_are_those_of_scikit_learn(seed):
    rng = np.random.default_rng(seed)
    points_m = rng.random((rng.integers(5, 150), 3)) * [1, 1, 0.1]
    eps_m, min_samples = rng.uniform(0.02, 0.3), int(rng.integers(1, 8))
    expected = DBSCAN(eps=eps_m, min_samples=min_samples).fit_predict(points_m)
    np.testing.assert_array_equal(point_clusters(points_m, eps_m, min_samples), expected)
