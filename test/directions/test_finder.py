# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the directions of consecutive images."""

import numpy as np
import pytest

from plane_detector.config import Config, RansacConfig
from plane_detector.directions import finder as finder_module
from plane_detector.directions.finder import CameraImage, DirectionFinder, Need
from plane_detector.evaluation.scenes.rooms import hexagon_room, random_room
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
        around = finder.look(CameraImage(rgb, scene.intrinsics), None, Config(), Need.PLANES)
        found.append(around.gravity.gravity_camera)
    cosine = np.array(found) @ np.array(found).T
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < FLICKER_DEG


def test_every_image_is_searched_with_the_current_seed(monkeypatch):
    scene, finder, drawn = textured(random_room, 300), DirectionFinder(), []
    search = finder_module.find_in_image

    def draw_and_search(image, rng, coarse_down):
        drawn.append(rng.bit_generator.state)
        return search(image, rng, coarse_down)
    monkeypatch.setattr(finder_module, 'find_in_image', draw_and_search)
    for seed in (0, 0, 7):
        finder.look(CameraImage(scene.rgb, scene.intrinsics), None,
                    Config(ransac=RansacConfig(seed=seed)), Need.PLANES)
    assert drawn[0] == drawn[1] == np.random.default_rng(0).bit_generator.state
    assert drawn[2] == np.random.default_rng(7).bit_generator.state
