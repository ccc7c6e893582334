# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Normals of a network in the search, in merging and where it bends walls."""

import numpy as np
import pytest
from cell_helpers import disparity_image, fold, view, wall

from plane_detector.config import Config
from plane_detector.geometry.projection import depth_to_points
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.normal_slopes import NormalMap, slopes_of
from plane_detector.segmentation.segment import segment, unitless_noise_floor
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(262.5, 250.0, 149.5, 125.5, 320, 240)
SIGMA = 0.004


def normals_of(scene, spread_deg=0.0):
    """Return the true normals of a scene, each turned by a random angle."""
    normals = np.full((*scene.labels.shape, 3), np.nan, np.float32)
    for k, plane in enumerate(scene.planes):
        normals[scene.labels == k] = plane[:3]
    spread = np.radians(spread_deg) * np.random.default_rng(0).normal(size=normals.shape)
    normals += spread.astype(np.float32)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return NormalMap(normals, None, scene.intrinsics)


def bent(scene, softness=0.02):
    """Return the disparity that a network makes of walls that meet: the edge becomes a bend."""
    directions = depth_to_points(np.ones(scene.depth_m.shape), scene.intrinsics)
    planes = [-(directions @ plane[:3]) / plane[3] for plane in scene.planes]
    return (-softness * np.log(sum(np.exp(-plane / softness) for plane in planes))).astype(
        np.float32)


def planes_found(disparity, normals):
    floor = unitless_noise_floor(disparity, SIGMA)
    labels = segment(disparity, floor, Config(), normals=normals).labels
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    return int((sizes > 0.05 * labels.size).sum()), labels


def test_the_slopes_of_exact_normals_are_those_of_exact_depth():
    scene = view(fold(25, 20.0), intrinsics=CAMERA)
    grid = build_cell_grid(disparity_image(scene.depth_m))
    whole = grid.usable & (grid.residual_rms < 1e-6)
    np.testing.assert_allclose(slopes_of(grid, normals_of(scene))[whole], grid.slope[whole],
                               atol=1e-4)
    assert whole.mean() > 0.9


@pytest.mark.parametrize(('angle_deg', 'spread_deg'), [(15, 0), (20, 10), (25, 10)])
def test_normals_keep_two_walls_apart_that_depth_has_made_one(angle_deg, spread_deg):
    scene = view(fold(angle_deg, 20.0), intrinsics=CAMERA)
    disparity = bent(scene)
    assert planes_found(disparity, None)[0] == 1
    count, labels = planes_found(disparity, normals_of(scene, spread_deg))
    assert count == 2
    for k in range(2):
        assert np.bincount(labels[scene.labels == k] + 1).max() > 0.8 * (scene.labels == k).sum()


@pytest.mark.parametrize(('yaw_deg', 'spread_deg'), [(20, 0), (20, 10), (20, 30), (-20, 0)])
def test_normals_of_one_wall_or_of_another_room_leave_it_whole(yaw_deg, spread_deg):
    scene, other = (view([wall(2.5)], intrinsics=CAMERA, angles_deg=(yaw, 5, 0))
                    for yaw in (20, yaw_deg))
    count, labels = planes_found(bent(scene), normals_of(other, spread_deg))
    assert count == 1
    assert np.mean(labels == 0) > 0.95
