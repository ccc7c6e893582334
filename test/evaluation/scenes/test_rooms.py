# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth of rendered scenes is correct."""

import numpy as np
import pytest

from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import (
    VGA,
    Rectangle,
    attic,
    camera_rotation,
    hexagon_room,
    random_room,
    render,
    single_wall,
    staircase,
)
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
SCENES = {
    'room': lambda: random_room(np.random.default_rng(3), SMALL),
    'attic': lambda: attic(np.random.default_rng(3), SMALL),
    'hexagon': lambda: hexagon_room(np.random.default_rng(3), SMALL),
    'stairs': lambda: staircase(SMALL),
    'wall': lambda: single_wall(SMALL)}


@pytest.mark.parametrize('name', SCENES)
def test_points_lie_on_the_planes_of_their_labels(name):
    scene = SCENES[name]()
    points_m = depth_to_points(scene.depth_m, scene.intrinsics)
    labelled = scene.labels >= 0
    assert labelled.sum() > 0.3 * labelled.size
    np.testing.assert_array_equal(labelled, np.isfinite(scene.depth_m))
    planes = scene.planes[scene.labels[labelled]]
    distance_m = (points_m[labelled] * planes[:, :3]).sum(1) + planes[:, 3]
    assert np.abs(distance_m).max() < 1e-4


@pytest.mark.parametrize('name', SCENES)
def test_planes_are_unit_look_at_the_camera_and_are_all_visible(name):
    scene = SCENES[name]()
    np.testing.assert_allclose(np.linalg.norm(scene.planes[:, :3], axis=1), 1)
    assert (scene.planes[:, 3] >= 0).all()
    np.testing.assert_array_equal(np.unique(scene.labels[scene.labels >= 0]),
                                  np.arange(len(scene.planes)))
    assert scene.rgb.shape == (*scene.labels.shape, 3)
    assert scene.rgb.dtype == np.uint8


def test_a_turned_wall_keeps_its_distance():
    scene = single_wall(SMALL, yaw_deg=20, distance_m=3)
    normal = scene.planes[0, :3]
    assert scene.planes[0, 3] == pytest.approx(3)
    assert np.degrees(np.arccos(-normal[2])) == pytest.approx(20)


def test_the_nearest_surface_hides_the_others():
    near = Rectangle(np.array([-0.2, 1.0, -0.2]), np.array([0.4, 0, 0]), np.array([0, 0, 0.4]))
    far = Rectangle(np.array([-9.0, 4.0, -9.0]), np.array([18.0, 0, 0]), np.array([0, 0, 18.0]))
    scene = render([far, near], camera_rotation(0, 0, 0), np.zeros(3), SMALL,
                   np.random.default_rng(0))
    assert scene.depth_m[60, 80] == pytest.approx(1)
    assert scene.depth_m[5, 5] == pytest.approx(4)
    assert (scene.labels == 1).sum() == pytest.approx((0.4 * 131)**2, rel=0.05)


def test_rooms_repeat_with_the_seed_and_differ_without():
    first, again, other = (random_room(np.random.default_rng(s), SMALL) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.depth_m, again.depth_m)
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert not np.array_equal(first.depth_m, other.depth_m)


@pytest.mark.parametrize('smooth_share', [0.0, 0.5, 1.0])
def test_noise_has_its_standard_deviation_in_disparity(smooth_share):
    depth_m = single_wall(VGA).depth_m
    noisy_m = with_disparity_noise(depth_m, 0.01, np.random.default_rng(0), smooth_share)
    assert (1 / noisy_m - 1 / depth_m).std() == pytest.approx(0.01, rel=0.05)


def test_noise_beyond_infinity_gives_invalid_depth():
    far_m = np.full((50, 50), 100.0, np.float32)
    noisy_m = with_disparity_noise(far_m, 0.02, np.random.default_rng(0))
    assert 0.1 < np.isnan(noisy_m).mean() < 0.9
    assert (noisy_m[np.isfinite(noisy_m)] > 0).all()
