# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the posterior of the vertical over time."""

import cv2
import numpy as np
import pytest

from plane_detector.directions.line_segments import LineSegments, segments_from_pixels
from plane_detector.directions.posterior import collect_evidence
from plane_detector.directions.prior import TAKEN_AS_UPRIGHT, Expected, likelihood_of_turning
from plane_detector.directions.temporal_filter import (
    ImagePoints,
    Step,
    carried,
    first_view,
    turn_between_images,
    turn_between_points,
)
from plane_detector.directions.vanishing import MIN_PROBABILITY, find_directions
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)
FRAME = cv2.Rodrigues(np.radians([-15.0, 5.0, 4.0]))[0][[1, 0, 2]]


def turn(x_deg=0.0, y_deg=0.0, z_deg=0.0):
    return cv2.Rodrigues(np.radians([x_deg, y_deg, z_deg]))[0]


def room(rotation=None, axes=(0, 1, 2), seed=0) -> LineSegments:
    """Return far segments along the axes of a frame, 14 of each, seen by a rotated camera."""
    rotation = np.eye(3) if rotation is None else rotation
    rng = np.random.default_rng(seed)
    start = rng.uniform([-1.6, -1.2, 4.0], [1.6, 1.2, 6.0], (14 * len(axes), 3))
    ends = np.stack([start, start + np.repeat(0.5 * FRAME[list(axes)], 14, axis=0)], axis=1)
    ends = ends @ rotation.T
    ends_px = ends[..., :2] / ends[..., 2:] * 500 + [319.5, 239.5]
    return segments_from_pixels(ends_px, CAMERA)


def nothing() -> LineSegments:
    return segments_from_pixels(np.zeros((0, 2, 2)), CAMERA)


def every(images, log_turned=TAKEN_AS_UPRIGHT):
    """Return the directions of these images, found one after another."""
    found, last = [], None
    for segments in images:
        expected, view = Expected(), first_view(segments)
        if last is not None:
            expected, view = carried(expected, last, segments, None)
        found.append(find_directions(
            segments, collect_evidence(segments, log_turned=log_turned), expected))
        last = Step(segments, None, found[-1], view, None)
    return found


def walk(images):
    return every(images)[-1]


@pytest.mark.parametrize('angles', [(0.5, 0, 0), (0, -1.0, 0), (0, 0, 2.0), (1.0, 0.5, -1.0)])
def test_the_turn_of_the_lines_is_that_of_the_camera(angles):
    found, share = turn_between_images(room(), room(turn(*angles)))
    assert found == pytest.approx(np.radians(angles), abs=2e-3)
    assert share > 0.85


def test_lines_with_other_motion_do_not_count():
    after = room(turn(0, 1.0, 0))
    ends_px = after.ends_px.copy()
    ends_px[:8] += [12.0, 9.0]
    found, share = turn_between_images(room(), segments_from_pixels(ends_px, CAMERA))
    assert np.degrees(found) == pytest.approx([0, 1.0, 0], abs=0.1)
    assert share < 0.9


def test_other_views_have_no_known_turn():
    assert turn_between_images(room(), room(turn(0, 0, 60), seed=1))[1] < 0.2
    assert turn_between_images(room(), nothing())[1] == 0


def test_flicker_of_a_still_camera_is_averaged():
    images = [segments_from_pixels(
        room().ends_px + np.random.default_rng(k).normal(0, 0.5, (42, 2, 2)), CAMERA)
        for k in range(30)]
    alone, averaged = ([angle_deg(one.gravity_camera, FRAME[0]) for one in found] for found in (
        [find_directions(image) for image in images], every(images)))
    assert np.mean(averaged[5:]) < 0.8 * np.mean(alone[5:])


def test_the_same_image_again_proves_nothing():
    posts = room(axes=(0,))
    alone = find_directions(posts)
    assert alone.gravity_camera is None
    assert walk([posts] * 20).probability < MIN_PROBABILITY


def test_swinging_between_two_views_proves_nothing():
    """A view may count twice, as long as the camera is back in it, but never more often."""
    swings = [room(turn(0, angle_deg, 0), axes=(1, 2)) for angle_deg in 5 * (0, 4, 8, 4)]
    probabilities = [found.probability for found in every(swings)]
    assert max(probabilities[8:]) <= max(probabilities[4:8]) + 1e-9


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_a_camera_turns_about_its_vertical(axis):
    """Where the mounting is open, turning about a level axis leaves the vertical open."""
    rotations = [cv2.Rodrigues(np.radians(2.0 * k) * FRAME[axis])[0] for k in range(
        16 if axis else 24)]
    found = every([room(rotation) for rotation in rotations], log_turned=np.zeros(4))
    assert found[0].gravity_camera is None
    if axis:
        assert found[-1].probability < found[0].probability
    else:
        assert angle_deg(found[-1].gravity_camera, rotations[-1] @ FRAME[0]) < 0.5


def test_the_vertical_is_likely_in_proportion_to_the_turning_about_it():
    about = np.diag(likelihood_of_turning(np.diag([0.5, 0.3, 0.2]) * 1e6))
    assert about == pytest.approx([0.5, 0.3, 0.2], abs=1e-4)
    assert np.diag(likelihood_of_turning(np.zeros((3, 3)))) == pytest.approx(1 / 3)


def test_a_turning_camera_does_not_lag():
    rotations = [turn(1.5 * k, 0, 0) for k in range(10)]
    found = walk([room(rotation) for rotation in rotations])
    assert angle_deg(found.gravity_camera, rotations[-1] @ FRAME[0]) < 0.3


def test_images_that_leave_it_open_are_answered_by_those_before():
    """Of the views before: of the same view the lines would be counted twice."""
    rotations = [turn(2 * k, 0, 0) for k in range(6)]
    images = [room(rotation) for rotation in rotations] + [room(rotations[-1], axes=(0,))]
    found = walk(images)
    assert find_directions(images[-1]).gravity_camera is None
    assert angle_deg(found.gravity_camera, rotations[-1] @ FRAME[0]) < 0.5


def test_a_wrong_start_is_forgotten():
    wrong = turn(0, 0, 12)
    images = [room(wrong, seed=k) for k in range(5)] + [room(seed=k) for k in range(5, 10)]
    assert angle_deg(walk(images[:5]).gravity_camera, wrong @ FRAME[0]) < 1
    assert angle_deg(walk(images).gravity_camera, FRAME[0]) < 1


def test_an_image_without_lines_is_not_answered():
    assert walk([room(), nothing()]).gravity_camera is None


def test_level_axes_are_held_by_a_still_camera_only():
    level, posts = room(), room(axes=(0,))
    both = segments_from_pixels(np.concatenate([level.ends_px, posts.ends_px]), CAMERA)
    assert len(walk([both, both]).pairs) == 1
    assert not len(walk([both, room(turn(0, 60.0, 0), axes=(0,), seed=1)]).pairs)


def test_the_turn_of_corner_points_is_that_of_the_camera():
    """Between images that are too far apart for lines."""
    grey = cv2.resize(np.random.default_rng(0).integers(0, 256, (60, 80)).astype(np.uint8),
                      (320, 240), interpolation=cv2.INTER_CUBIC)
    matrix = np.array([[250.0, 0, 159.5], [0, 250.0, 119.5], [0, 0, 1]])
    rotation = turn(3.0, 8.0, -5.0)
    after = cv2.warpPerspective(grey, matrix @ rotation @ np.linalg.inv(matrix), (320, 240))
    camera = CameraIntrinsics(250.0, 250.0, 159.5, 119.5, 320, 240)
    found, share = turn_between_points(ImagePoints(grey, camera), ImagePoints(after, camera))
    assert angle_deg(cv2.Rodrigues(found)[0] @ [0, 0, 1], rotation @ [0, 0, 1]) < 0.3
    assert share > 0.8
    other = np.random.default_rng(1).integers(0, 256, (240, 320)).astype(np.uint8)
    assert turn_between_points(ImagePoints(grey, camera), ImagePoints(other, camera))[1] == 0


def test_a_sharp_direction_decides_between_axes():
    known = find_directions(room(), expected=Expected(FRAME[1], 1.0))
    assert angle_deg(known.gravity_camera, FRAME[1]) < 0.5
