# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The outlines of a plane's pixels, and the rectangle around them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.pipeline import segment_planes
from plane_detector.planes.outline import all_polygons, enclosing_rectangles, row_ends
from plane_detector.types import CameraIntrinsics, Plane, Planes

CAMERA = CameraIntrinsics(100.0, 120.0, 40.0, 50.0, 100, 80)
WALL, LEANING = (Plane(np.array(normal), 2.0, np.array([0.1, 0.0, 2.0]), 2500, 0.0, 1.0,
                       np.eye(4), 1.0) for normal in ((0.0, 0.0, -1.0), (0.48, -0.36, -0.8)))


def in_pixels(corners_m):
    return corners_m[:, :2] / corners_m[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)


def outlines(mask, plane=WALL):
    """Return the corners in pixels of each outline of a mask, and which are holes."""
    labels = np.where(mask, 0, -1).astype(np.int32)
    found, = all_polygons(labels, row_ends(labels, 1), CAMERA, Planes.of([plane]))
    for polygon in found:
        assert np.abs(polygon.corners_m @ plane.normal + plane.offset_m).max() < 1e-9
    corners = [{(round(u), round(v)) for u, v in in_pixels(polygon.corners_m)}
               for polygon in found]
    return corners, [polygon.is_hole for polygon in found]


@pytest.mark.parametrize('plane', [WALL, LEANING])
def test_an_l_shaped_outline_is_preserved(plane):
    mask = np.zeros((80, 100), bool)
    mask[10:70, 10:30] = mask[50:70, 10:90] = True
    (corners,), _ = outlines(mask, plane)
    for corner in ((10, 10), (29, 10), (89, 69), (10, 69), (89, 50)):
        assert corner in corners
    assert any(abs(u - 29) <= 2 and abs(v - 50) <= 2 for u, v in corners), 'the inner corner'
    assert len(corners) <= 8


def test_polygons_have_holes_and_all_patches_the_largest_first():
    mask = np.zeros((80, 100), bool)
    mask[70:75, 80:95] = mask[10:60, 10:60] = True
    mask[20:50, 20:50] = False
    corners, is_hole = outlines(mask)
    assert is_hole == [False, True, False]
    assert corners[0] == {(10, 10), (10, 59), (59, 59), (59, 10)}
    assert corners[1] >= {(19, 20), (50, 20)} or len(corners[1]) >= 4
    assert corners[2] == {(80, 70), (80, 74), (94, 74), (94, 70)}


def test_what_is_smaller_than_the_tolerance_squared_has_no_outline():
    mask = np.zeros((80, 100), bool)
    mask[10:60, 10:60] = mask[70:76, 20:26] = True
    mask[70:78, 80] = mask[77, 80:88] = True  # a pixel wide: no area between its pixels
    assert [len(corners) for corners in outlines(mask)[0]] == [4, 4]


def corners_on(plane, mask, camera):
    """Return where the rays of the corners of pixels meet a plane, (N, 3)."""
    v, u = np.nonzero(mask)
    around = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    corners_px = (np.stack([u, v], axis=1)[:, None] + around).reshape(-1, 2)
    rays = np.ones((len(corners_px), 3))
    rays[:, :2] = (corners_px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return rays * (plane.offset_m / -(rays @ plane.normal))[:, None]


@pytest.mark.parametrize('plane', [WALL, LEANING])
def test_the_rectangle_is_the_smallest_around_the_corners_of_all_pixels(plane):
    rng = np.random.default_rng(0)
    for _ in range(50):
        labels = np.full((80, 100), -1, np.int32)
        cv2.fillPoly(labels, [rng.integers(0, (100, 80), (5, 2)).astype(np.int32)], 0)
        labels[rng.random(labels.shape) < 0.5] = -1
        corners_m = corners_on(plane, labels == 0, CAMERA)
        plane = replace(plane, centroid_m=corners_m.mean(axis=0))
        found, = enclosing_rectangles(row_ends(labels, 1), CAMERA, Planes.of([plane]))
        flat_m = (np.vstack([corners_m, plane.centroid_m]) - found.centre_m) @ found.rotation
        half_m = np.array([found.width_m, found.height_m, 0]) / 2
        assert (abs(flat_m) <= half_m + 1e-9).all()
        assert np.abs(flat_m[:, :2]).max(axis=0) == pytest.approx(half_m[:2])
        _, expected_m, _ = cv2.minAreaRect(flat_m[:, :2].astype(np.float32))
        assert found.width_m * found.height_m == pytest.approx(np.prod(expected_m), rel=1e-4)
        assert found.width_m >= found.height_m
        np.testing.assert_allclose(found.rotation[:, 2], plane.normal)
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_a_plane_without_pixels_has_a_rectangle_without_size():
    labels = np.full((80, 100), -1, np.int32)
    found, = enclosing_rectangles(row_ends(labels, 1), CAMERA, Planes.of([LEANING]))
    assert (found.width_m, found.height_m) == (0, 0)
    np.testing.assert_allclose(found.centre_m, LEANING.centroid_m)


def test_a_plane_seen_edge_on_has_finite_corners():
    floor = Plane(np.array([0.0, -1.0, 0.0]), 1.5, np.zeros(3), 1, 0.0, 1.0, np.eye(4), 1.0)
    labels = np.zeros((80, 100), np.int32)
    polygon, = all_polygons(labels, row_ends(labels, 1), CAMERA, Planes.of([floor]))[0]
    assert np.abs(polygon.corners_m @ floor.normal + floor.offset_m).max() < 1e-9
    assert np.abs(polygon.corners_m).max() < 100 * floor.offset_m


@pytest.mark.parametrize('camera', [CameraIntrinsics(210.0, 305.0, 125.0, 150.0, 320, 240),
                                    CameraIntrinsics(96.0, 96.0, 159.5, 119.5, 320, 240),
                                    CameraIntrinsics(640.0, 640.0, 159.5, 119.5, 320, 240)])
@pytest.mark.parametrize('sigma', [0.0, 0.01])
def test_areas_are_those_of_the_pixels_and_within_the_rectangle(sigma, camera):
    """Of each pixel the part of the plane between its corners, by the lengths of its sides."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        scene = random_room(rng, camera)
        found = segment_planes(with_disparity_noise(scene.depth_m, sigma, rng), camera)
        rectangles = enclosing_rectangles(row_ends(found.labels, len(found.planes)), camera,
                                          found.planes)
        assert len(found.planes) >= 3
        for k, (plane, rectangle) in enumerate(zip(found.planes, rectangles, strict=True)):
            v, u = np.nonzero(found.labels == k)
            x = (u[:, None] + [-0.5, 0.5, 0.5, -0.5] - camera.cx) / camera.fx
            y = (v[:, None] + [-0.5, -0.5, 0.5, 0.5] - camera.cy) / camera.fy
            rays = np.stack([x, y, np.ones_like(x)], axis=-1)
            points_m = rays * (plane.offset_m / -(rays @ plane.normal))[..., None]
            diagonals_m = points_m[:, 2:] - points_m[:, :2]
            pixels_m2 = np.linalg.norm(np.cross(diagonals_m[:, 0], diagonals_m[:, 1]), axis=1) / 2
            assert plane.area_m2 == pytest.approx(pixels_m2.sum(), rel=2e-3)
            assert plane.area_m2 < 1.001 * rectangle.width_m * rectangle.height_m
