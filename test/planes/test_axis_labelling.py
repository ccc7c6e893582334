# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of cells labelled anew by planes of known orientation."""

import numpy as np
import pytest

from plane_detector.geometry.projection import pixel_rays
from plane_detector.planes.axis_labelling import Hypotheses, label_along_axes
from plane_detector.planes.measurement import measure_planes
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(160.0, 160.0, 159.5, 119.5, 320, 240)
AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NONE = Hypotheses(np.zeros((0, 3)), np.zeros(0))


def corner(tilt_deg=0.0, step=0.0):
    """Return 1/z of a floor 1 m below the camera and a wall 3 m ahead, and which is which."""
    ray_x, ray_y = np.meshgrid(*pixel_rays(CAMERA))
    wall = (1 + np.tan(np.radians(tilt_deg)) * ray_x) / np.where(ray_x > 0.2, 3.0 - step, 3.0)
    return np.maximum(ray_y, wall).astype(np.float32), (ray_y < wall).astype(int)


def planes_of(disparity, others=NONE):
    """Label regions of which nothing is known but the depth."""
    grid = build_cell_grid(DisparityImage(disparity, np.ones(disparity.shape, bool)))
    regions = PixelRegions(disparity, np.full(disparity.shape, -1, np.int32), np.zeros((0, 3)),
                           grid, Noise(0.001))
    return measure_planes(label_along_axes(regions, AXES, others, CAMERA), CAMERA, 200)


def test_a_floor_and_a_wall_are_found_by_the_axes_alone():
    disparity, true = corner()
    planes, labels = planes_of(disparity)
    assert len(planes) == 2
    wall = int(np.argmax([abs(plane.normal[2]) for plane in planes]))
    assert planes[wall].offset_m == pytest.approx(3.0, rel=0.01)
    assert planes[1 - wall].offset_m == pytest.approx(1.0, rel=0.01)
    assert ((labels == wall) == true).mean() > 0.99


def test_a_wall_that_the_network_tilts_is_one_plane_across_its_axis():
    planes, labels = planes_of(corner(tilt_deg=20.0)[0])
    walls = [plane for plane in planes if abs(plane.normal[2]) > 0.999]
    assert len(walls) == 1 and len(planes) <= 3
    assert walls[0].inlier_count > 0.35 * labels.size


def test_walls_behind_each_other_stay_two():
    planes, _ = planes_of(corner(step=0.8)[0])
    offsets = sorted(plane.offset_m for plane in planes if abs(plane.normal[2]) > 0.999)
    assert offsets == pytest.approx([2.2, 3.0], rel=0.02)


def test_a_roof_found_before_keeps_most_of_its_place():
    disparity = corner()[0]
    normal = np.array([0.0, np.sin(0.9), -np.cos(0.9)])
    ray_x, ray_y = np.meshgrid(*pixel_rays(CAMERA))
    roof = -(normal[1] * ray_y + normal[2]) / 2.2
    disparity = np.maximum(disparity, roof).astype(np.float32)
    is_roof = disparity == roof.astype(np.float32)
    planes, labels = planes_of(disparity, Hypotheses(normal[None], np.log([2.2])))
    cosine = [plane.normal @ normal for plane in planes]
    assert max(cosine) > 0.999
    assert ((labels == int(np.argmax(cosine))) == is_roof).mean() > 0.85


def test_invalid_pixels_have_no_plane():
    disparity = corner()[0]
    disparity[50:90, 100:160] = 0
    assert (planes_of(disparity)[1][50:90, 100:160] == -1).all()
