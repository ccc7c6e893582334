# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Gravity and the classes of hand-made planes."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig
from plane_detector.evaluation.scenes.terrain import View, look, stairs
from plane_detector.geometry.gravity import unit_direction
from plane_detector.ground.ground import find_ground
from plane_detector.planes.classification import (
    LEVEL_SHARE,
    TOLERANCE_DEG,
    UPRIGHT_SHARE,
    PlaneClass,
    _probabilities,
    classify_planes,
    lowest_level,
    refine_gravity,
)
from plane_detector.types import NO_PLANES, Gravity, Plane, Planes

DOWN = np.array([0.0, 1.0, 0.0])


def plane(normal, offset_m, pixels=1000):
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    return Plane(normal, offset_m, -offset_m * normal, pixels, 0.0, 1.0, np.zeros((4, 4)), 1.0)


FLOOR, TABLE = plane([0, -1, 0], 1.5), plane([0, -1, 0.05], 0.8)
CEILING, LAMP = plane([0, 1, 0], 1.2), plane([0, 1, 0], 0.5)
WALL, SIDE = plane([0, 0, -1], 3.0), plane([1, 0, 0], 2.0)
ROOF = plane([1, 1, 0], 2.0)


def test_each_kind_of_plane():
    planes = Planes.of((WALL, FLOOR, TABLE, CEILING, LAMP, ROOF, SIDE))
    assert classify_planes(planes, DOWN).tolist() == [
        PlaneClass.WALL, PlaneClass.OTHER_HORIZONTAL, PlaneClass.OTHER_HORIZONTAL,
        PlaneClass.CEILING, PlaneClass.OTHER_HORIZONTAL, PlaneClass.OTHER, PlaneClass.WALL]
    assert lowest_level(planes, DOWN).offset_m == FLOOR.offset_m
    assert lowest_level(Planes.of((FLOOR, plane([1, -1, 0], 3.0))), DOWN).offset_m == 1.5


def test_the_tolerance_is_inclusive_and_no_more():
    leaning = plane([0, -np.cos(np.radians(7.9)), np.sin(np.radians(7.9))], 1.0)
    assert classify_planes(Planes.of([leaning]), DOWN) == [PlaneClass.OTHER_HORIZONTAL]
    leaning = plane([0, -np.cos(np.radians(8.1)), np.sin(np.radians(8.1))], 1.0)
    assert classify_planes(Planes.of([leaning]), DOWN) == [PlaneClass.OTHER]


@pytest.mark.parametrize(('sigma_deg', 'is_known'), [(0.0, True), (4.0, True), (25.0, False)])
@pytest.mark.parametrize('one', [TABLE, WALL])
def test_a_class_needs_a_normal_that_is_known_well_enough(one, sigma_deg, is_known):
    covariance = np.diag([1.0, 1.0, 1.0, 0.0]) * np.radians(sigma_deg) ** 2
    kind, = classify_planes(Planes.of([replace(one, covariance=covariance)]), DOWN)
    assert (kind == PlaneClass.OTHER) is not is_known


def test_the_probability_of_a_class_is_calibrated():
    """Upright, level and any planes in the shares of the module, with normals 8 degrees off."""
    count, sigma_rad, rng = 4000, np.radians(8.0), np.random.default_rng(0)
    normals = rng.standard_normal((count, 3))
    kind = rng.choice(3, count, p=[UPRIGHT_SHARE, LEVEL_SHARE, 1 - UPRIGHT_SHARE - LEVEL_SHARE])
    normals[kind == 0, 1], normals[kind == 1] = 0.0, DOWN
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = normals + sigma_rad * rng.standard_normal((count, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    stated = _probabilities(seen, np.tile(sigma_rad**2 * np.eye(3), (count, 1, 1)), DOWN,
                            np.radians(TOLERANCE_DEG))
    for along in ([0, 2], [1]):  # horizontal normals, vertical ones
        found, true = (np.linalg.norm(one[:, along], axis=1) >= np.cos(np.radians(TOLERANCE_DEG))
                       for one in (seen, normals))
        assert stated[found].mean() == pytest.approx(true[found].mean(), abs=0.015)


@pytest.mark.parametrize(('certainty', 'is_known'), [(0.79, False), (0.81, True)])
@pytest.mark.parametrize('one', [FLOOR, CEILING, WALL])
def test_a_class_needs_the_certainty_of_the_orientation(one, certainty, is_known):
    kind, = classify_planes(Planes.of([replace(one, class_certainty=certainty)]), DOWN)
    assert (kind == PlaneClass.OTHER) is not is_known


def test_of_uncertain_orientation_the_own_floor_is_floor_and_a_level_surface_no_step():
    rng = np.random.default_rng(3)
    terrain = look(stairs(rng, 2.0, 1), View(1.0, 25.0, roll_deg=3.0), rng)
    scene = terrain.scene
    found = PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
        scene.rgb, scene.intrinsics, scene.depth_m, scene.gravity_camera)
    steps = [k for k, kind in enumerate(found.classes) if kind == PlaneClass.STEP]
    floor = list(found.classes).index(PlaneClass.FLOOR)
    assert steps

    def again(doubtful, *, certainty=0.5, is_metric=True):
        certainties = np.where(np.arange(len(found.planes)) == doubtful, certainty, 1.0)
        planes = replace(found.planes, class_certainties=certainties)
        return find_ground(replace(found, planes=planes), found.depth_m, scene.intrinsics,
                           Gravity(scene.gravity_camera, 1.0, 'measured'), Config(),
                           is_metric=is_metric).classes

    assert again(steps[0])[steps[0]] == PlaneClass.OTHER
    assert all(again(steps[0])[k] == PlaneClass.STEP for k in steps[1:])
    assert again(floor)[floor] == PlaneClass.FLOOR
    assert again(floor, certainty=0.4)[floor] == PlaneClass.OTHER, 'more likely no level surface'
    assert again(floor, is_metric=False)[floor] == PlaneClass.OTHER


def test_pieces_of_one_ceiling_are_all_ceiling():
    pieces = Planes.of([CEILING, plane([0, 1, 0], 1.15)])
    assert classify_planes(pieces, DOWN).tolist() == [PlaneClass.CEILING] * 2


def test_coarse_gravity_becomes_the_floors():
    coarse = unit_direction((0.2, 1.0, -0.2))
    np.testing.assert_allclose(
        refine_gravity(Planes.of([FLOOR, WALL, CEILING, ROOF]), coarse, 20.0), DOWN, atol=1e-9)


def test_coarse_gravity_stays_coarse_without_right_angles():
    coarse = unit_direction((0.2, 1.0, 0.0))
    assert refine_gravity(NO_PLANES, coarse, 20.0) is None
    assert refine_gravity(Planes.of([FLOOR]), coarse, 20.0) is None
    assert refine_gravity(Planes.of([FLOOR, ROOF]), coarse, 20.0) is None
    assert refine_gravity(Planes.of([FLOOR, WALL]), coarse, 5.0) is None
