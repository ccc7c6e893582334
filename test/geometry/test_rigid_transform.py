# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Points and planes in another frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from plane_detector.geometry.rigid_transform import RigidTransform, interpolate, quaternions
from plane_detector.types import Plane, Planes

TURN = RigidTransform.from_quaternion((0.2, -0.4, 0.1, 0.9), (1.0, -2.0, 0.5))
# z forward, x right, y down into x forward, y left, z up; 1.2 m above the floor.
OPTICAL_TO_BASE = RigidTransform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
                                 np.array([0.1, 0.0, 1.2]))


def test_by_hand_an_optical_frame_on_a_robot():
    np.testing.assert_allclose(OPTICAL_TO_BASE.points(np.array([0.0, 1.2, 3.0])), [3.1, 0, 0])


def test_points_keep_dtype_shape_and_nan():
    points_m = np.full((2, 3, 3), np.nan, np.float32)
    points_m[0, 0] = 1, 2, 3
    moved_m = TURN.points(points_m)
    assert moved_m.dtype == np.float32
    assert moved_m.shape == points_m.shape
    assert np.isnan(moved_m[1, 2]).all()
    np.testing.assert_allclose(TURN.inverse().points(moved_m)[0, 0], [1, 2, 3], rtol=1e-5)


def test_one_after_the_other():
    point_m = np.array([0.3, 0.2, 2.0])
    np.testing.assert_allclose(TURN.after(OPTICAL_TO_BASE).points(point_m),
                               TURN.points(OPTICAL_TO_BASE.points(point_m)))
    both = TURN.inverse().after(TURN)
    np.testing.assert_allclose(both.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(both.translation_m, 0, atol=1e-12)


def test_the_points_of_a_plane_stay_on_it():
    floor = Plane(np.array([0.0, -1.0, 0.0]), 1.2, np.array([0.5, 1.2, 3.0]), 9, 0.0, 1.0,
                  np.eye(4), 1.0)
    moved = Planes.of([floor]).moved(OPTICAL_TO_BASE)[0]
    np.testing.assert_allclose(moved.normal, [0, 0, 1])
    assert moved.offset_m == pytest.approx(0.0), 'the origin of the base is on the floor'
    assert moved.normal @ moved.centroid_m + moved.offset_m == pytest.approx(0.0)
    turned = Planes.of([floor]).moved(TURN)[0]
    on_it_m = TURN.points(np.array([-2.0, 1.2, 7.0]))
    assert turned.normal @ on_it_m + turned.offset_m == pytest.approx(0.0)


def test_the_error_of_a_moved_plane_is_that_of_its_moved_samples():
    """Of planes with the errors that their covariance states, after ten poses with turns."""
    rng, normal = np.random.default_rng(4), np.array([0.6, 0.0, -0.8])
    spread = np.diag([2e-3, 3e-3, 0.0, 6e-3]) ** 2
    across = np.eye(4)
    across[:3, :3] = np.column_stack([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], normal])
    covariance = across @ spread @ across.T
    truth = Plane(normal, 2.0, -2.0 * normal, 9, 0.0, 1.0, covariance, 1.0)
    samples = rng.multivariate_normal([*normal, 2.0], covariance, 2000)
    planes = Planes.of([truth] + [replace(truth, normal=sample[:3], offset_m=sample[3])
                                  for sample in samples])
    scale = 1.0
    for turn in Rotation.random(10, rng=rng):
        step = RigidTransform(turn.as_matrix(), rng.normal(0, 1.0, 3))
        planes, scale = planes.moved(step, 1.1), 1.1 * scale
        own = np.column_stack([planes.normals, planes.offsets_m])
        off = own[1:] - own[0]
        point = np.append(planes.centroids_m[0], 1.0)
        stated = planes.covariances[0]
        np.testing.assert_allclose(np.cov(off.T), stated, atol=0.1 * stated.max())
        z_score = (off @ point).std() / np.sqrt(point @ stated @ point)
        assert 0.9 < z_score < 1.1, 'at the centroid'
        assert planes.offsets_m[0] == pytest.approx(-planes.normals[0] @ planes.centroids_m[0])
    assert planes.rms_m[0] == 0.0 and planes.areas_m2[0] == pytest.approx(scale ** 2)


def test_rotations_are_those_of_scipy():
    turns = Rotation.random(50, rng=np.random.default_rng(0))
    turns = Rotation.concatenate([turns, Rotation.from_quat(np.eye(4))])  # half turns and none
    found, expected = quaternions(turns.as_matrix()), turns.as_quat()
    same_sign = np.sign((found * expected).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(found, same_sign * expected, atol=1e-12)
    for matrix, quaternion in zip(turns.as_matrix(), turns.as_quat(), strict=True):
        one = RigidTransform.from_quaternion(3 * quaternion, (0, 0, 0))
        np.testing.assert_allclose(one.rotation, matrix, atol=1e-12)


@pytest.mark.parametrize('share', [0.0, 0.2, 0.9, 1.0])
def test_in_between_is_that_of_scipy(share):
    rng = np.random.default_rng(1)
    for _ in range(20):
        pair = Rotation.random(2, rng=rng)
        before, after = (RigidTransform(one.as_matrix(), rng.normal(size=3)) for one in pair)
        between = interpolate(before, after, share)
        np.testing.assert_allclose(between.rotation, Slerp([0, 1], pair)(share).as_matrix(),
                                   atol=1e-9)
        np.testing.assert_allclose(between.translation_m, (1 - share) * before.translation_m
                                   + share * after.translation_m)
        np.testing.assert_allclose(interpolate(before, before, share).rotation, before.rotation,
                                   atol=1e-12)


def test_a_quaternion_of_zeros_is_refused():
    with pytest.raises(ValueError, match='quaternion'):
        RigidTransform.from_quaternion((0, 0, 0, 0), (0, 0, 0))
