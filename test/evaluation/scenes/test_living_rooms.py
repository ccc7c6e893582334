# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth of rendered living rooms is correct, and their furniture as stated."""

from functools import cache

import numpy as np
import pytest

from plane_detector.evaluation.scenes import furniture, rendering, wall_fittings
from plane_detector.evaluation.scenes.living_rooms import furnished_living_room, living_room
from plane_detector.evaluation.scenes.rendering import Rectangle, camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import (
    Revolution,
    Thing,
    bar,
    bezier,
    block,
    cone,
    disc,
    drum,
    ellipsoid,
    joined,
    outside,
    panel,
    sheet,
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
def test_planes_are_unit_look_at_the_camera_and_are_all_visible(seed):
    scene = living_room(np.random.default_rng(seed), SMALL)
    np.testing.assert_allclose(np.linalg.norm(scene.planes[:, :3], axis=1), 1)
    assert (scene.planes[:, 3] >= 0).all()
    np.testing.assert_array_equal(np.unique(scene.labels[scene.labels >= 0]),
                                  np.arange(len(scene.planes)))
    assert scene.rectangles.shape == (len(scene.planes),)
    assert 0.9 <= scene.height_m <= 1.8
    assert scene.gravity_camera[1] > 0.8


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


def test_rooms_contain_the_usual_furniture():
    names = {name for seed in range(20)
             for name, _ in furnished(seed)[0]}
    assert names >= {'floor', 'ceiling', 'wall', 'skirting', 'sofa', 'picture', 'lamp', 'bench',
                     'side table', 'television', 'bookshelf', 'plant', 'window', 'curtains',
                     'door', 'cupboard', 'rug', 'coffee table', 'on table', 'armchair', 'chair'}


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


def test_bounds_contain_the_visible_surface():
    lying = cone(0.1, 0.4, 0, 0.8).turned((0, 1, 0), 30).at(0.1, 0, -0.2, 20)
    points = world_points(seen(lying))
    low, high = lying.bounds()
    assert (points > low - 1e-4).all()
    assert (points < high + 1e-4).all()
    assert len(points) > 300


def test_a_bowl_shows_its_inside():
    scene = seen(ellipsoid(0.5, 0.5, 0.5), (0, -0.8, 0.45))
    points = world_points(scene, (0, -0.8, 0.45))
    assert (points[:, 2] < 1e-6).all()
    assert (points[:, 1] > 0.3).any(), 'the far side, over the near rim'


def test_the_lid_of_a_drum_is_a_disc():
    scene = seen(drum(0.5, 0, 0.4), (0, -2, 1.0))
    assert len(scene.planes) == 1, 'of its faces only the lid is flat and seen'
    points = world_points(scene, (0, -2, 1.0))
    lid = scene.labels[np.isfinite(scene.depth_m)] == 0
    assert (np.hypot(*points[lid, :2].T) <= 0.5 + 1e-4).all()
    np.testing.assert_allclose(points[lid, 2], 0.4, atol=1e-4)
    np.testing.assert_allclose(np.hypot(*points[~lid, :2].T), 0.5, atol=1e-3)


def test_a_hole_shows_what_is_behind():
    behind = block([-2, 1, -2], [2, 1.1, 2])
    frame = panel([-0.6, -0.1, -0.6], [0.6, 0, 0.6], outside((0.25, 0.25), (0.75, 0.75)))
    scene = seen((frame.turned((0, 0, 1), 180) + behind).at(0, 0))
    assert scene.depth_m[60, 80] == pytest.approx(4), 'through the hole, and no back is in it'
    assert scene.depth_m[60, 80 + round(131 * 0.45 / 3)] == pytest.approx(3)


def test_outside_is_a_rectangle_without_a_hole():
    mask = outside((0.2, -1), (0.8, 0.9))
    u, v = np.array([0.1, 0.5, 0.5, 0.9]), np.array([0.5, 0.5, 0.95, 0.1])
    np.testing.assert_array_equal(mask(u, v), [True, False, True, True])


def test_turning_and_shifting_keep_shapes():
    thing = (block([0, 0, 0], [1, 2, 3]) + bar([0, 0, 0], [0, 1, 0], 0.1)).at(1, 2, 3, 90)
    low, high = (Thing(thing.flat)).bounds()
    np.testing.assert_allclose([low, high], [[-1, 2, 3], [1, 3, 6]], atol=1e-12)
    (pipe,) = thing.curved
    assert isinstance(pipe, Revolution)
    np.testing.assert_allclose(pipe.axis, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pipe.origin, [1, 2, 3])


def test_a_sheet_follows_its_line():
    line = bezier([(0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 1, 0)], 10)
    np.testing.assert_allclose(line[[0, 5, 10]], [[0, 0, 0], [1, 0.5, 0], [2, 1, 0]])
    thing = sheet(line, np.array([0, 0, 2.0])).at(0, 0, 1)
    strips = thing.curved_pieces()
    assert len(strips) == 10
    np.testing.assert_allclose([strip.corner for strip in strips], line[:-1] + [0, 0, 1])
    np.testing.assert_allclose(thing.bounds(), [[0, 0, 1], [2, 1, 3]], atol=1e-12)


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


def test_television_and_door_frame_protrude_from_the_wall():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        assert 0.02 <= wall_fittings.television(rng).bounds()[1, 1] <= 0.05
        frame = Thing(wall_fittings.door(rng).flat).bounds()
        assert 0.02 <= frame[1, 1] <= 0.04


def test_cushions_lean_by_5_to_20_degrees():
    angles_deg = []
    for seed in range(10):
        for face in furniture.sofa(np.random.default_rng(seed)).flat:
            normal = np.cross(face.edge_u, face.edge_v)
            angle = np.degrees(np.arcsin(abs(normal[2]) / np.linalg.norm(normal)))
            if 4.5 < angle < 45:
                angles_deg.append(angle)
    assert len(angles_deg) > 20
    assert min(angles_deg) >= 5
    assert max(angles_deg) <= 20


def test_things_are_at_their_stated_positions():
    assert disc(0.2, 0.3).bounds()[:, 2] == pytest.approx([0.3, 0.3])
    np.testing.assert_allclose(ellipsoid(0.5, 0.2).bounds(), [[-0.5, -0.5, -0.2], [0.5, 0.5, 0.2]])
    for seed in range(10):
        for thing in (furniture.vase, furniture.on_table, furniture.plant, furniture.chair):
            low = thing(np.random.default_rng(seed)).bounds()[0]
            assert low[2] == pytest.approx(0, abs=1e-9), thing.__name__
