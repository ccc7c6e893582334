# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The baseline: the paper's method with the real pyRANSAC-3D."""

import random
import sys

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector, segment_planes
from plane_detector.config import PaperConfig, SegmentationConfig
from plane_detector.depth.depth_function import DepthFunction
from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import (
    Rectangle,
    camera_rotation,
    render,
    single_wall,
)
from plane_detector.evaluation.scenes.rooms import box as upright_box
from plane_detector.geometry.disparity import to_disparity, zero_filled
from plane_detector.planes.measurement import measure_planes
from plane_detector.segmentation import baselines
from plane_detector.segmentation.baselines import fit_labels, paper_labels, ransac_alone
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.stopping import Background, Stopped

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
PAPER = Config(segmentation=SegmentationConfig(method='paper'))


@pytest.fixture(autouse=True)
def _pyransac3d():
    pytest.importorskip('pyransac3d', reason='pyransac3d, the extra "paper", is not installed')


def corner():
    """Return a floor and a wall with a box before it."""
    floor = Rectangle(np.array([-4.0, 0.5, 0]), np.array([8.0, 0, 0]), np.array([0, 3.5, 0]))
    wall = Rectangle(np.array([-4.0, 4.0, 0]), np.array([8.0, 0, 0]), np.array([0, 0, 4.0]))
    faces = [floor, wall, *upright_box(np.array([0, 2.5, 0.4]), np.array([1.0, 0.6, 0.8]))]
    return render(faces, camera_rotation(0, -15, 0), np.array([0, 0, 1.5]), SMALL,
                  np.random.default_rng(0))


def test_large_planes_are_found_behind_the_same_interface():
    scene = corner()
    found = segment_planes(scene.depth_m, SMALL, PAPER)
    result = score(scene.labels, scene.planes, found.labels, plane_array(found),
                   np.isfinite(scene.depth_m), min_pixels=1000)
    assert result.recall >= 0.66
    assert result.segmentation_covering > 0.7
    assert result.normal_error_deg < 2


def test_a_wall_is_one_plane_and_its_pixels_are_near_it():
    scene = single_wall(SMALL)
    scene.depth_m[40:45, 60:70] -= 0.2
    labels = paper_labels(scene.depth_m, SMALL, PAPER, np.random.default_rng(0))
    assert labels.max() == 0
    assert (labels == 0).mean() > 0.95
    assert (labels[40:45, 60:70] == -1).all(), 'off the plane by more than the threshold'


def test_one_metric_threshold_shatters_a_far_noisy_wall():
    """Why ours works in disparity: 5 cm are little at 8 m."""
    scene = single_wall(SMALL, yaw_deg=0, distance_m=8)
    noisy_m = with_disparity_noise(scene.depth_m, 0.004, np.random.default_rng(0))
    paper = segment_planes(noisy_m, SMALL, PAPER)
    ours = segment_planes(noisy_m, SMALL)
    assert (paper.labels == 0).mean() < 0.6
    assert (ours.labels == 0).mean() > 0.9


def test_clustering_parts_what_ransac_alone_joins():
    left, right = (upright_box(np.array([x, 3.0, 0]), np.array([1.0, 0.5, 1.0]))
                   for x in (-0.9, 0.9))
    scene = render(left + right, camera_rotation(0, 0, 0), np.zeros(3), SMALL,
                   np.random.default_rng(0))
    alone, clustered = (
        paper_labels(scene.depth_m, SMALL, PAPER, np.random.default_rng(0), cluster)
        for cluster in (False, True))
    middle = np.s_[60, [45, 115]]
    assert alone[middle][0] == alone[middle][1] >= 0
    assert clustered[middle].min() >= 0
    assert clustered[middle][0] != clustered[middle][1]


def test_the_same_seed_gives_the_same_planes_and_other_random_numbers_stay():
    scene = corner()
    random.seed(5)
    expected = random.random()
    random.seed(5)
    first = paper_labels(scene.depth_m, SMALL, PAPER, np.random.default_rng(1))
    assert random.random() == expected
    again = paper_labels(scene.depth_m, SMALL, PAPER, np.random.default_rng(1))
    np.testing.assert_array_equal(first, again)


def test_thinned_points_still_label_every_pixel():
    scene = single_wall(SMALL)
    config = Config(segmentation=SegmentationConfig(method='paper'),
                    paper=PaperConfig(max_points=2000, dbscan_eps=0.3))
    found = segment_planes(scene.depth_m, SMALL, config)
    assert (found.labels == 0).mean() > 0.95


@pytest.mark.parametrize('depth_m', [
    np.full((120, 160), np.nan, np.float32), np.zeros((120, 160), np.float32)])
def test_without_depth_there_is_no_plane(depth_m):
    found = segment_planes(depth_m, SMALL, PAPER)
    assert found.planes == ()
    assert (found.labels == -1).all()


def test_labels_of_the_truth_give_its_planes(room):
    scene = room(3)
    grid = build_cell_grid(DisparityImage(*zero_filled(to_disparity(scene.depth_m))))
    planes, labels = fit_labels(grid, scene.labels)
    regions = PixelRegions(to_disparity(scene.depth_m), labels, planes, grid, Noise(0.0005))
    measured, order = measure_planes(regions, scene.intrinsics, 1500)
    assert len(measured) >= 5
    for k, plane in enumerate(measured):
        true = scene.planes[np.bincount(scene.labels[order == k]).argmax()]
        np.testing.assert_allclose([*plane.normal, plane.offset_m], true, atol=2e-3)


def test_a_plane_without_clustering_takes_its_inliers_wherever_they_are():
    left, right = (upright_box(np.array([x, 3.0, 0]), np.array([1.0, 0.5, 1.0]))
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


def test_the_search_iteration_by_iteration_is_that_of_a_single_call():
    import pyransac3d
    points_m = np.random.default_rng(0).random((60, 3))
    random.seed(1)
    paper = PaperConfig(max_iterations=50)
    equation, inliers = baselines._fit(pyransac3d.Plane, points_m, paper)
    random.seed(1)
    expected = pyransac3d.Plane().fit(points_m, paper.distance_threshold, maxIteration=50)
    np.testing.assert_array_equal(equation, expected[0])
    np.testing.assert_array_equal(inliers, expected[1])


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
