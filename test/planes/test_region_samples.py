# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of samples of pixels and planes with given normals."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector.geometry.projection import pixel_rays
from plane_detector.planes.region_samples import sample_regions
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.types import CameraIntrinsics, Plane

CAMERA = CameraIntrinsics(80.0, 80.0, 79.5, 59.5, 160, 120)
FLOOR, WALL = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])


def wall_and_floor():
    """Return samples of a wall 4 m ahead above row 90 and of a floor 1.5 m below the camera."""
    labels = np.zeros((120, 160), np.int32)
    labels[90:] = 1
    y = pixel_rays(CAMERA)[1][:, None]
    disparity = np.where(labels == 1, y / 1.5, 0.25).astype(np.float32)
    grid = build_cell_grid(DisparityImage(disparity, np.ones((120, 160), bool)))
    planes = tuple(Plane(normal, offset_m, -offset_m * normal, 1, 0.0, 1.0, np.zeros((4, 4)), 1.0)
                   for normal, offset_m in ((WALL, 4.0), (FLOOR, 1.5)))
    regions = PixelRegions(disparity, labels, np.zeros((2, 3)), grid, Noise(0.001))
    return sample_regions(regions, planes, CAMERA)


def test_distances_of_the_own_normals():
    assert wall_and_floor().offsets(np.stack([WALL, FLOOR])) == pytest.approx([4.0, 1.5])


def test_distances_are_averaged_in_inverse_depth():
    samples = wall_and_floor()
    is_odd = np.arange(len(samples.region)) % 4 == 0
    noisy = replace(samples, disparity=samples.disparity * np.where(is_odd, 2.0, 1.0))
    offsets = noisy.offsets(np.stack([WALL, FLOOR]))
    assert offsets[0] == pytest.approx(4.0 / 1.25, rel=0.01)


def test_a_plane_seen_edge_on_has_no_distance():
    offsets = wall_and_floor().offsets(np.stack([FLOOR, FLOOR]))
    assert np.isnan(offsets[0]) and offsets[1] == pytest.approx(1.5)


def test_depth_that_another_normal_changes():
    tilt = np.radians(10)
    leaning = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    change = wall_and_floor().depth_change(np.stack([[WALL, leaning, FLOOR], [FLOOR] * 3]))
    assert change[0, 0] == 0 and (change[1] == 0).all()
    # The wall is seen from y = -0.74 to 0.37: about half of that times the tangent.
    assert change[0, 1] == pytest.approx(np.tan(tilt) * 1.1 / np.sqrt(12), rel=0.15)
    assert change[0, 2] > 1


def test_joined_regions_have_one_distance():
    joined = wall_and_floor().joined(np.array([0, 0]))
    offsets = joined.offsets(np.stack([WALL, WALL]))
    assert 2.0 < offsets[0] <= 4.0 and np.isnan(offsets[1])


def test_distances_of_regions_to_planes():
    samples = wall_and_floor()
    distance = samples.distances_to_planes(np.stack([WALL, FLOOR, WALL]),
                                           np.array([4.0, 1.5, np.nan]))
    assert distance[0, 0] == pytest.approx(0, abs=1e-6)
    assert distance[1, 1] == pytest.approx(0, abs=1e-6)
    assert distance[0, 1] > 0.5 and np.isinf(distance[:, 2]).all()
    # A wall twice as far has twice the depth.
    farther = samples.distances_to_planes(WALL[None], np.array([8.0]))
    assert farther[0, 0] == pytest.approx(np.log(2))


def test_regions_cover_shares_of_the_image():
    assert wall_and_floor().image_shares == pytest.approx([0.75, 0.25], abs=0.02)
    assert wall_and_floor().joined(np.array([0, 0])).image_shares == pytest.approx([1, 0])
