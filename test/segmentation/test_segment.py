# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes of rendered scenes against their truth."""

import numpy as np
import pytest
from cell_helpers import noisy, scored

from plane_detector import Config, segment_planes
from plane_detector.config import SegmentationConfig
from plane_detector.evaluation.metrics import overlap
from plane_detector.evaluation.scenes.rendering import (
    VGA,
)
from plane_detector.evaluation.scenes.rooms import random_room, single_wall, staircase
from plane_detector.types import CameraIntrinsics


def test_every_tread_and_riser_is_its_own_plane():
    scene = staircase()
    found = segment_planes(scene.depth_m, scene.intrinsics)
    shared = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m))
    rows = np.array([np.ptp(np.nonzero(scene.labels == k)[0]) + 1
                     for k in range(len(scene.planes))])
    large = np.flatnonzero((shared.counts[:-1].sum(1) > 1500) & (rows >= 7))
    assert len(large) == 13
    assert (shared.iou[large].max(axis=1) > 0.5).all()
    assert len(set(shared.iou[large].argmax(axis=1))) == len(large)


@pytest.mark.parametrize('sigma', [0.0, 0.001, 0.004, 0.01])
@pytest.mark.parametrize('yaw_deg', [0.0, 20.0, 50.0])
def test_a_single_wall_is_one_plane(sigma, yaw_deg):
    scene = single_wall(yaw_deg=yaw_deg)
    depth_m = noisy(scene, 1, sigma)
    found = segment_planes(depth_m, VGA)
    assert len(found.planes) == 1
    assert (found.labels[np.isfinite(depth_m)] == 0).mean() > 0.97
    result = scored(scene, found)
    assert result.normal_error_deg < (0.01 if sigma == 0 else 1.5)
    assert result.offset_error_m < (1e-3 if sigma == 0 else 0.05)


def test_no_plane_is_smaller_than_wanted(room):
    config = Config(segmentation=SegmentationConfig(min_plane_share=0.05))
    found = segment_planes(room(3).depth_m, VGA, config)
    assert min(plane.inlier_count for plane in found.planes) >= 0.05 * found.labels.size


CAMERAS = {'0.3 w': (192, 192, 319.5), '2 w': (1280, 1280, 319.5), '4 w': (2560, 2560, 319.5),
           'fx is not fy': (512, 768, 319.5), 'off centre': (1280, 800, 447.5)}


def two_walls(camera, angle_deg):
    """Return the depth of two walls that meet at an angle in the middle column, 2 m ahead."""
    ray = (np.arange(camera.width) - camera.cx) / camera.fx
    middle = ((camera.width - 1) / 2 - camera.cx) / camera.fx
    slope = np.sign(ray - middle) * np.tan(np.radians(angle_deg / 2))
    depth_m = 2.0 * (1 - slope * middle) / (1 - slope * ray)
    return np.tile(depth_m.astype(np.float32), (camera.height, 1))


@pytest.mark.parametrize('name', CAMERAS)
def test_walls_are_two_from_the_same_angle_on_for_every_lens(name):
    fx, fy, cx = CAMERAS[name]
    camera = CameraIntrinsics(fx, fy, cx, 239.5, 640, 480)
    assert len(segment_planes(two_walls(camera, 5.0), camera).planes) == 2
    assert len(segment_planes(two_walls(camera, 1.0), camera).planes) == 1


@pytest.mark.parametrize('width, height, least', [
    (64, 48, 0.8), (80, 60, 0.88), (96, 72, 0.9), (100, 76, 0.9)])
def test_rooms_in_small_images(width, height, least):
    """What is narrower than eight pixels is not found, which in small images is much."""
    camera = CameraIntrinsics.from_field_of_view(width, height, 60.0)
    for seed in range(6):
        scene = random_room(np.random.default_rng(seed), camera)
        found = segment_planes(scene.depth_m, camera)
        assert scored(scene, found).segmentation_covering > least
