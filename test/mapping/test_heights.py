# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as heights over frames: hand-solved, there and back, derivatives by differences."""

import cv2
import numpy as np
import pytest

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.heights import (
    PlaneFrames,
    heights_of,
    squared_misfits,
    with_pose_error,
)
from plane_detector.types import Plane, Planes

ONE = np.zeros(1, int)


def plane(normal, offset_m, covariance=None):
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    return Planes.of([Plane(normal, offset_m, -offset_m * normal, 1, 0.0, 1.0,
                            np.zeros((4, 4)) if covariance is None else covariance, 1.0)])


def frame(rng=None):
    turn = np.eye(3) if rng is None else cv2.Rodrigues(rng.normal(0, 1, 3))[0]
    origin = np.zeros(3) if rng is None else rng.normal(0, 2, 3)
    return PlaneFrames(origin[None], turn[None], np.zeros((1, 3)), np.zeros((1, 3, 3)))


def test_a_tilted_floor():
    """The plane z = .1 x + 2 over the frame of the axes."""
    (heights,), _, _ = heights_of(frame(), plane([-0.1, 0, 1], -2 / np.hypot(0.1, 1)), ONE)
    assert heights == pytest.approx([0.1, 0, 2])


def test_there_and_back_with_the_covariance():
    rng = np.random.default_rng(0)
    over = frame(rng)
    factor = 1e-2 * rng.normal(size=(3, 3))
    frames = PlaneFrames(over.origins_m, over.axes, rng.normal(0, 0.2, (1, 3)),
                         (factor @ factor.T)[None])
    normals, offsets, covariances = frames.as_planes()
    heights, back, _ = heights_of(over, plane(normals[0], offsets[0], covariances[0]), ONE)
    assert heights == pytest.approx(frames.coefficients)
    assert back == pytest.approx(frames.covariances, abs=1e-9)


def test_derivatives_by_the_pose_are_the_differences():
    rng = np.random.default_rng(1)
    over, centre = frame(rng), rng.normal(0, 2, 3)
    found = plane(over.axes[0, 2], 1.0)
    heights, _, (jacobian,) = heights_of(over, found, ONE, centre_m=centre)
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        turn = cv2.Rodrigues(step[:3])[0]
        moved = found.moved(RigidTransform(turn, centre + step[3:] - turn @ centre))
        changed, _, _ = heights_of(over, moved, ONE)
        assert (changed - heights)[0] / 1e-6 == pytest.approx(jacobian[:, k], abs=1e-4)


def test_an_error_of_the_pose_is_the_same_on_both_ways():
    rng = np.random.default_rng(2)
    over, centre = frame(rng), rng.normal(0, 2, 3)
    found = plane(over.axes[0, 2], 1.0)
    error = np.diag(rng.uniform(0.01, 0.02, 6) ** 2)
    _, (direct,), _ = heights_of(over, found, ONE, error, centre)
    _, (stated,), _ = heights_of(over, with_pose_error(found, error, centre), ONE)
    assert direct == pytest.approx(stated, rel=1e-6, abs=1e-9)


def test_chi_squared_of_a_shift_of_three_deviations():
    frames = PlaneFrames(np.zeros((1, 3)), np.eye(3)[None], np.array([[0.1, 0, 2.0]]),
                         np.diag([1.0, 1.0, 0.5])[None])
    assert squared_misfits(frames, np.array([[0.1, 0, 5.0]]), np.diag([1.0, 1.0, 0.5])[None]
                           ) == pytest.approx([9.0])
