# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth of rendered scenes is correct; simulated sensors err as they should."""

import pickle

import cv2
import numpy as np
import pytest

from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.scenes.living_rooms import living_room
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.rooms import (
    attic,
    hexagon_room,
    random_room,
    single_wall,
    staircase,
)
from plane_detector.evaluation.scenes.sensors import KINECT_BASELINE_M, SENSORS
from plane_detector.evaluation.scenes.shapes import shape_scene
from plane_detector.evaluation.scenes.surfaces import block, ellipsoid, joined
from plane_detector.evaluation.scenes.walks import walk
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
MEDIUM = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
SCENES = {
    'living room': lambda: living_room(np.random.default_rng(0), MEDIUM),
    'another living room': lambda: living_room(np.random.default_rng(1), MEDIUM),
    'room': lambda: random_room(np.random.default_rng(3), SMALL),
    'attic': lambda: attic(np.random.default_rng(3), SMALL),
    'hexagon': lambda: hexagon_room(np.random.default_rng(3), SMALL),
    'stairs': lambda: staircase(SMALL),
    'wall': lambda: single_wall(SMALL)}


@pytest.mark.parametrize('name', SCENES)
def test_points_lie_on_the_planes_of_their_labels(name):
    scene, again = SCENES[name](), SCENES[name]()
    np.testing.assert_array_equal(scene.rgb, again.rgb)
    np.testing.assert_array_equal(scene.depth_m, again.depth_m)
    points_m = depth_to_points(scene.depth_m, scene.intrinsics)
    labelled, seen = scene.labels >= 0, np.isfinite(scene.depth_m)
    assert labelled.sum() > 0.3 * labelled.size
    assert seen[labelled].all() if 'living' in name else (seen == labelled).all()
    planes = scene.planes[scene.labels[labelled]]
    distance_m = (points_m[labelled] * planes[:, :3]).sum(1) + planes[:, 3]
    assert (np.abs(distance_m) < 1e-5 * points_m[labelled][:, 2]).all()
    np.testing.assert_allclose(np.linalg.norm(scene.planes[:, :3], axis=1), 1)
    assert (scene.planes[:, 3] >= 0).all(), 'they look at the camera'
    assert set(scene.labels[labelled]) == set(range(len(scene.planes))), 'all are visible'
    best = score(scene.labels, scene.planes, scene.labels, scene.planes, seen, min_pixels=100)
    assert best.segmentation_covering == best.recall == best.precision == 1


def test_a_turned_wall_keeps_its_distance():
    scene = single_wall(SMALL, yaw_deg=20, distance_m=3)
    assert scene.planes[0, 3] == pytest.approx(3)
    assert np.degrees(np.arccos(-scene.planes[0, 2])) == pytest.approx(20)


def seen(things, curved=()):
    """Return what a horizontal camera sees that looks along y, from 3 m before the origin."""
    return render(things, camera_rotation(0, 0, 0), np.array([0, -3.0, 0]), SMALL,
                  np.random.default_rng(0), curved)


def test_the_nearest_surface_hides_the_others():
    scene = seen([rectangle([-9, 1, -9], [18, 0, 0], [0, 0, 18]),
                  rectangle([-0.2, -2, -0.2], [0.4, 0, 0], [0, 0, 0.4])])
    assert scene.depth_m[60, 80] == pytest.approx(1)
    assert scene.depth_m[5, 5] == pytest.approx(4)
    assert (scene.labels == 1).sum() == pytest.approx((0.4 * 131)**2, rel=0.05)


def test_a_ball_has_its_depth_and_no_label():
    scene = seen([], ellipsoid(0.5, 0.5).curved)
    hit = np.isfinite(scene.depth_m)
    assert (scene.labels == -1).all() and scene.planes.shape == (0, 4)
    points_m = depth_to_points(scene.depth_m, SMALL)[hit] - [0, 0, 3]
    np.testing.assert_allclose(np.linalg.norm(points_m, axis=1), 0.5, atol=1e-4)
    # Its outline is a cone of sin = 1/6.
    assert hit.sum() == pytest.approx(np.pi * (131 / np.sqrt(35))**2, rel=0.02)


def test_curved_things_hide_planes_and_are_hidden():
    things = joined(block([-2, 2, -2], [2, 3, 2]), block([-2, -1, 0.1], [2, -0.9, 2]),
                    ellipsoid(0.4, 0.4))
    scene = seen(things.flat, things.curved)
    assert scene.labels[60, 80] == -1
    assert scene.depth_m[60, 80] == pytest.approx(2.6, abs=0.01)
    assert scene.depth_m[40, 80] == pytest.approx(2.0)
    assert scene.depth_m[100, 60] == pytest.approx(5.0)
    assert len(scene.planes) == 3, 'two fronts and the lower side of the near one'


def test_scenes_of_shapes_hold_visible_shapes_with_their_geometry():
    found = shape_scene(np.random.default_rng(0))
    points_m = depth_to_points(found.scene.depth_m, found.scene.intrinsics)
    assert 1 <= len(found.shapes) <= 5
    for shape in found.shapes:
        assert (found.scene.labels[shape.mask] == -1).all()
        offset = points_m[shape.mask] - shape.position_m
        along = offset @ shape.axis
        away = np.linalg.norm(offset - along[:, None] * shape.axis, axis=1)
        expected = shape.radius_m or along * np.tan(shape.half_angle_rad)
        np.testing.assert_allclose(away, expected, atol=2e-4)


@pytest.mark.parametrize('smooth_share', [0.0, 0.5, 1.0])
def test_noise_has_its_standard_deviation_in_disparity(smooth_share):
    depth_m = single_wall(VGA).depth_m
    noisy_m = with_disparity_noise(depth_m, 0.01, np.random.default_rng(0), smooth_share)
    assert (1 / noisy_m - 1 / depth_m).std() == pytest.approx(0.01, rel=0.05)
    far_m = with_disparity_noise(100 * depth_m, 0.02, np.random.default_rng(0), smooth_share)
    assert 0.1 < np.isnan(far_m).mean() < 0.9, 'beyond infinity it is invalid'
    assert (far_m[np.isfinite(far_m)] > 0).all()


@pytest.mark.parametrize('name', SENSORS)
def test_measured_depth_is_near_the_truth_and_the_same_for_a_seed(name, room):
    depth_m = room(1400).depth_m
    first, again = (SENSORS[name](depth_m, VGA, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert first.dtype == np.float32
    assert np.isfinite(first).mean() > 0.9
    assert np.nanmedian(np.abs(1 / first - 1 / depth_m)) < 0.003
    assert np.isnan(SENSORS[name](np.full((48, 64), np.nan, np.float32), VGA,
                                  np.random.default_rng(5))).all()


def test_structured_light_errs_like_a_kinect():
    wall = single_wall(yaw_deg=20, distance_m=2.5)
    measured_m = SENSORS['structured light'](wall.depth_m, VGA, np.random.default_rng(0))
    eighths = 8 * VGA.fx * KINECT_BASELINE_M / measured_m[np.isfinite(measured_m)]
    np.testing.assert_allclose(eighths, np.rint(eighths), atol=1e-3)
    # Bands of the error in 1/km; a real wall of this size has 0.8 0.8 0.8 1.4.
    left, bands = 1e3 / measured_m - 1e3 / wall.depth_m, []
    for blur_px in (2.0, 8.0, 24.0):
        blurred = cv2.GaussianBlur(left, (0, 0), blur_px)
        bands.append((left - blurred).std())
        left = blurred
    np.testing.assert_array_less([*bands, left.std()], [1.6, 1.2, 1.2, 3.5])
    np.testing.assert_array_less([0.7, 0.5, 0.5, 1.0], [*bands, left.std()])


def test_a_room_with_a_hole_in_a_wall_can_be_pickled():
    walked = walk('doorway', np.random.default_rng(0), 2)
    again = pickle.loads(pickle.dumps(walked))
    shares = np.linspace(0, 1, 50)
    for face, other in zip(walked.surfaces, again.surfaces, strict=True):
        assert (face.corner == other.corner).all()
        if face.mask is not None:
            assert (face.mask(shares, shares) == other.mask(shares, shares)).all()
