# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The correction of the poses: shifts are found, jitter is not carried on."""

import numpy as np
import pytest

from plane_detector.config import MapConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.association import compare
from plane_detector.mapping.heights import PlaneFrames, heights_of
from plane_detector.mapping.map_plane import new_axes
from plane_detector.mapping.registration import (
    Correction,
    heights_by_others,
    motion,
    predict,
    register,
)
from plane_detector.types import Plane, Planes

NORMALS = -np.eye(3)
NOISE = np.diag([1e-6, 1e-6, 1e-6, 1e-6])
SHIFT = RigidTransform(np.eye(3), np.array([0.02, -0.03, 0.01]))


def corner(normals=NORMALS):
    """Return walls 2 m from the origin in the frame of the map, and their frames."""
    planes = Planes.of([Plane(normal, 2.0, -2 * normal, 1, 0.0, 1.0, NOISE, 1.0)
                        for normal in normals])
    frames = PlaneFrames(planes.centroids_m, new_axes(planes.normals, np.eye(3)[2]),
                         np.zeros((len(planes), 3)), np.zeros((len(planes), 3, 3)))
    heights, covariances, _ = heights_of(frames, planes, np.arange(len(planes)))
    return planes, PlaneFrames(frames.origins_m, frames.axes, heights, covariances)


def standing(drift=0.02):
    start = RigidTransform.identity()
    return Correction(start, np.zeros((6, 6)), start, drift**2 * np.eye(6), start)


def test_a_shift_of_the_poses_is_found():
    planes, frames = corner()
    seen = planes.moved(SHIFT)  # as by a camera at -SHIFT, which claims to stand at 0
    prediction = predict(standing(), RigidTransform.identity(), MapConfig(pose_jitter=0.0))
    found = register(prediction, seen, frames, np.arange(3))
    assert found.transform.translation_m == pytest.approx(-SHIFT.translation_m, abs=1e-3)
    assert found.persistent.translation_m == pytest.approx(found.transform.translation_m, abs=1e-3)
    assert found.size()[0] == pytest.approx(np.linalg.norm(SHIFT.translation_m), abs=1e-3)
    assert (np.diag(found.error) < np.diag(prediction.covariance)).all()


def test_jitter_corrects_its_image_only():
    planes, frames = corner()
    prediction = predict(standing(drift=1e-4), RigidTransform.identity(),
                         MapConfig(pose_jitter=0.02))
    found = register(prediction, planes.moved(SHIFT), frames, np.arange(3))
    assert found.transform.translation_m == pytest.approx(-SHIFT.translation_m, abs=1e-3)
    assert np.linalg.norm(found.persistent.translation_m) < 1e-3


def test_along_a_single_wall_nothing_is_learnt():
    planes, frames = corner(NORMALS[2:])
    prediction = predict(standing(), RigidTransform.identity(), MapConfig())
    found = register(prediction, planes.moved(SHIFT), frames, np.zeros(1, int))
    assert found.transform.translation_m[:2] == pytest.approx([0, 0], abs=1e-6)
    assert found.transform.translation_m[2] == pytest.approx(-0.01, abs=2e-3)
    assert found.error[3, 3] == pytest.approx(prediction.covariance[3, 3])


def test_the_prior_grows_with_the_way_and_not_with_the_rate_of_images():
    config, end = MapConfig(pose_drift=0.01), np.array([1.0, 0, 0])
    once = predict(standing(drift=0.0), RigidTransform(np.eye(3), end), config).drift
    many = standing(drift=0.0)
    for k in range(1, 11):
        prediction = predict(many, RigidTransform(np.eye(3), k / 10 * end), config)
        many = register(prediction, *corner(), np.zeros(0, int))
    assert once[3, 3] == pytest.approx(0.01**2)
    assert once[0, 0] == pytest.approx((0.01 / 2) ** 2)  # moves a plane 2 m away as far
    assert many.drift[3, 3] == pytest.approx(once[3, 3])


def test_a_rotation_that_is_off_shifts_a_camera_that_moves():
    """About z, of a camera that has moved along x: along y, by the angle times the way."""
    start, variance = RigidTransform.identity(), np.radians(1.0) ** 2
    before = Correction(start, np.zeros((6, 6)), start, np.diag([0, 0, variance, 0, 0, 0]), start)
    moved = RigidTransform(np.eye(3), np.array([2.0, 0.0, 0.0]))
    drift = predict(before, moved, MapConfig(pose_drift=0.0)).drift
    assert drift[4, 4] == pytest.approx(4 * variance)
    assert drift[4, 2] == drift[2, 4] == pytest.approx(2 * variance)
    assert drift[3, 3] == drift[5, 5] == 0


def test_motion_is_distance_and_angle():
    turn = RigidTransform.from_quaternion((0, 0, np.sin(0.1), np.cos(0.1)), (0.3, 0.4, 0))
    assert motion(RigidTransform.identity(), turn) == pytest.approx((0.5, 0.2))


def test_what_two_planes_share_is_counted_in_cells():
    """15 of the 40 cells in view are among the 20 of the found plane, or all 10 of the found."""
    planes, frames = corner(NORMALS[:1])
    for common, of_found, shared, overlap in ((15, 20, 15 / 20, 15 / 45), (10, 10, 1, 10 / 40)):
        pairs = compare(frames, planes, np.array([[common, 40]]), np.array([of_found]),
                        np.zeros((6, 6)), np.zeros(3))
        assert (pairs.shared.item(), pairs.overlap.item()) == pytest.approx((shared, overlap))


def test_a_plane_is_no_evidence_of_itself():
    planes, frames = corner()
    prediction = predict(standing(), RigidTransform.identity(), MapConfig())
    for index in (np.arange(1), np.arange(3)):
        few = frames.selected(index)
        found = register(prediction, planes.moved(SHIFT), few, index)
        seen = planes.moved(found.camera.after(SHIFT))
        heights, covariances, by_pose = heights_by_others(found, few, seen, index,
                                                 np.ones(len(index), bool))
        # Of its distance the other walls, which are at right angles to it, say nothing.
        expected, errors, _ = heights_of(few, planes.moved(SHIFT), index, prediction.covariance)
        assert heights[:, 2] == pytest.approx(expected[:, 2], abs=2e-3)
        assert covariances[:, 2, 2] == pytest.approx(errors[:, 2, 2], rel=0.05)
        assert (by_pose[:, 2, 2] < covariances[:, 2, 2]).all()
