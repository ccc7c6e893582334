# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Gravity and the classes of hand-made planes."""

import numpy as np
import pytest

from plane_detector.geometry.gravity import (
    gravity_from_acceleration,
    smooth_gravity,
    unit_direction,
)
from plane_detector.planes.classification import (
    PlaneClass,
    classify_planes,
    lowest_level,
    refine_gravity,
)
from plane_detector.types import Plane

DOWN = np.array([0.0, 1.0, 0.0])


def plane(normal, offset_m, pixels=1000):
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    return Plane(normal, offset_m, -offset_m * normal, pixels, 0.0, 1.0, np.zeros((4, 4)), 1.0)


FLOOR, TABLE = plane([0, -1, 0], 1.5), plane([0, -1, 0.05], 0.8)
CEILING, LAMP = plane([0, 1, 0], 1.2), plane([0, 1, 0], 0.5)
WALL, SIDE = plane([0, 0, -1], 3.0), plane([1, 0, 0], 2.0)
ROOF = plane([1, 1, 0], 2.0)


def test_each_kind_of_plane():
    planes = (WALL, FLOOR, TABLE, CEILING, LAMP, ROOF, SIDE)
    assert classify_planes(planes, DOWN) == (
        PlaneClass.WALL, PlaneClass.OTHER_HORIZONTAL, PlaneClass.OTHER_HORIZONTAL,
        PlaneClass.CEILING, PlaneClass.OTHER_HORIZONTAL, PlaneClass.OTHER, PlaneClass.WALL)
    assert lowest_level(planes, DOWN) is FLOOR


def test_the_tolerance_is_inclusive_and_no_more():
    leaning = plane([0, -np.cos(np.radians(7.9)), np.sin(np.radians(7.9))], 1.0)
    assert classify_planes((leaning,), DOWN) == (PlaneClass.OTHER_HORIZONTAL,)
    leaning = plane([0, -np.cos(np.radians(8.1)), np.sin(np.radians(8.1))], 1.0)
    assert classify_planes((leaning,), DOWN) == (PlaneClass.OTHER,)


def test_pieces_of_one_ceiling_are_all_ceiling():
    assert classify_planes((CEILING, plane([0, 1, 0], 1.15)), DOWN) == (PlaneClass.CEILING,) * 2


def test_coarse_gravity_becomes_the_floors():
    coarse = unit_direction((0.2, 1.0, -0.2))
    np.testing.assert_allclose(refine_gravity((FLOOR, WALL, CEILING, ROOF), coarse, 20.0), DOWN,
                               atol=1e-9)


def test_coarse_gravity_stays_coarse_without_right_angles():
    coarse = unit_direction((0.2, 1.0, 0.0))
    assert refine_gravity((), coarse, 20.0) is None
    assert refine_gravity((FLOOR,), coarse, 20.0) is None
    assert refine_gravity((FLOOR, ROOF), coarse, 20.0) is None
    assert refine_gravity((FLOOR, WALL), coarse, 5.0) is None


def test_accelerometer_at_rest_points_up():
    np.testing.assert_allclose(gravity_from_acceleration((0.0, -9.8, 0.0), (0, 0, 0, 1)), DOWN)


def test_mounting_turns_the_imus_frame_into_the_cameras():
    # An IMU with z up: its axes x forward, y left, z up in an optical frame x right, y down.
    mounting = (0.5, -0.5, 0.5, 0.5)
    np.testing.assert_allclose(gravity_from_acceleration((0.0, 0.0, 9.8), mounting), DOWN,
                               atol=1e-12)
    forward = gravity_from_acceleration((-9.8, 0.0, 0.0), mounting)
    np.testing.assert_allclose(forward, [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize('acceleration', [(0.0, -12.0, 0.0), (0.0, 0.0, 0.0),
                                          (np.nan, 0.0, 9.8)])
def test_a_moving_accelerometer_gives_no_direction(acceleration):
    assert gravity_from_acceleration(acceleration, (0, 0, 0, 1)) is None


def test_gravity_is_smoothed_and_stays_a_unit_vector():
    aside = unit_direction((1.0, 1.0, 0.0))
    assert smooth_gravity(None, aside, 0.1) is aside
    mixed = smooth_gravity(DOWN, aside, 0.1)
    assert np.linalg.norm(mixed) == pytest.approx(1.0)
    assert aside @ DOWN < mixed @ DOWN < 1.0
    np.testing.assert_allclose(smooth_gravity(DOWN, aside, 100.0), aside, atol=1e-9)
