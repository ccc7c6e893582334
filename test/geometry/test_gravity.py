# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Gravity of an IMU that turns, is shaken, or sends something else."""

import re

import numpy as np
import pytest

from plane_detector.geometry.gravity import GravityFilter, sign_question

G = 9.80665
LEVEL = (0.0, 0.0, 0.0, 1.0)


def off_deg(found, down):
    return np.degrees(np.arccos(np.clip(found @ down / np.linalg.norm(down), -1, 1)))


def up_at(tilt_deg):
    """Return the direction up of a camera that looks so far down."""
    tilt = np.radians(tilt_deg)
    return np.array([0.0, -np.cos(tilt), -np.sin(tilt)])


def sine(strength, hz, phase):
    return lambda t: np.array([0.6, 0.0, 0.8]) * strength * np.sin(2 * np.pi * hz * t + phase)


def noise(strength, seed):
    rng = np.random.default_rng(seed)
    return lambda t: rng.normal(0, strength, 3)


@pytest.mark.parametrize('shake', [sine(2.0, 2.5, 0.3), sine(2.0, 7.0, 1.6), sine(3.0, 12.0, 0.0),
                                   noise(2.0, 1), noise(1.2, 2)])
@pytest.mark.parametrize(('rate_hz', 'has_gyroscope'), [(100, False), (200, True)])
def test_shaking_is_averaged_and_said(shake, rate_hz, has_gyroscope):
    imu, worst_deg, turn = GravityFilter(LEVEL), 0.0, (1e-3, -2e-3, 1e-3)
    for t in np.arange(0.0, 6.0, 1 / rate_hz):
        imu.add(t, G * up_at(8.0) + shake(t), turn if has_gyroscope else None)
        if t > 2.0:
            worst_deg = max(worst_deg, off_deg(imu.gravity_camera(t), -up_at(8.0)))
    # 2 m/s^2 turn a single reading by 11 degrees.
    assert worst_deg < (2.0 if has_gyroscope else 4.0)
    number = float(imu.problem.split('shaken by ')[1].split()[0])
    assert 1.2 < number < 7.0 and 'base_frame' in imu.problem


@pytest.mark.parametrize('rate_deg_s', [20.0, -60.0])
def test_with_angular_velocities_gravity_turns_with_the_camera(rate_deg_s):
    """Also while the robot brakes by 2 m/s^2 for half a second."""
    imu = GravityFilter(LEVEL)
    for t in np.arange(0.0, 4.0, 0.005):
        tilt_deg = max(t - 3.0, 0.0) * rate_deg_s
        brake = np.array([0.0, 0.0, -2.0]) * (3.2 < t < 3.7)
        # About x, in the sense that makes the camera look down.
        turn = (-np.radians(rate_deg_s) * (t > 3.0), 1e-4, 0.0)
        imu.add(t, G * up_at(tilt_deg) + brake, turn)
        assert off_deg(imu.gravity_camera(t), -up_at(tilt_deg)) < 4.0
    assert off_deg(imu.gravity_camera(4.0), -up_at(rate_deg_s)) < 3.0


def test_the_first_readings_count_alike():
    imu = GravityFilter(LEVEL)
    for k in range(20):
        imu.add(0.01 * k, G * up_at(0.0) + (0.0, 0.0, 3.0 if k % 2 else -3.0))
    assert off_deg(imu.gravity_camera(0.2), -up_at(0.0)) < 2.0


@pytest.mark.parametrize(('force', 'said'), [
    ((0.0, -1.0, 0.0), '1.00 long at rest, not 9.81 m/s.2: it is in g'),
    ((0.03, -0.6, 0.8), '1.00 long .* in g'), ((0.0, -9810.0, 0.0), '9810.00 long'),
    ((0.0, 0.1, 0.0), '0.10 long .* with gravity'), ((0.0, -6.0, 0.0), '6.00 long'),
    ((0.0, 0.0, 0.0), 'all zeros: it has no accelerometer'), ((0.0, np.nan, 0.0), 'not finite'),
    ((np.inf, 0.0, 0.0), 'not finite')])
def test_what_is_not_gravity_is_said_and_not_used(force, said):
    imu = GravityFilter(LEVEL)
    for k in range(100):
        imu.add(0.01 * k, force)
    assert imu.gravity_camera(1.0) is None
    assert re.search(said, imu.problem) and 'gravity is not taken from it' in imu.problem


def test_still_readings_are_no_problem_and_a_jolt_is_not_gravity():
    imu = GravityFilter(LEVEL)
    rng = np.random.default_rng(0)
    for k in range(300):
        jolt = np.array([0.0, 0.0, 40.0]) * (k % 50 == 30)
        imu.add(0.01 * k, G * up_at(20.0) + rng.normal(0, 0.1, 3) + jolt)
        assert imu.problem == ''
    assert off_deg(imu.gravity_camera(3.0), -up_at(20.0)) < 0.5
    assert imu.gravity_camera(5.0) is None


FLOOR, WALL, CEILING = [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]


@pytest.mark.parametrize(('normals', 'counts', 'is_asked'), [
    ([FLOOR], [5000], True), ([FLOOR, WALL], [3000, 5000], True), ([WALL], [5000], False),
    ([FLOOR, CEILING], [3000, 2000], False), ([FLOOR], [500], False)])
def test_a_floor_that_would_be_a_ceiling_is_asked_about(normals, counts, is_asked):
    normals, counts = np.array(normals), np.array(counts)
    offsets_m = np.full(len(counts), 0.8)
    turned = sign_question(np.array([0.0, -1.0, 0.0]), normals, offsets_m, counts, 10000)
    assert bool(turned) == is_asked
    assert not turned or ('upside down' in turned and '0.80 m' in turned and 'REP-145' in turned)
    assert not sign_question(np.array([0.0, 1.0, 0.0]), normals, offsets_m, counts, 10000)


@pytest.mark.parametrize(('distance_m', 'is_asked'), [(0.7, True), (2.4, False)])
def test_a_camera_that_looks_straight_down(distance_m, is_asked):
    """A camera that looks up at the ceiling of a room is none."""
    said = sign_question(np.array([0.0, 0.0, -1.0]), np.array([WALL]), np.array([distance_m]),
                         np.array([9000]), 10000)
    assert bool(said) == is_asked


def test_the_mounting_turns_the_imus_frame_into_the_cameras():
    """Its axes are x forward, y left, z up; those of the camera x right, y down, z forward."""
    for force, expected in (((0.0, 0.0, 9.8), (0, 1, 0)), ((-9.8, 0.0, 0.0), (0, 0, 1))):
        imu = GravityFilter((0.5, -0.5, 0.5, 0.5))
        imu.add(0.0, force)
        np.testing.assert_allclose(imu.gravity_camera(0.0), expected, atol=1e-12)
