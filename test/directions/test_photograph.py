# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Which side of a photograph is down."""

import cv2
import numpy as np
import pytest

from plane_detector.directions.finder import CameraImage, find_in_image
from plane_detector.directions.line_segments import detect_line_segments, reduced_grey
from plane_detector.directions.photograph import log_likelihood, score_of_sides
from plane_detector.types import CameraIntrinsics

WIDTH, HEIGHT, HORIZON = 640, 480, 160


def lit_boxes(rng):
    """Return boxes on boards that lead into the distance, lit from above, (480, 640, 3) uint8."""
    image = np.full((HEIGHT, WIDTH, 3), (190, 190, 200), np.uint8)
    image[HORIZON:] = (120, 90, 60)
    for foot in range(-900, WIDTH + 900, 60):
        cv2.line(image, (WIDTH // 2, HORIZON), (foot, HEIGHT), (70, 50, 30), 2)
    image[:HORIZON] = (190, 190, 200)
    for _ in range(8):
        left, top = rng.integers(20, WIDTH - 160), rng.integers(HORIZON, HEIGHT - 120)
        width, height = rng.integers(60, 140), rng.integers(50, 110)
        cv2.rectangle(image, (left, top), (left + width, top + height), (90, 80, 80), -1)
        cv2.rectangle(image, (left, top - 20), (left + width, top), (230, 225, 220), -1)
    return image


def score(rgb):
    height, width = rgb.shape[:2]
    grey = reduced_grey(rgb)
    segments = detect_line_segments(
        grey, CameraIntrinsics.from_field_of_view(width, height, 60.0))
    return score_of_sides(rgb, grey, segments)


@pytest.mark.parametrize('turns', range(4))
@pytest.mark.parametrize('shrink', [1, 2])
def test_the_floor_and_what_is_dark_below_its_top_are_down(turns, shrink):
    for seed in range(5):
        rgb = lit_boxes(np.random.default_rng(seed))[::shrink, ::shrink]
        found = log_likelihood(score(np.ascontiguousarray(np.rot90(rgb, turns))))
        # Counter-clockwise, the bottom becomes the right side, then the top, then the left one.
        assert found[turns] == 0
        assert np.delete(found, turns).max() < -1


def test_a_picture_without_anything_shows_nothing():
    plain = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    assert score(plain) == pytest.approx(np.zeros(4), abs=1e-9)
    assert score(np.zeros((8, 400, 3), np.uint8)).tolist() == [0] * 4
    noise = np.random.default_rng(0).integers(0, 256, plain.shape, dtype=np.uint8)
    assert np.abs(log_likelihood(score(noise))).max() < 0.2


def test_no_picture_is_certain():
    assert log_likelihood(np.array([50.0, 0, 0, 0])).min() > np.log(1 / 100)


def test_a_picture_that_is_shown_again_proves_nothing_more():
    rgb = lit_boxes(np.random.default_rng(0))
    camera = CameraIntrinsics.from_field_of_view(WIDTH, HEIGHT, 60.0)
    image = CameraImage(rgb, camera, disparity=np.full(rgb.shape[:2], np.nan, np.float32))
    first = found = find_in_image(image)
    for _ in range(5):
        found = find_in_image(image, before=found)
    assert found.step.sides.log_likelihood_by_picture == pytest.approx(
        first.step.sides.log_likelihood_by_picture)
