# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The labels grown from exact depth are those of the flat surfaces only."""

import numpy as np
import pytest

from plane_detector import CameraIntrinsics
from plane_detector.evaluation.datasets import frames
from plane_detector.evaluation.metrics import overlap
from plane_detector.evaluation.reference_labels import TOLERANCE_M, label_exact_planes
from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.evaluation.scenes.surfaces import Revolution
from plane_detector.geometry.projection import depth_to_points, pixel_rays

CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)


def rounded(depth_m):
    """Return depth in whole millimetres, as 16-bit images have it."""
    return (np.round(1000 * depth_m) / 1000).astype(np.float32)


def flat(depth_m):
    return np.full((CAMERA.height, CAMERA.width), depth_m, np.float32)


@pytest.mark.parametrize('seed', range(3))
def test_the_planes_of_a_room_are_labelled(seed):
    scene = random_room(np.random.default_rng(seed), CAMERA)
    found = label_exact_planes(rounded(scene.depth_m), CAMERA)
    shared = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m))
    large = np.flatnonzero(shared.counts[:-1].sum(1) > 1000)
    best = shared.iou[large].argmax(1)
    assert len(large) >= 4
    assert shared.iou[large, best].min() > 0.98
    assert (shared.counts[:-1, :-1].max(0) > 0.98 * shared.counts[:, :-1].sum(0)).all()
    np.testing.assert_allclose(found.planes[best], scene.planes[large], atol=1e-3)
    assert not found.unclear.any()


def test_labels_are_of_the_largest_first_and_planes_look_at_the_camera():
    scene = random_room(np.random.default_rng(1), CAMERA)
    found = label_exact_planes(rounded(scene.depth_m), CAMERA)
    assert found.labels.dtype == np.int32
    pixels = np.bincount(found.labels[found.labels >= 0], minlength=len(found.planes))
    assert len(pixels) == len(found.planes)
    assert (np.diff(pixels) <= 0).all()
    np.testing.assert_allclose(np.linalg.norm(found.planes[:, :3], axis=1), 1)
    assert (found.planes[:, 3] >= 0).all()
    assert not (found.unclear & (found.labels >= 0)).any()


def test_any_camera_model_works():
    camera = CameraIntrinsics(180.0, 240.0, 60.0, 130.0, 200, 160)
    wall = single_wall(camera, yaw_deg=30, distance_m=2.0)
    found = label_exact_planes(rounded(wall.depth_m), camera)
    np.testing.assert_allclose(found.planes, wall.planes, atol=3e-4)
    assert (found.labels == 0).mean() > 0.99


@pytest.mark.parametrize(('squared_radius', 'axis'), [
    ((0.04, 0, -1), (0, 1, 0)), ((0.25, 0, -1), (0, 1, 0)),
    ((0.01, 0, 0), (0, 1, 0)), ((0.25, 0, 0), (0.6, 0.8, 0)), ((4, 0, 0), (0, 1, 0))],
    ids=['ball', 'large ball', 'pipe', 'tilted column', 'apse'])
def test_curved_surfaces_are_not_planes(squared_radius, axis):
    ray_x, ray_y = (ray.astype(float) for ray in pixel_rays(CAMERA))
    far_m = 1.2 + np.sqrt(squared_radius[0])
    surface = Revolution(np.array([0, 0, far_m]), np.array(axis, float), squared_radius, -5, 5)
    depth_m = surface.depth(ray_x, ray_y[:, None], np.eye(3), np.zeros(3))
    depth_m[depth_m > far_m] = np.inf
    assert np.isfinite(depth_m).mean() > 0.05
    assert not len(label_exact_planes(rounded(depth_m), CAMERA).planes)


@pytest.mark.parametrize(('bulge_m', 'planes', 'unclear'), [
    (0.002, 1, 0), (0.005, 0, 1), (0.1, 0, 0)])
def test_a_slight_bulge_is_unclear(bulge_m, planes, unclear):
    """A sheet is flat within 3 mm in all; 5 mm are 1.3 times as wide. At its ends so is any."""
    across = np.linspace(-1, 1, 200)
    depth_m = flat(np.nan)
    depth_m[40:200, 60:260] = 1.5 + bulge_m * across**2
    found = label_exact_planes(rounded(depth_m), CAMERA)
    assert len(found.planes) == planes
    assert found.unclear[40:200, 130:190].mean() == pytest.approx(unclear, abs=0.02)


@pytest.mark.parametrize(('step_m', 'planes'), [(0, 2), (0.05, 3)])
def test_coplanar_pieces_on_both_sides_of_something_are_one_plane(step_m, planes):
    wall = single_wall(CAMERA, yaw_deg=25, distance_m=2.5)
    depth_m = wall.depth_m.copy()
    depth_m[:, 200:] += step_m
    depth_m[:, 150:200] = 1.2
    found = label_exact_planes(rounded(depth_m), CAMERA)
    assert len(found.planes) == planes
    assert (found.labels[120, 50] == found.labels[120, 300]) == (step_m == 0)
    assert found.labels[120, 175] not in (-1, found.labels[120, 50], found.labels[120, 300])


def test_a_narrow_face_is_judged_after_its_larger_neighbour():
    """The strip at 2 m starts, being flattest; within 6 mm it is a quarter wider, by the slope."""
    depth_m = flat(np.nan)
    depth_m[:, 20:40] = 2.0
    depth_m[:, 40:300] = 1 / (1 / 2.004 - 0.0001 * np.arange(260))
    labels = label_exact_planes(rounded(depth_m), CAMERA).labels
    assert (labels[:, 22:38] == 1).all()
    assert (labels[:, 42:298] == 0).all()


@pytest.mark.parametrize('invalid', [np.nan, 0.0, np.inf, -1.0])
def test_invalid_pixels_have_no_label(invalid):
    depth_m = flat(1.0)
    depth_m[60:120, 80:200] = invalid
    before = depth_m.copy()
    found = label_exact_planes(depth_m, CAMERA)
    expected = np.zeros(depth_m.shape, int)
    expected[60:120, 80:200] = -1
    np.testing.assert_array_equal(found.labels, expected)
    assert not found.unclear.any()
    np.testing.assert_array_equal(depth_m, before)


def test_without_valid_depth_there_is_no_plane():
    found = label_exact_planes(flat(np.nan), CAMERA)
    assert found.planes.shape == (0, 4)
    assert (found.labels == -1).all()


def test_pieces_that_are_too_small_are_not_labelled():
    depth_m = flat(np.nan)
    depth_m[100:116, 100:120] = 2.0
    assert len(label_exact_planes(depth_m, CAMERA, min_pixels=320).planes) == 1
    assert len(label_exact_planes(depth_m, CAMERA, min_pixels=321).planes) == 0


def test_depth_of_another_size_is_refused():
    with pytest.raises(ValueError, match='320 x 240'):
        label_exact_planes(np.ones((10, 10)), CAMERA)


def test_floor_and_wall_of_rendered_frames_are_found(data_folder):
    """Between them the camera moves: the wall and the floor stay square to each other."""
    rendered = list(frames(data_folder, ('living_room',)))
    for frame in (rendered[0], rendered[-1]):
        found = label_exact_planes(frame.depth_m, frame.intrinsics)
        assert 8 <= len(found.planes) <= 16
        assert abs(found.planes[0, :3] @ found.planes[1, :3]) < 0.005
        assert 0.7 < (found.labels >= 0).mean() < 0.85, 'curtain and chair are curved'
        assert 0.02 < found.unclear.mean() < 0.1
        assert not (found.unclear & (found.labels >= 0)).any()
        on_plane = found.labels >= 0
        points_m = depth_to_points(frame.depth_m, frame.intrinsics)[on_plane]
        planes = found.planes[found.labels[on_plane]]
        distance_m = np.abs((points_m * planes[:, :3]).sum(1) + planes[:, 3])
        assert np.quantile(distance_m, 0.99) < TOLERANCE_M
