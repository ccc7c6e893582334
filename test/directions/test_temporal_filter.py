# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the temporal filter of directions."""

import cv2
import numpy as np
import pytest

from plane_detector.directions.axis_pairs import AxisPair
from plane_detector.directions.line_segments import LineSegments, segments_from_pixels
from plane_detector.directions.temporal_filter import (
    HELD_IMAGES,
    JUMPS_BELIEVED,
    track_directions,
    turn_between,
)
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)
AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def rotated(rotation):
    down = rotation @ AXES[0]
    covariance = 1e-4 * (np.eye(3) - np.outer(down, down))
    return SceneDirections(down, covariance, 0.3,
                           (AxisPair(AXES[1:] @ rotation.T, 0.01, 0.3),), '', '')


def refused():
    return SceneDirections(None, np.full((3, 3), np.nan), 0.0, (), 'no lines', 'no lines')


def turn(x_deg=0.0, y_deg=0.0, z_deg=0.0):
    return cv2.Rodrigues(np.radians([x_deg, y_deg, z_deg]))[0]


def lines(rotation=None) -> LineSegments:
    """Return segments at infinity, seen by a rotated camera."""
    rng = np.random.default_rng(0)
    middle = rng.uniform([-0.5, -0.4], [0.5, 0.4], (30, 2))
    along = rng.normal(0, 1, (30, 2))
    along *= 0.08 / np.linalg.norm(along, axis=1, keepdims=True)
    rays = np.dstack([np.stack([middle - along, middle + along], 1), np.ones((30, 2))])
    rays = rays @ (np.eye(3) if rotation is None else rotation).T
    return segments_from_pixels(rays[..., :2] / rays[..., 2:] * 500 + [319.5, 239.5], CAMERA)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize('angles', [(0.5, 0, 0), (0, -1.0, 0), (0, 0, 2.0), (1.0, 0.5, -1.0)])
def test_the_turn_of_the_lines_is_that_of_the_camera(angles):
    rotation = turn(*angles)
    found = turn_between(lines(), lines(rotation))
    assert found == pytest.approx(cv2.Rodrigues(rotation)[0].ravel(), abs=1e-4)


def test_lines_with_other_motion_do_not_count():
    after = lines(turn(0, 1.0, 0))
    ends_px = after.ends_px.copy()
    ends_px[:6] += [12.0, 9.0]
    found = turn_between(lines(), segments_from_pixels(ends_px, CAMERA))
    assert np.degrees(found) == pytest.approx([0, 1.0, 0], abs=0.1)


def test_few_lines_give_no_rotation():
    few = segments_from_pixels(lines().ends_px[:5], CAMERA)
    assert turn_between(few, few) is None


def test_flicker_of_a_still_camera_is_averaged():
    rng = np.random.default_rng(1)
    tracked, alone = None, []
    for _ in range(40):
        found = rotated(turn(*rng.normal(0, 0.7, 3)))
        tracked = track_directions(tracked, found, lines())
        alone.append(angle_deg(found.gravity_camera, AXES[0]))
    assert angle_deg(tracked.directions.gravity_camera, AXES[0]) < 0.5 * np.mean(alone)
    pair = tracked.directions.pairs[0].axes
    assert np.vstack([tracked.directions.gravity_camera, pair]) @ np.vstack(
        [tracked.directions.gravity_camera, pair]).T == pytest.approx(np.eye(3), abs=1e-9)


def test_a_turning_camera_does_not_lag():
    tracked = None
    for k in range(10):
        rotation = turn(1.5 * k, 0, 0)
        tracked = track_directions(tracked, rotated(rotation), lines(rotation))
    assert angle_deg(tracked.directions.gravity_camera, rotation @ AXES[0]) < 0.3


def test_refused_directions_are_held_and_rotated():
    tracked = track_directions(None, rotated(np.eye(3)), lines())
    rotation = turn(0.3, 0, 0)
    tracked = track_directions(tracked, refused(), lines(rotation))
    assert angle_deg(tracked.directions.gravity_camera, rotation @ AXES[0]) < 0.05
    for _ in range(HELD_IMAGES):
        tracked = track_directions(tracked, refused(), lines(rotation))
    assert tracked.directions.gravity_camera is None


def test_level_axes_are_not_held_while_the_camera_turns():
    tracked = track_directions(None, rotated(np.eye(3)), lines())
    assert track_directions(tracked, refused(), lines()).directions.pairs
    rotation = turn(0, 1.0, 0)
    turning = track_directions(tracked, refused(), lines(rotation))
    assert turning.directions.gravity_camera is not None
    assert not turning.directions.pairs


def test_a_different_answer_must_be_repeated():
    tracked = track_directions(None, rotated(np.eye(3)), lines())
    other = rotated(turn(0, 0, 20))
    for _ in range(JUMPS_BELIEVED - 1):
        tracked = track_directions(tracked, other, lines())
        assert angle_deg(tracked.directions.gravity_camera, AXES[0]) < 0.1
    tracked = track_directions(tracked, other, lines())
    assert angle_deg(tracked.directions.gravity_camera, other.gravity_camera) < 0.1


def test_a_new_scene_is_not_averaged():
    tracked = track_directions(None, rotated(np.eye(3)), lines())
    nothing = segments_from_pixels(np.zeros((0, 2, 2)), CAMERA)
    assert track_directions(tracked, refused(), nothing).directions.gravity_camera is None
