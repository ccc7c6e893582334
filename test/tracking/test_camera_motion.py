# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the camera from planes seen in two images."""

import cv2
import numpy as np
import pytest

from plane_detector.tracking.camera_motion import NO_MOTION, PlaneMotion, estimate_motion
from plane_detector.types import Plane, Planes


def planes(*normals_and_offsets):
    """Return planes with these normals (x, y, z) and offsets, each around its nearest point."""
    normals = np.array([normal for normal, _ in normals_and_offsets], float)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Planes.of([Plane(normal, offset_m, -offset_m * normal, 1, 0.0, 1.0, 1e-6 * np.eye(4), 1)
                      for normal, (_, offset_m) in zip(normals, normals_and_offsets, strict=True)])


FLOOR, LEFT, BACK, BOX = ([0, -1, 0], 1.4), ([1, 0, 0], 1.5), ([0, 0, -1], 4.0), ([1, 0, -5], 2.0)


def test_motion_of_planes_that_fix_it():
    truth = PlaneMotion(cv2.Rodrigues(np.radians([1.0, 3.0, -2.0]))[0],
                        np.array([0.2, -0.1, 0.3]), 1.0)
    before = planes(FLOOR, LEFT, BACK, BOX, ([-1, -1, 0], 2.0))
    motion = estimate_motion(before, truth.move(before), 2 * (np.arange(5),), np.ones(5))
    turn = cv2.Rodrigues(motion.rotation @ truth.rotation.T)[0]
    assert np.degrees(np.linalg.norm(turn)) < 0.2
    assert np.linalg.norm(motion.translation_m - truth.translation_m) < 0.03
    assert motion.scale == pytest.approx(1, abs=0.02)
    assert estimate_motion(before, before, 2 * (np.arange(0),), np.zeros(0)) is NO_MOTION


def test_a_moved_plane_keeps_its_equation_and_its_size_grows_with_the_unit():
    motion = PlaneMotion(cv2.Rodrigues(np.radians([5.0, 40.0, -20.0]))[0],
                         np.array([0.3, -0.2, 0.1]), 2.0)
    room = planes(FLOOR, LEFT, BACK, BOX)
    moved = motion.move(room)
    assert moved.offsets_m == pytest.approx(-(moved.normals * moved.centroids_m).sum(axis=1))
    assert moved.centroids_m == pytest.approx(
        2 * room.centroids_m @ motion.rotation.T + motion.translation_m)
    assert moved.areas_m2 == pytest.approx(4)


def test_a_wrong_pair_does_not_turn_the_camera():
    before = planes(FLOOR, LEFT, BACK, BOX)
    after = planes(FLOOR, LEFT, BACK, ([1, 0, -1], 2.0))
    motion = estimate_motion(before, after, 2 * (np.arange(4),), np.array([5.0, 3.0, 3.0, 1.0]))
    assert np.degrees(np.linalg.norm(cv2.Rodrigues(motion.rotation)[0])) < 1.0


def test_errors_of_nearly_parallel_planes_hardly_turn_the_camera():
    """Of .2 degrees, between normals 6 degrees apart: they alone would turn it by 4.6."""
    before, after = (planes(*(([x, error * x, -1], 4.0) for x in (-0.05, 0.05)))
                     for error in (0.0, 0.08))
    motion = estimate_motion(before, after, 2 * (np.arange(2),), np.ones(2))
    assert motion.rotation == pytest.approx(np.eye(3), abs=0.02)


def test_errors_of_pieces_of_a_wall_do_not_mirror_the_camera():
    """Four pieces, tilted up or down by 1.7 degrees, each the other way after a step ahead."""
    before, after = (planes(*(([x, up * y, -1], offset_m) for x in (-0.2, 0.2)
                              for y in (-0.03, 0.03))) for up, offset_m in ((1, 4.0), (-1, 3.9)))
    motion = estimate_motion(before, after, 2 * (np.arange(4),), np.ones(4))
    assert motion.rotation == pytest.approx(np.eye(3), abs=0.01)
    assert motion.move(before).offsets_m == pytest.approx(3.9, abs=0.02)
