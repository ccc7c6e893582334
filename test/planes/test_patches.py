# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Pixels on no plane take the plane of most of their patch, if their depth allows it."""

import numpy as np
import pytest

from plane_detector.planes.patches import fill_patches
from plane_detector.types import NO_PLANES, CameraIntrinsics, Plane, Planes

CAMERA = CameraIntrinsics.from_field_of_view(42, 30, 60.0)
SHAPE = (CAMERA.height, CAMERA.width)


def wall(distance_m):
    return Plane(np.array([0, 0, -1.0]), distance_m, np.array([0, 0, distance_m]), 9, 0.0, 1.0,
                 np.eye(4), 1.0)


def two_walls():
    """Return patches, walls at 2 and 3 m on the left and right half, labels and depth of these."""
    patches = np.ones((8, 11), np.int32)
    patches[:, 5:] = 2
    labels = np.zeros(SHAPE, np.int32)
    labels[:, 20:] = 1
    return patches, Planes.of([wall(2.0), wall(3.0)]), labels, np.where(labels == 0, 2.0, 3.0)


def test_a_hole_takes_the_plane_of_its_own_patch():
    patches, planes, labels, depth_m = two_walls()
    given = labels.copy()
    given[10:20, 10:30] = -1
    filled = fill_patches(given, patches, planes, 1.1 * depth_m, CAMERA)
    np.testing.assert_array_equal(filled, labels)
    assert (given[10:20, 10:30] == -1).all()


@pytest.mark.parametrize(('hole', 'depth_m', 'is_shape', 'is_patch'), [
    (np.s_[10:20, 5:15], 1.4, False, True), (np.s_[10:20, 5:15], 2.6, False, True),
    (np.s_[10:20, 5:15], np.nan, False, True),  # another surface
    (np.s_[:, 4:20], 2.0, False, True), (np.s_[:, 4:20], 2.0, True, True),  # most of the patch
    (np.s_[8:20, :10], 2.0, False, False)])
def test_what_is_of_another_surface_or_of_no_patch_is_not_filled(hole, depth_m, is_shape,
                                                                 is_patch):
    patches, planes, labels, depths_m = two_walls()
    labels[hole], depths_m[hole] = -1, depth_m
    shape_labels = np.where((labels < 0) & is_shape, 0, -1).astype(np.int32)
    patches[2:5] *= is_patch
    np.testing.assert_array_equal(
        fill_patches(labels, patches, planes, depths_m, CAMERA, shape_labels), labels)


def test_a_shape_in_the_patch_of_a_wall_is_not_filled():
    patches, planes, labels, depths_m = two_walls()
    labels[10:20, 2:10] = -1
    shape_labels = np.full(SHAPE, -1, np.int32)
    shape_labels[10:20, 2:6] = 0
    filled = fill_patches(labels, patches, planes, depths_m, CAMERA, shape_labels)
    np.testing.assert_array_equal(filled == -1, shape_labels == 0)


def test_without_planes_the_labels_are_returned():
    patches, planes, labels, depths_m = two_walls()
    assert fill_patches(labels, patches, NO_PLANES, depths_m, CAMERA) is labels


@pytest.mark.parametrize('tilt', [(0.75, 0.0), (0.0, 0.75), (0.5, 0.5)])
def test_the_depth_of_a_slanted_plane_is_that_of_its_rays(tilt):
    camera = CameraIntrinsics(30.0, 60.0, 33.0, 8.0, 42, 30)
    normal = -np.array([*tilt, np.sqrt(1 - tilt[0]**2 - tilt[1]**2)])
    v, u = np.mgrid[0:30, 0:42]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(SHAPE)], -1)
    depth_m = -2.0 / (rays @ normal)
    plane = Plane(normal, 2.0, -2.0 * normal, 9, 0.0, 1.0, np.eye(4), 1.0)
    labels = np.zeros(SHAPE, np.int32)
    labels[::3, ::5] = labels[1::3, 2::5] = -1
    labels[:, 0] = labels[:, -1] = -1
    is_seen = depth_m > 0
    filled = fill_patches(labels, np.ones((8, 11), np.int32), Planes.of([plane]),
                          np.where(is_seen, depth_m, np.nan), camera)
    assert (filled[is_seen] == 0).all()
    assert (filled[~is_seen & (labels < 0)] == -1).all()
