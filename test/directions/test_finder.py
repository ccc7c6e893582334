# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the directions of consecutive images."""

import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.directions.finder import CameraImage, DirectionFinder, find_in_image
from plane_detector.evaluation.scenes.rooms import attic, hexagon_room, random_room
from plane_detector.evaluation.scenes.textures import rolled_room, textured

IMAGES, GREY_LEVELS = 12, 5.0
FLICKER_DEG = 0.5


@pytest.mark.parametrize(('make', 'seed'), [
    (random_room, 300), (hexagon_room, 305), (rolled_room, 303)])
def test_the_upright_of_a_still_camera_does_not_flicker(make, seed):
    scene, finder = textured(make, seed), DirectionFinder()
    rng = np.random.default_rng(0)
    found = []
    for _ in range(IMAGES):
        noise = rng.normal(0, GREY_LEVELS, scene.rgb.shape)
        rgb = np.clip(scene.rgb + noise, 0, 255).astype(np.uint8)
        around = finder.find(CameraImage(rgb, scene.intrinsics), None, Config(),
                             for_planes=True)
        found.append(around.gravity.gravity_camera)
    cosine = np.array(found) @ np.array(found).T
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < FLICKER_DEG


@pytest.mark.parametrize('seed', [303, 304, 313])
def test_the_slopes_of_a_roof_do_not_outvote_floor_and_gable(seed):
    scene = textured(attic, seed)
    image = CameraImage(scene.rgb, scene.intrinsics, disparity=1 / scene.depth_m)
    found = find_in_image(image).directions
    assert found.gravity_camera @ scene.gravity_camera > np.cos(np.radians(1.0))
