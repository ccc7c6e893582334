# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth of rendered scenes is correct."""


import numpy as np
import pytest

from plane_detector.evaluation.scenes.living_rooms import living_room
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
from plane_detector.evaluation.scenes.surfaces import (
    block,
    ellipsoid,
    joined,
)
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
MEDIUM = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
CURVED = ('living room', 'another')
SCENES = {
    'living room': lambda: living_room(np.random.default_rng(0), MEDIUM),
    'another': lambda: living_room(np.random.default_rng(1), MEDIUM),
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
    seen = np.isfinite(scene.depth_m)
    assert seen[labelled].all() if name in CURVED else (seen == labelled).all()
    planes = scene.planes[scene.labels[labelled]]
    distance_m = (points_m[labelled] * planes[:, :3]).sum(1) + planes[:, 3]
    assert (np.abs(distance_m) < 1e-5 * points_m[labelled][:, 2]).all()


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


def seen(thing, position=(0, -3, 0), intrinsics=SMALL, yaw_deg=0.0):
    """Return the image of a thing seen by a horizontal camera that looks along y."""
    return render(thing.flat, camera_rotation(yaw_deg, 0, 0), np.array(position, float),
                  intrinsics, np.random.default_rng(0), thing.curved_pieces())


def world_points(scene, position=(0, -3, 0)):
    """Return the points of the valid pixels in the world, for the camera of `seen`."""
    points_m = depth_to_points(scene.depth_m, SMALL)[np.isfinite(scene.depth_m)]
    return points_m @ camera_rotation(0, 0, 0).T + np.array(position)


def test_a_ball_has_its_depth_and_no_label():
    scene = seen(ellipsoid(0.5, 0.5))
    hit = np.isfinite(scene.depth_m)
    assert (scene.labels == -1).all()
    assert scene.planes.shape == (0, 4)
    assert np.nanmin(scene.depth_m) == pytest.approx(2.5, abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(world_points(scene), axis=1), 0.5, atol=1e-4)
    # Its outline is a cone of sin = 1/6.
    assert hit.sum() == pytest.approx(np.pi * (131 / np.sqrt(35))**2, rel=0.02)


def test_curved_things_hide_planes_and_are_hidden():
    far, near = block([-2, 2, -2], [2, 3, 2]), block([-2, -1, 0.1], [2, -0.9, 2])
    scene = seen(joined(far, near, ellipsoid(0.4, 0.4)))
    assert scene.labels[60, 80] == -1
    assert scene.depth_m[60, 80] == pytest.approx(2.6, abs=0.01)
    assert scene.depth_m[40, 80] == pytest.approx(2.0)
    assert scene.depth_m[100, 60] == pytest.approx(5.0)
    assert len(scene.planes) == 3, 'two fronts and the lower side of the near one'
