# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A wrong mounting is distinguished from a right one; errors of heights are as stated."""

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, ScaleConfig
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import camera_rotation, rectangle, render
from plane_detector.evaluation.scenes.surfaces import block

CAMERA = CameraIntrinsics(140.0, 150.0, 84.0, 66.0, 160, 120)
HEIGHT_M, SIGMA = 1.4, 0.002
FLOOR = rectangle((-20, -20, 0), (40, 0, 0), (0, 40, 0))


def view(roll_deg=0.0, things=()):
    faces = [face for thing in things for face in thing.flat]
    return render([FLOOR, *faces], camera_rotation(0, -30, roll_deg), np.array([0, 0, HEIGHT_M]),
                  CAMERA, np.random.default_rng(0))


def detect(scene, rng, stated_m):
    config = Config(depth=DepthConfig(source='topic'), scale=ScaleConfig(camera_height=stated_m))
    return PlaneDetector(config).detect(
        scene.rgb, CAMERA, with_disparity_noise(scene.depth_m, SIGMA, rng), scene.gravity_camera)


@pytest.mark.parametrize(('stated_m', 'is_said'), [(1.4, False), (1.41, False), (1.33, True),
                                                   (1.48, True), (1.6, True)])
def test_a_height_that_is_off_by_more_than_a_tape_measure_is_said(stated_m, is_said):
    """Five per cent are more than anybody measures wrongly; one centimetre is not."""
    mounting = detect(view(), np.random.default_rng(1), stated_m).ground_result.mounting
    assert mounting.height_m == pytest.approx(HEIGHT_M, abs=0.01)
    assert (f'the floor is 1.40 m below the camera, not {stated_m:.2f} m' in mounting.problem
            ) == is_said


@pytest.mark.parametrize('roll_deg', [0.0, 40.0, -40.0])
def test_the_stated_error_of_a_height_is_that_of_draws_all_over_the_image(roll_deg):
    """The height of a wall is off by the error of its depth, at both sides of a rolled camera."""
    scene = view(roll_deg, [block((-3, 2.5, 0), (3, 2.7, 2.5))])
    is_wall = (scene.labels >= 0) & (abs(scene.planes[scene.labels, :3]
                                         @ scene.gravity_camera) < 0.1)
    rng, heights_m, sigmas_m = np.random.default_rng(2), [], []
    for _ in range(24):
        found = detect(scene, rng, HEIGHT_M)
        heights_m.append(found.ground_result.heights_m)
        sigmas_m.append(found.ground_result.height_sigmas_m)
    spread_m, stated_m = np.std(heights_m, axis=0), np.mean(sigmas_m, axis=0)
    ray_x, ray_y = ((np.arange(n) - c) / f for n, c, f in (
        (160, CAMERA.cx, CAMERA.fx), (120, CAMERA.cy, CAMERA.fy)))
    down = scene.gravity_camera
    # Along a ray that is level a height does not change with the depth.
    rise = down[0] * ray_x + down[1] * ray_y[:, None] + down[2]
    ratios = []
    for part in (np.s_[:, :50], np.s_[:, 110:], np.s_[:40], np.s_[80:]):
        is_there = np.zeros(is_wall.shape, bool)
        is_there[part] = True
        chosen = is_there & is_wall & (abs(rise) > 0.15) & np.isfinite(stated_m)
        if chosen.sum() > 150:
            ratios.append(np.median(spread_m[chosen] / stated_m[chosen]))
    assert len(ratios) >= 2
    assert 0.6 < min(ratios) <= max(ratios) < min(1.8, 1.6 * min(ratios)), ratios
