# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Every published number of a plane, with cameras that are not a VGA camera with a central lens.

The truth is the renderer's, and formulas written here on their own.
"""

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig, ScaleConfig
from plane_detector.evaluation.metrics import angle_deg, overlap
from plane_detector.evaluation.scenes.rooms import random_room

CAMERAS = {
    'fx is not fy, off centre': CameraIntrinsics(380.0, 560.0, 250.0, 290.0, 640, 480),
    'wide, f 0.3 w': CameraIntrinsics(192.0, 200.0, 300.0, 250.0, 640, 480),
    'long, f 2 w': CameraIntrinsics(1280.0, 1240.0, 340.0, 220.0, 640, 480),
    'small, 96 x 72': CameraIntrinsics(80.0, 84.0, 45.0, 37.0, 96, 72),
    'upright, 360 x 480': CameraIntrinsics(400.0, 390.0, 170.0, 250.0, 360, 480)}
SEEDS = {name: (8200 + 2 * k, 8201 + 2 * k) for k, name in enumerate(CAMERAS)}


@pytest.fixture(scope='module', params=CAMERAS)
def case(request):
    """Return a camera, its rooms, their planes, and the pairs of true and found planes."""
    camera = CAMERAS[request.param]
    scenes = [random_room(np.random.default_rng(seed), camera) for seed in SEEDS[request.param]]
    return camera, scenes, [segment_planes(scene.depth_m, camera) for scene in scenes]


def pairs(case):
    """Yield scene, segmentation, and the index of a large true plane and of the one found."""
    _, scenes, results = case
    for scene, result in zip(scenes, results, strict=True):
        iou = overlap(scene.labels, result.labels, np.isfinite(scene.depth_m)).iou
        shares = np.bincount(scene.labels[scene.labels >= 0]) / scene.labels.size
        wide = [np.ptp(np.argwhere(scene.labels == i), axis=0).min() >= 8
                for i in range(len(shares))]  # else it is not found, as the README says
        for i in np.flatnonzero((shares > 0.03) & wide):
            assert iou[i].max(initial=0) > 0.5, 'a large plane is not found'
            yield scene, result, i, iou[i].argmax()


def points(camera, depth_m):
    v, u = np.indices(depth_m.shape)
    return np.stack([(u - camera.cx) / camera.fx * depth_m, (v - camera.cy) / camera.fy * depth_m,
                     depth_m], axis=-1).astype(np.float64)


def test_normals_and_offsets_are_those_of_the_room(case):
    found = list(pairs(case))
    assert len(found) >= 6
    for scene, result, i, k in found:
        plane, truth = result.planes[k], scene.planes[i]
        assert plane.offset_m >= 0, 'normals look at the camera'
        assert angle_deg(plane.normal, truth[:3]) < 0.5
        assert plane.offset_m == pytest.approx(truth[3], abs=0.01)


def test_centroid_count_rms_and_area_are_those_of_the_pixels(case):
    camera, _, _ = case
    for scene, result, _, k in pairs(case):
        plane, on_plane = result.planes[k], result.labels == k
        points_m = points(camera, scene.depth_m)[on_plane]
        assert plane.inlier_count == np.count_nonzero(on_plane)
        assert np.linalg.norm(plane.centroid_m - points_m.mean(axis=0)) < (
            0.02 * np.linalg.norm(points_m.mean(axis=0)))
        assert abs(plane.centroid_m @ plane.normal + plane.offset_m) < 1e-3
        residual_m = points_m @ plane.normal + plane.offset_m
        assert plane.rms_m == pytest.approx(np.sqrt((residual_m**2).mean()), abs=0.002)
        # A pixel covers z^2 / (fx fy) across the axis, and more by the slope of the plane.
        cosine = np.abs(points_m @ plane.normal) / points_m[:, 2]
        area_m2 = (points_m[:, 2]**2 / (camera.fx * camera.fy) / cosine).sum()
        assert plane.area_m2 == pytest.approx(area_m2, rel=0.1)


@pytest.mark.parametrize('name', CAMERAS)
def test_a_relative_network_becomes_metric_by_height_and_gravity(name):
    camera = CAMERAS[name]
    scene = random_room(np.random.default_rng(8210), camera)
    config = Config(depth=DepthConfig(output='relative_disparity'),
                    scale=ScaleConfig(method='camera_height', camera_height=scene.height_m,
                                      gravity=tuple(scene.gravity_camera)))
    detector = PlaneDetector(config, lambda rgb: (1.7 / scene.depth_m + 0.2).astype(np.float32))
    found = detector.detect(scene.rgb, camera)
    iou = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m)).iou
    heights_m = scene.planes[:, 3]
    floors = np.flatnonzero((scene.planes[:, :3] @ scene.gravity_camera < -0.999)
                            & (np.abs(heights_m - scene.height_m) < 1e-3))
    if not floors.size:
        pytest.skip('this camera sees no floor')
    assert found.scale.unit_method == 'camera_height', found.scale
    floor = found.planes[iou[floors].max(axis=0).argmax()]
    assert floor.offset_m == pytest.approx(scene.height_m, rel=0.02)
    error = np.abs(found.depth_m / scene.depth_m - 1)
    assert np.nanmedian(error) < 0.05
