# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered terrain through the whole pipeline: ground, obstacles, drops, classes."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, GroundConfig, ScaleConfig
from plane_detector.evaluation.scenes.terrain import (
    Course,
    Kind,
    View,
    clutter,
    hole,
    kerb,
    look,
    noisy,
    patch,
    quay,
    ramp,
    stairs,
)
from plane_detector.planes.classification import PlaneClass

MEASURED = Config(depth=DepthConfig(source='topic'))
FROM_ABOVE = View(1.0, 25.0, roll_deg=3.0)


def detect(terrain, depth_m=None, config=MEASURED, gravity_camera=None):
    scene = terrain.scene
    depth_m = noisy(terrain, 0.001, np.random.default_rng(1)) if depth_m is None else depth_m
    down = scene.gravity_camera if gravity_camera is None else gravity_camera
    return PlaneDetector(config).detect(scene.rgb, scene.intrinsics, depth_m, down)


def share(found, terrain, *kinds):
    """Return the share of the pixels of some kinds that is ground."""
    return found.ground[np.isin(terrain.kinds, kinds)].mean()


def class_of(found, terrain, kind):
    """Return the class of most pixels of a kind."""
    labels = found.labels[terrain.kinds == kind]
    return found.classes[np.bincount(labels[labels >= 0]).argmax()]


def off_edges_m(found, terrain):
    """Return how far each drop is from the nearest true edge."""
    drops = found.drops_m @ terrain.to_world.T + terrain.position_m
    edges_m = np.vstack([terrain.edges_m, np.full(3, np.inf)])
    return np.linalg.norm(drops[:, None] - edges_m, axis=2).min(axis=1)


def course(make, *args, start_m=2.0, view=FROM_ABOVE, seed=3):
    rng = np.random.default_rng(seed)
    return look(make(rng, start_m, *args), view, rng)


@pytest.mark.parametrize('sign', [1, -1])
def test_a_ramp_and_the_level_behind_it_are_ground(sign):
    terrain = course(ramp, sign)
    found = detect(terrain)
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert share(found, terrain, Kind.RAMP, Kind.LANDING) > 0.97
    assert class_of(found, terrain, Kind.FLOOR) == PlaneClass.FLOOR
    assert class_of(found, terrain, Kind.RAMP) == PlaneClass.RAMP
    assert off_edges_m(found, terrain).max(initial=0.0) < 0.1


def test_a_ramp_that_is_too_steep_is_no_ground():
    gentle = replace(MEASURED, ground=GroundConfig(max_slope=2.0))
    terrain = course(ramp, 1)
    assert share(detect(terrain, config=gentle), terrain, Kind.RAMP) < 0.2


def test_the_own_floor_at_the_head_of_stairs_is_the_highest():
    terrain = course(stairs, -1, start_m=1.5)
    found = detect(terrain)
    assert class_of(found, terrain, Kind.FLOOR) == PlaneClass.FLOOR
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert found.camera_height_m == pytest.approx(1.0, abs=0.01)
    assert found.tilt_deg == pytest.approx(25.0, abs=0.5)
    first = terrain.edges_m[terrain.edges_m[:, 2] == 0]
    points = found.drops_m @ terrain.to_world.T + terrain.position_m
    seen = abs(points[:, 2]) < 0.05
    assert np.ptp(points[seen, 0]) > 0.8 * np.ptp(first[:, 0]) or seen.sum() > 200
    rise = terrain.drops_m[0]
    assert np.median(found.drop_depths_m[seen]) == pytest.approx(rise, rel=0.2)


def test_stairs_up_are_steps_and_obstacles():
    terrain = course(stairs, 1)
    found = detect(terrain)
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert share(found, terrain, Kind.UPPER) < 0.02
    steps = [kind for kind in found.classes if kind == PlaneClass.STEP]
    assert len(steps) >= 2 and len(found.drops_m) == 0


@pytest.mark.parametrize('height_m, is_drop', [(0.05, False), (0.1, True), (0.2, True)])
def test_a_kerb_down_is_a_drop_above_min_drop(height_m, is_drop):
    terrain = course(kerb, -1, height_m)
    found = detect(terrain)
    assert (len(found.drops_m) > 200) == is_drop
    assert share(found, terrain, Kind.FLOOR) > 0.98
    if is_drop:
        assert off_edges_m(found, terrain).max() < 0.05
        assert np.median(found.drop_depths_m) == pytest.approx(height_m, abs=0.02)
    higher = replace(MEASURED, ground=GroundConfig(min_drop=0.5))
    assert len(detect(terrain, config=higher).drops_m) == 0


def test_a_kerb_up_is_an_obstacle_unless_the_robot_climbs_it():
    terrain = course(kerb, 1, 0.1)
    assert share(detect(terrain), terrain, Kind.UPPER) < 0.02
    climbs = replace(MEASURED, ground=GroundConfig(max_step=0.15, min_height=0.15))
    assert share(detect(terrain, config=climbs), terrain, Kind.UPPER) > 0.98


def test_boxes_are_obstacles_and_hide_what_is_behind():
    terrain = course(clutter, start_m=1.3)
    found = detect(terrain)
    assert share(found, terrain, Kind.FLOOR) > 0.98
    high = (terrain.kinds == Kind.OBSTACLE) & (terrain.above_m > 0.05)
    assert high.sum() > 5000 and found.ground[high].mean() < 0.02
    assert len(found.drops_m) == 0


def test_an_edge_behind_a_box_is_not_claimed():
    rng = np.random.default_rng(3)
    terrain = kerb(rng, 2.0, -1, 0.2)
    terrain.add_box(0.0, 1.9, np.array([1.0, 0.15, 0.5]))
    terrain = look(terrain, FROM_ABOVE, rng)
    found = detect(terrain)
    points = found.drops_m @ terrain.to_world.T + terrain.position_m
    assert len(points) > 100 and not (abs(points[:, 0]) < 0.4).any()


def test_a_hole_in_the_floor_is_a_drop():
    terrain = course(hole, start_m=1.5)
    found = detect(terrain)
    assert len(found.drops_m) > 20 and off_edges_m(found, terrain).max() < 0.05


def test_a_floor_that_returns_no_depth_is_no_drop_but_the_end_of_all_is():
    assert len(detect(course(patch, start_m=1.5)).drops_m) == 0
    terrain = course(quay, start_m=1.5)
    found = detect(terrain)
    assert len(found.drops_m) > 200 and off_edges_m(found, terrain).max() < 0.05
    assert np.isnan(found.drop_depths_m).all()


def test_a_known_height_tells_the_floor_from_a_table():
    rng = np.random.default_rng(2)
    room = Course(3.0)
    room.on(8.0, 0.0, Kind.FLOOR)
    room.add_box(0.0, 0.9, np.array([2.6, 1.0, 0.7]))
    terrain = look(room, View(1.2, 30.0), rng)
    config = replace(MEASURED, scale=ScaleConfig(camera_height=1.2))
    found = detect(terrain, config=config)
    assert share(found, terrain, Kind.FLOOR) > 0.95 and share(found, terrain, Kind.OBSTACLE) < 0.02


@pytest.mark.parametrize('off_deg', [1.5, 15.0])
def test_slopes_are_told_against_the_own_floor(off_deg):
    terrain = course(ramp, -1)
    lean = np.radians(off_deg)
    turn = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    config = replace(MEASURED, scale=ScaleConfig(gravity_tolerance=2.0 if off_deg < 2 else 20.0))
    found = detect(terrain, config=config, gravity_camera=turn @ terrain.scene.gravity_camera)
    assert class_of(found, terrain, Kind.FLOOR) == PlaneClass.FLOOR
    assert share(found, terrain, Kind.FLOOR, Kind.RAMP, Kind.LANDING) > 0.97


def test_without_a_unit_there_are_classes_but_no_drops():
    terrain = course(stairs, -1)
    scene = terrain.scene
    relative = replace(MEASURED, depth=DepthConfig(output='relative_disparity'))
    found = PlaneDetector(relative, lambda rgb: 7.0 / scene.depth_m + 1.0).detect(
        scene.rgb, scene.intrinsics, gravity_camera=scene.gravity_camera)
    assert found.scale_method == 'relative' and found.drop_note
    assert len(found.drops_m) == 0 and not found.ground.any()


def test_depth_that_is_too_wrong_tells_no_drop_and_why():
    terrain = course(kerb, -1, 0.2)
    coarse = noisy(terrain, 0.1, np.random.default_rng(1))
    found = detect(terrain, coarse)
    assert len(found.drops_m) == 0 and 'm off' in found.drop_note


def test_without_gravity_nothing_is_claimed():
    scene = course(kerb, 1).scene
    flat_picture = np.full_like(scene.rgb, 90)  # no lines
    found = PlaneDetector(MEASURED).detect(flat_picture, scene.intrinsics, scene.depth_m)
    assert not found.ground.any() and not any(found.classes)
    assert found.drop_note == 'the direction of gravity is not known'
