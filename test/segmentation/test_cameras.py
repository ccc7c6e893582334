# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cameras other than VGA with 64 degrees: small images, long and short lenses, off centre."""

import numpy as np
import pytest

from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.pipeline import segment_planes
from plane_detector.types import CameraIntrinsics

CAMERAS = {'0.3 w': (192, 192, 319.5), '2 w': (1280, 1280, 319.5), '4 w': (2560, 2560, 319.5),
           'fx is not fy': (512, 768, 319.5), 'off centre': (1280, 800, 447.5)}


def two_walls(camera, angle_deg):
    """Return the depth of two walls that meet at an angle in the middle column, 2 m ahead."""
    ray = (np.arange(camera.width) - camera.cx) / camera.fx
    middle = ((camera.width - 1) / 2 - camera.cx) / camera.fx
    slope = np.sign(ray - middle) * np.tan(np.radians(angle_deg / 2))
    depth_m = 2.0 * (1 - slope * middle) / (1 - slope * ray)
    return np.tile(depth_m.astype(np.float32), (camera.height, 1))


@pytest.mark.parametrize('name', CAMERAS)
def test_walls_are_two_from_the_same_angle_on_for_every_lens(name):
    fx, fy, cx = CAMERAS[name]
    camera = CameraIntrinsics(fx, fy, cx, 239.5, 640, 480)
    assert len(segment_planes(two_walls(camera, 5.0), camera).planes) == 2
    assert len(segment_planes(two_walls(camera, 1.0), camera).planes) == 1


@pytest.mark.parametrize('width, height', [(64, 48), (80, 60), (96, 72), (100, 76)])
def test_rooms_in_small_images(width, height):
    camera = CameraIntrinsics.from_field_of_view(width, height, 60.0)
    covering = []
    for seed in range(6):
        scene = random_room(np.random.default_rng(seed), camera)
        found = segment_planes(scene.depth_m.astype(np.float32), camera)
        planes = np.array([[*plane.normal, plane.offset_m] for plane in found.planes])
        covering.append(score(scene.labels, scene.planes, found.labels, planes,
                              np.isfinite(scene.depth_m)).segmentation_covering)
    assert min(covering) > 0.9


def test_depth_of_every_second_row_is_as_good_as_all():
    camera = CameraIntrinsics.from_field_of_view(640, 480, 60.0)
    depth_m = two_walls(camera, 40.0)
    sparse = depth_m.copy()
    sparse[(np.arange(480) // 4) % 2 == 1] = np.nan  # the middle rows of all cells
    found = segment_planes(sparse, camera)
    assert len(found.planes) == 2
    whole = segment_planes(depth_m, camera)
    for one, other in zip(found.planes, whole.planes, strict=True):
        assert np.degrees(np.arccos(min(abs(one.normal @ other.normal), 1.0))) < 0.02
