# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth of rendered living rooms is correct, and their furniture as stated."""

from functools import cache

import numpy as np
import pytest

from plane_detector.evaluation.scenes import rendering
from plane_detector.evaluation.scenes.living_rooms import furnished_living_room, living_room
from plane_detector.evaluation.scenes.rendering import Rectangle, camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import (
    Thing,
    block,
    cone,
    ellipsoid,
    joined,
    outside,
    panel,
)
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
MEDIUM = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
SEEDS = range(6)


@cache
def room(seed):
    return living_room(np.random.default_rng(seed), MEDIUM)


@cache
def furnished(seed):
    return furnished_living_room(np.random.default_rng(seed))


def seen(thing, position=(0, -3, 0), intrinsics=SMALL, yaw_deg=0.0):
    """Return the image of a thing seen by a horizontal camera that looks along y."""
    return render(thing.flat, camera_rotation(yaw_deg, 0, 0), np.array(position, float),
                  intrinsics, np.random.default_rng(0), thing.curved_pieces())


def world_points(scene, position=(0, -3, 0)):
    """Return the points of the valid pixels in the world, for the camera of `seen`."""
    points_m = depth_to_points(scene.depth_m, SMALL)[np.isfinite(scene.depth_m)]
    return points_m @ camera_rotation(0, 0, 0).T + np.array(position)


@pytest.mark.parametrize('seed', SEEDS)
def test_points_lie_on_the_planes_of_their_labels(seed):
    scene = room(seed)
    points_m = depth_to_points(scene.depth_m, scene.intrinsics)
    labelled = scene.labels >= 0
    assert np.isfinite(scene.depth_m[labelled]).all()
    planes = scene.planes[scene.labels[labelled]]
    distance_m = (points_m[labelled] * planes[:, :3]).sum(1) + planes[:, 3]
    assert (np.abs(distance_m) < 1e-5 * points_m[labelled][:, 2]).all()


@pytest.mark.parametrize('seed', SEEDS)
def test_visible_faces_match_their_labels(seed):
    """The points of a label, in the world, lie within the rectangle that it stands for."""
    things, rotation, position = furnished(seed)
    flat = joined(*(thing for _, thing in things)).flat
    scene = living_room(np.random.default_rng(seed), SMALL)
    points_m = depth_to_points(scene.depth_m, SMALL) @ rotation.T + position
    for label, index in enumerate(scene.rectangles):
        face = flat[index]
        for edge in (face.edge_u, face.edge_v):
            along = (points_m[scene.labels == label] - face.corner) @ edge / (edge @ edge)
            assert along.min() > -0.01
            assert along.max() < 1.01


def test_a_room_is_lived_in():
    scenes = [room(seed) for seed in SEEDS]
    pixels = [np.bincount(scene.labels[scene.labels >= 0]) for scene in scenes]
    curved = [((scene.labels < 0) & np.isfinite(scene.depth_m)).mean() for scene in scenes]
    assert 15 <= np.median([(count > 75).sum() for count in pixels]) <= 45
    assert 10 <= np.median([(count > 375).sum() for count in pixels]) <= 20
    assert 0.05 < np.median(curved) < 0.2


@pytest.mark.parametrize('seed', SEEDS)
def test_furniture_stays_inside_the_room(seed):
    things, _, position = furnished(seed)
    bounds = {name: thing.bounds() for name, thing in things}
    size = bounds['ceiling'][1]
    for name, (low, high) in bounds.items():
        inside_m = 0.3 if name in ('window', 'on sill') else 0.02
        assert (low > -inside_m).all(), name
        assert (high < size + inside_m).all(), name
    assert (position > 0).all()
    assert (position < size).all()


def test_rooms_repeat_with_the_seed_and_differ_without():
    first, again, other = (living_room(np.random.default_rng(s), SMALL) for s in (1, 1, 2))
    for name in ('depth_m', 'labels', 'planes', 'rgb'):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.depth_m, other.depth_m)


def test_a_ball_has_its_depth_and_no_label():
    scene = seen(ellipsoid(0.5, 0.5))
    hit = np.isfinite(scene.depth_m)
    assert (scene.labels == -1).all()
    assert scene.planes.shape == (0, 4)
    assert np.nanmin(scene.depth_m) == pytest.approx(2.5, abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(world_points(scene), axis=1), 0.5, atol=1e-4)
    # Its outline is a cone of sin = 1/6.
    assert hit.sum() == pytest.approx(np.pi * (131 / np.sqrt(35))**2, rel=0.02)


@pytest.mark.parametrize(('thing', 'radius_of_height'), [
    (cone(0.4, 0.2, -0.3, 0.5), lambda z: 0.4 - 0.25 * (z + 0.3)),
    (cone(0.3, 0.3, -0.4, 0.4), lambda z: 0.3 + 0 * z),
    (ellipsoid(0.5, 0.2, 0.5), lambda z: np.sqrt(0.25 * (1 - z**2 / 0.04)))])
def test_points_lie_on_surfaces_of_revolution(thing, radius_of_height):
    x, y, z = world_points(seen(thing, (0, -2, 0.2)), (0, -2, 0.2)).T
    assert len(x) > 300
    low, high = thing.bounds()[:, 2]
    assert z.min() > low - 1e-4
    assert z.max() < high + 1e-4
    np.testing.assert_allclose(np.hypot(x, y), radius_of_height(z), atol=2e-3)


def test_a_hole_shows_what_is_behind():
    behind = block([-2, 1, -2], [2, 1.1, 2])
    frame = panel([-0.6, -0.1, -0.6], [0.6, 0, 0.6], outside((0.25, 0.25), (0.75, 0.75)))
    scene = seen((frame.turned((0, 0, 1), 180) + behind).at(0, 0))
    assert scene.depth_m[60, 80] == pytest.approx(4), 'through the hole, and no back is in it'
    assert scene.depth_m[60, 80 + round(131 * 0.45 / 3)] == pytest.approx(3)


def test_curved_things_hide_planes_and_are_hidden():
    far, near = block([-2, 2, -2], [2, 3, 2]), block([-2, -1, 0.1], [2, -0.9, 2])
    scene = seen(joined(far, near, ellipsoid(0.4, 0.4)))
    assert scene.labels[60, 80] == -1
    assert scene.depth_m[60, 80] == pytest.approx(2.6, abs=0.01)
    assert scene.depth_m[40, 80] == pytest.approx(2.0)
    assert scene.depth_m[100, 60] == pytest.approx(5.0)
    assert len(scene.planes) == 3, 'two fronts and the lower side of the near one'


def test_surfaces_behind_the_camera_are_not_visible():
    behind = block([-1, -5, -1], [1, -4, 1]) + ellipsoid(0.3, 0.3).at(0, -4)
    assert np.isnan(seen(behind).depth_m).all()
    around = Thing((Rectangle(np.array([-9.0, -9, -1]), np.array([18.0, 0, 0]),
                              np.array([0, 18.0, 0])),))
    assert np.isfinite(seen(around).depth_m[-1]).all(), 'it begins behind and goes on before'
    beside = Thing((Rectangle(np.array([0.2, -9, -0.1]), np.array([0, 18.0, 0]),
                              np.array([0, 0, 0.2])),))
    depth_m = seen(beside).depth_m
    near_m = 0.2 * 131 / 79.5
    assert depth_m[60, -1] == pytest.approx(near_m)
    assert np.isfinite(depth_m[:, -1]).sum() == pytest.approx(0.2 * 131 / near_m, abs=1)


@pytest.mark.parametrize('seed', SEEDS)
def test_the_window_of_a_surface_contains_all_its_hits(seed, monkeypatch):
    scene = living_room(np.random.default_rng(seed), SMALL)
    monkeypatch.setattr(rendering, '_window', lambda hull, intrinsics: (slice(None), slice(None)))
    everywhere = living_room(np.random.default_rng(seed), SMALL)
    np.testing.assert_array_equal(scene.depth_m, everywhere.depth_m)
    np.testing.assert_array_equal(scene.labels, everywhere.labels)
