# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The outlines of a plane's pixels, and the rectangle around them."""

import numpy as np
import pytest

from plane_detector.planes.outline import enclosing_rectangle, plane_polygons
from plane_detector.types import CameraIntrinsics, Plane

CAMERA = CameraIntrinsics(100.0, 100.0, 49.5, 39.5, 100, 80)
WALL = Plane(np.array([0.0, 0.0, -1.0]), 2.0, np.array([0.1, 0.0, 2.0]), 2500, 0.0, 1.0,
             np.eye(4), 1.0)


def outline_px(mask, depth_m=None):
    depth_m = np.full(mask.shape, 2.0, np.float32) if depth_m is None else depth_m
    corners_m = plane_polygons(mask, depth_m, CAMERA, WALL)[0].corners_m
    assert np.abs(corners_m @ WALL.normal + WALL.offset_m).max() < 1e-9
    u_px = corners_m[:, 0] / corners_m[:, 2] * CAMERA.fx + CAMERA.cx
    v_px = corners_m[:, 1] / corners_m[:, 2] * CAMERA.fy + CAMERA.cy
    return {(round(u), round(v)) for u, v in zip(u_px, v_px, strict=True)}


def test_an_l_shaped_outline_is_preserved():
    mask = np.zeros((80, 100), bool)
    mask[10:70, 10:30] = mask[50:70, 10:90] = True
    corners = outline_px(mask)
    for corner in ((10, 10), (29, 10), (89, 69), (10, 69), (89, 50)):
        assert corner in corners
    assert any(abs(u - 29) <= 2 and abs(v - 50) <= 2 for u, v in corners), 'the inner corner'
    assert len(corners) <= 8


def test_the_outline_of_the_largest_patch_comes_first():
    mask = np.zeros((80, 100), bool)
    mask[10:60, 10:60] = True
    mask[20:50, 20:50] = False
    mask[70:75, 80:95] = True
    assert outline_px(mask) == {(10, 10), (10, 59), (59, 59), (59, 10)}


def test_corners_of_noisy_depth_are_projected_onto_the_plane():
    mask = np.zeros((80, 100), bool)
    mask[10:60, 10:60] = True
    noisy_m = 2 + 0.1 * np.random.default_rng(0).normal(size=mask.shape).astype(np.float32)
    assert len(outline_px(mask, noisy_m)) >= 4


def test_polygons_have_holes_and_all_patches():
    mask = np.zeros((80, 100), bool)
    mask[10:60, 10:60] = True
    mask[20:50, 20:50] = False
    mask[65:75, 70:95] = True
    depth_m = np.full(mask.shape, 2.0, np.float32)
    depth_m[~mask] = np.nan
    polygons = plane_polygons(mask, depth_m, CAMERA, WALL)
    assert [polygon.is_hole for polygon in polygons] == [False, True, False]
    sizes_m = [np.ptp(polygon.corners_m, axis=0)[:2] for polygon in polygons]
    np.testing.assert_allclose(sizes_m[0], 49 * 2.0 / 100)
    np.testing.assert_allclose(sizes_m[1], 31 * 2.0 / 100)
    np.testing.assert_allclose(sizes_m[2], [24 * 2.0 / 100, 9 * 2.0 / 100])
    for polygon in polygons:
        assert np.abs(polygon.corners_m @ WALL.normal + WALL.offset_m).max() < 1e-9


def test_a_line_of_pixels_is_no_polygon():
    mask = np.zeros((80, 100), bool)
    mask[40, 10:60] = True
    assert plane_polygons(mask, np.full(mask.shape, 2.0), CAMERA, WALL) == ()


@pytest.mark.parametrize('turn_deg', [0, 20, 45, 90, 170])
@pytest.mark.parametrize('normal', [(0.0, 0.0, -1.0), (0.48, -0.6, -0.64)])
def test_the_rectangle_around_a_turned_table(turn_deg, normal):
    normal = np.array(normal)
    width_axis = np.cross(normal, [0.3, 1.0, 0.2])
    width_axis /= np.linalg.norm(width_axis)
    turn = np.radians(turn_deg)
    width_axis = np.cos(turn) * width_axis + np.sin(turn) * np.cross(normal, width_axis)
    sides = 1.6 * width_axis, 0.7 * np.cross(normal, width_axis)
    centre_m = np.array([0.2, 0.1, 3.0])
    corners_m = [centre_m + a * sides[0] + b * sides[1] for a in (-.5, .5) for b in (-.5, .5)]
    found = enclosing_rectangle(np.array(corners_m), normal, centre_m + 0.2 * sides[0])
    np.testing.assert_allclose(found.centre_m, centre_m, atol=1e-5)
    assert found.width_m == pytest.approx(1.6, abs=1e-5)
    assert found.height_m == pytest.approx(0.7, abs=1e-5)
    assert abs(found.rotation[:, 0] @ width_axis) > 1 - 1e-6
    np.testing.assert_allclose(found.rotation[:, 2], normal)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
