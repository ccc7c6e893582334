# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth up to scale: angles are true without any evidence, metres need a height or points."""

import numpy as np
import pytest
from scale_helpers import room, sparse

from plane_detector.config import Config, DepthConfig, ScaleConfig
from plane_detector.pipeline import PlaneDetector
from plane_detector.scale.sensor_depth import fit_measured_depth
from plane_detector.types import PlaneClass

UNIT = 7.0
GREY = np.full((240, 320, 3), 128, np.uint8)


def detected(scene, config=None, factor=UNIT, **known):
    config = config or ScaleConfig()
    detector = PlaneDetector(
        Config(depth=DepthConfig(output='relative_depth'), scale=config),
        lambda rgb: (factor * scene.depth_m).astype(np.float32))
    return detector.detect(GREY, scene.intrinsics, **known)


def true_normal_error_deg(found, scene):
    """Return the largest angle between a found plane and the nearest one of the scene."""
    cosines = np.abs(found.planes.normals @ scene.planes[:, :3].T).max(axis=1)
    return np.degrees(np.arccos(cosines.clip(-1, 1))).max()


@pytest.mark.parametrize('factor', [1e-5, UNIT, 1e5])
def test_angles_are_true_and_the_unit_is_unknown(factor):
    scene = room()
    found = detected(scene, factor=factor, gravity_camera=scene.gravity_camera)
    assert found.scale.unit_method == 'relative' and 'relative' in str(found.scale)
    assert len(found.planes) >= 3
    assert true_normal_error_deg(found, scene) < 0.5
    assert PlaneClass.FLOOR in found.classes and PlaneClass.WALL in found.classes


def test_a_height_gives_metres():
    scene = room()
    down = scene.gravity_camera
    height_m = scene.planes[scene.planes[:, :3] @ down < -0.99, 3].max()
    found = detected(scene, ScaleConfig(camera_height=height_m), gravity_camera=down)
    assert found.scale.unit_method == 'camera_height'
    np.testing.assert_allclose(found.depth_m, scene.depth_m, rtol=0.01)


def test_measured_depth_gives_metres_without_a_shift():
    scene = room()
    found = detected(scene, depth_m=sparse(scene.depth_m, 200))
    assert found.scale.unit_method == 'depth_topic'
    np.testing.assert_allclose(found.depth_m, scene.depth_m, rtol=0.01)
    # All at one depth: a shift could not be told from the scale.
    wall_m = np.full((60, 80), 2.0, np.float32)
    fit = fit_measured_depth(3 / wall_m, wall_m, has_shift=False)
    assert (fit.scale, fit.shift) == (pytest.approx(1 / 3, rel=1e-6), 0.0)
