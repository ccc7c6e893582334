# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the line segments."""

import cv2
import numpy as np
import pytest

from plane_detector.directions.line_segments import (
    detect_line_segments,
    reduced_grey,
    segments_from_pixels,
)
from plane_detector.directions.lsd import find_segments
from plane_detector.directions.surfaces import surface_normals
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)


def found_in(rgb, camera=CAMERA, covered=None):
    return detect_line_segments(reduced_grey(rgb), camera, covered)


def half_plane(start, end):
    """Return an image that is bright on one side of the line through two points, smooth edged."""
    v, u = np.mgrid[0:480, 0:640]
    normal = np.array([end[1] - start[1], start[0] - end[0]]) / np.hypot(*np.subtract(end, start))
    distance = (u - start[0]) * normal[0] + (v - start[1]) * normal[1]
    grey = 60 + 120 / (1 + np.exp(-np.clip(2 * distance, -50, 50)))
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize('ends', [((100, 400), (500, 60)), ((200, 0), (220, 479))])
def test_an_edge_is_found_to_a_fraction_of_a_pixel(ends):
    found = found_in(half_plane(*ends)).ends_px[0]
    along = np.subtract(ends[1], ends[0]) / np.hypot(*np.subtract(ends[1], ends[0]))
    off_px = (found - ends[0]) @ [along[1], -along[0]]
    assert np.abs(off_px).max() < 0.6


def test_segments_are_in_units_of_the_focal_length():
    segments = segments_from_pixels(np.array([[[319.5, 239.5], [569.5, 239.5]]]), CAMERA)
    assert segments.lengths == pytest.approx(0.5)
    assert segments.midpoints[0] == pytest.approx([0.25, 0, 1])
    assert np.abs(segments.tangents[0]) == pytest.approx([1, 0])
    # A level segment through the principal point lies in the plane y = 0.
    assert np.abs(segments.normals[0]) == pytest.approx([0, 1, 0])


def test_a_flat_image_has_none():
    assert len(found_in(np.full((480, 640, 3), 90, np.uint8))) == 0


def test_the_border_of_the_image_is_no_line_of_the_scene():
    image = np.full((480, 640, 3), 255, np.uint8)
    cv2.rectangle(image, (9, 9), (630, 470), (60, 60, 60), -1)
    assert len(found_in(image)) == 0


def test_segments_are_sorted_by_length_without_short_ones():
    image = np.full((480, 640, 3), 60, np.uint8)
    for length, row in ((20, 60), (200, 200), (400, 340)):
        cv2.rectangle(image, (100, row), (100 + length, row + 40), (200, 200, 200), -1)
    lengths_px = found_in(image).lengths * CAMERA.fx
    assert (np.diff(lengths_px) < 0.01).all()
    assert lengths_px[0] == pytest.approx(400, abs=10)
    assert lengths_px[-1] >= 0.05 * 640


def test_lines_along_the_border_of_the_covered_area_are_dropped():
    image = np.zeros((480, 640, 3), np.uint8)
    covered = np.zeros((480, 640), bool)
    covered[100:400, 120:520] = True
    image[covered] = 150
    assert len(found_in(image)) > 0
    assert len(found_in(image, CAMERA, covered)) == 0
    cv2.rectangle(image, (250, 200), (400, 300), (40, 40, 40), -1)
    assert len(found_in(image, CAMERA, covered)) >= 4


@pytest.mark.parametrize('width, height, normals', [
    (4000, 3, 0), (5000, 10, 0), (3, 4000, 3998), (5, 2, 0)])
def test_an_image_of_a_few_rows_or_columns_gives_no_error(width, height, normals):
    camera = CameraIntrinsics(1000.0, 1000.0, width / 2, height / 2, width, height)
    rgb = np.full((height, width, 3), 90, np.uint8)
    assert len(found_in(rgb, camera)) == 0
    assert len(surface_normals(np.ones((height, width), np.float32), camera)[0]) == normals


@pytest.mark.parametrize('seed', [300, 301, 302])
def test_long_segments_are_those_of_opencv(seed):
    grey = reduced_grey(textured(rooms.random_room, seed).rgb)
    own = find_segments(grey)
    other = cv2.createLineSegmentDetector().detect(grey)[0].reshape(-1, 4)
    for first, second in ((own, other), (other, own)):
        long = first[np.hypot(*(first[:, 2:] - first[:, :2]).T) > 16]
        off_px = np.abs(long[:, None] - second).max(axis=2).min(axis=1)
        assert len(long) > 20
        assert np.mean(off_px < 1.5) > 0.95


@pytest.mark.parametrize('turn_deg', range(0, 360, 24))
def test_both_ends_of_a_bar_are_found_at_any_angle(turn_deg):
    turn = np.radians(turn_deg)
    along, across = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corners = [[160, 120] + x * along + y * across for x, y in (
        (-80, -20), (80, -20), (80, 20), (-80, 20))]
    grey = np.full((240, 320), 60, np.uint8)
    cv2.fillConvexPoly(grey, np.rint(16 * np.array(corners)).astype(np.int32), 190, cv2.LINE_AA, 4)
    found = find_segments(grey).reshape(-1, 2, 2) - [160, 120]
    # Each long side once, from one end to the other: bright on its left, so against each other.
    for side, sign in ((20, 1), (-20, -1)):
        ends = sign * np.array([[-80, 80], [0, 0]]).T @ [along, across] + side * across
        off_px = np.linalg.norm(found - ends, axis=2).max(axis=1)
        assert np.count_nonzero(off_px < 3) == 1


def test_noise_has_no_long_segments():
    grey = np.random.default_rng(0).integers(0, 256, (240, 320), dtype=np.uint8)
    found = find_segments(grey)
    assert (np.hypot(*(found[:, 2:] - found[:, :2]).T) < 25).all()


@pytest.mark.parametrize('shape', [(1, 1), (2, 2), (1, 300), (300, 1), (3, 320)])
def test_an_image_without_room_for_a_segment_has_none(shape):
    checks = (255 * (np.indices(shape).sum(0) % 2)).astype(np.uint8)
    assert find_segments(checks).shape[1] == 4
    assert len(find_segments(np.full(shape, 90, np.uint8))) == 0
