# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes against a sensor's depth: hand-solved cases for purity, angle, offset, tolerance."""

import numpy as np
import pytest

from plane_detector.evaluation.sensor_comparison import best_plane, depth_error, judge_planes
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)


def test_the_best_plane_ignores_outliers():
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-1, 1, (700, 2)), np.full(700, 2.0)])
    flat[:, 2] += rng.normal(0, 0.005, 700)
    astray = rng.uniform([-1, -1, 1], [1, 1, 5], (300, 3))
    plane = best_plane(np.vstack([flat, astray]), rng)
    np.testing.assert_allclose(plane, [0, 0, -1, 2], atol=0.01)


def test_a_plane_is_judged_by_hand():
    """Of a predicted plane at 2.1 m, three quarters lie on a wall at 2 m, the rest is further."""
    sensor_m = np.full((120, 160), 2.0)
    sensor_m[:, 120:] = 3.0
    labels = np.zeros(sensor_m.shape, np.int32)
    tilted = np.radians(10)
    planes = np.array([[0, np.sin(tilted), -np.cos(tilted), 2.1]])
    (judged,) = judge_planes(labels, planes, sensor_m, CAMERA, np.random.default_rng(0))
    assert judged.pixels == sensor_m.size
    assert judged.purity == pytest.approx(0.75)
    assert judged.normal_error_deg == pytest.approx(10, abs=0.1)
    assert judged.offset_error_m == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(('distance_m', 'stray_m', 'purity'), [
    (1.0, 0.029, 1), (1.0, 0.04, 7 / 8), (4.0, 0.057, 1), (4.0, 0.075, 7 / 8)])
def test_the_tolerance_is_3_cm_or_a_share_of_the_depth(distance_m, stray_m, purity):
    sensor_m = np.full((120, 160), distance_m, np.float32)
    sensor_m[:, ::16] += stray_m
    sensor_m[:, 8::16] -= stray_m
    (judged,) = judge_planes(np.zeros(sensor_m.shape, int), np.array([[0, 0, -1, distance_m]]),
                             sensor_m, CAMERA, np.random.default_rng(0))
    assert judged.purity == pytest.approx(purity)


def test_a_plane_that_the_sensor_did_not_see_is_not_judged():
    sensor_m = np.full((120, 160), np.nan, np.float32)
    sensor_m[0, :99] = 2.0
    planes = np.array([[0, 0, -1, 2.0]])
    labels = np.zeros(sensor_m.shape, int)
    assert judge_planes(labels, planes, sensor_m, CAMERA, np.random.default_rng(0)) == []


def test_the_distance_is_that_of_the_points_from_the_plane():
    depth_m = np.full((120, 160), 2.0)
    tilt = np.radians(5)
    plane = [0, np.sin(tilt), -np.cos(tilt), 2.05]
    (judged,) = judge_planes(np.zeros(depth_m.shape, int), np.array([plane]), depth_m, CAMERA,
                             np.random.default_rng(0))
    points_m = depth_to_points(depth_m, CAMERA).reshape(-1, 3)
    assert judged.distance_m == pytest.approx(
        np.median(np.abs(points_m @ plane[:3] + plane[3])), abs=1e-5)


def test_judged_planes_are_identified_by_index():
    depth_m = np.full((120, 160), 2.0)
    depth_m[:, :80] = np.nan
    labels = np.zeros(depth_m.shape, int)
    labels[:, 80:] = 1
    planes = np.array([[0, 0, -1, 9.0], [0, 0, -1, 2.0]])
    (judged,) = judge_planes(labels, planes, depth_m, CAMERA, np.random.default_rng(0))
    assert judged.index == 1
    assert judged.offset_error_m == pytest.approx(0, abs=1e-9)


def test_depth_error_of_a_scaled_depth():
    true_m = np.linspace(1, 5, 100)
    assert depth_error(1.1 * true_m, true_m) == (pytest.approx(0.1), pytest.approx(1.1))


def test_the_error_of_a_depth_that_was_not_measured_is_unknown():
    assert np.isnan(depth_error(np.ones((3, 3)), np.full((3, 3), np.nan))).all()
