# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of shapes in rendered rooms, without false shapes."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, ShapesConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA, Rectangle, camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import bar, cone, ellipsoid, sheet
from plane_detector.types import CameraIntrinsics, ShapeType

CONFIG = Config(depth=DepthConfig(source='topic'), shapes=ShapesConfig(types='all'))
WALLS = [Rectangle(*(np.array(vector, float) for vector in one)) for one in (
    ([-5, 4, -1], [10, 0, 0], [0, 0, 4]), ([-5, -1, 0], [10, 0, 0], [0, 5, 0]))]
THINGS = {
    'ball': (ellipsoid(0.3, 0.3).at(0.2, 2.0, 0.6), ShapeType.SPHERE),
    'column': (cone(0.2, 0.2, 0.0, 3.0).at(0.2, 2.2), ShapeType.CYLINDER),
    'pipe': (bar((-1.0, 2.3, 0.8), (1.0, 2.0, 1.1), 0.15), ShapeType.CYLINDER),
    'traffic cone': (cone(0.3, 1e-3, 0.0, 0.9).at(-0.2, 2.0), ShapeType.CONE),
}
WAVES = np.linspace(-1.5, 1.5, 1500)
TEMPTATIONS = {
    'nothing': [],
    'egg': ellipsoid(0.25, 0.7).at(0.0, 2.2, 0.8).curved_pieces(),
    'lens': ellipsoid(0.6, 0.2).at(0.0, 2.2, 0.5).curved_pieces(),
    'curtain': sheet(np.column_stack([WAVES, 3.0 + 0.07 * np.sin(24 * WAVES),
                                      np.full(WAVES.size, 0.2)]),
                     np.array([0, 0, 2.0])).curved_pieces(),
}


UNEQUAL = CameraIntrinsics(450.0, 600.0, 290.0, 260.0, 640, 480)


@lru_cache(maxsize=16)
def scene_with(name, camera=VGA):
    pieces = THINGS[name][0].curved_pieces() if name in THINGS else TEMPTATIONS[name]
    return render(WALLS, camera_rotation(3, -12, 2), np.array([0, 0, 1.2]), camera,
                  np.random.default_rng(0), pieces)


def detect(scene, depth_m=None, config=CONFIG):
    depth_m = scene.depth_m if depth_m is None else depth_m
    return PlaneDetector(config).detect(scene.rgb, scene.intrinsics, depth_m)


@pytest.mark.parametrize('name', THINGS)
@pytest.mark.parametrize(('sigma', 'camera'), [(0.0, VGA), (0.0, UNEQUAL), (0.001, VGA)])
def test_a_shape_is_found_with_its_type_size_and_pixels(name, sigma, camera):
    scene, kind = scene_with(name, camera), THINGS[name][1]
    depth_m = scene.depth_m
    if sigma:
        depth_m = with_disparity_noise(depth_m, sigma, np.random.default_rng(3))
    found = detect(scene, depth_m)
    assert [shape.type for shape in found.shapes] == [kind]
    truth = np.isfinite(scene.depth_m) & (scene.labels < 0)
    mask = found.shape_labels == 0
    # No loop over planes may take a shape for one, as the own floor that has no plane.
    assert found.labels.max() < len(found.planes) and (found.labels[mask] == -1).all()
    assert (mask & truth).sum() / (mask | truth).sum() > (0.85 if sigma else 0.95)
    shape, = found.shapes
    assert shape.inlier_count == mask.sum()
    true_radius_m = {'ball': 0.3, 'column': 0.2, 'pipe': 0.15}.get(name)
    if true_radius_m:
        assert shape.radius_m == pytest.approx(true_radius_m, rel=0.01 if sigma == 0 else 0.1)
    else:
        assert np.degrees(shape.half_angle_rad) == pytest.approx(18.4, abs=0.5 if not sigma else 4)
    true_length_m = {'pipe': 2.04, 'traffic cone': 0.9}.get(name)
    if true_length_m and not sigma:
        assert shape.length_m == pytest.approx(true_length_m, rel=0.06)


@pytest.mark.parametrize('name', TEMPTATIONS)
def test_other_shapes_are_not_found(name):
    assert detect(scene_with(name)).shapes == ()


def test_geometry_is_in_the_camera_frame():
    scene = scene_with('column')
    shape, = detect(scene).shapes
    up_camera = -scene.gravity_camera
    assert abs(shape.axis @ up_camera) == pytest.approx(1.0, abs=1e-4)
    assert shape.length_m > 1.0
    ball, = detect(scene_with('ball')).shapes
    rotation = camera_rotation(3, -12, 2)
    expected_m = rotation.T @ (np.array([0.2, 2.0, 0.6]) - [0, 0, 1.2])
    np.testing.assert_allclose(ball.position_m, expected_m, atol=0.005)


def test_nothing_is_searched_by_default_and_planes_are_the_same():
    scene = scene_with('ball')
    without = detect(scene, config=replace(CONFIG, shapes=ShapesConfig()))
    found = detect(scene)
    assert (without.shapes, without.shape_note) == ((), 'shapes.types is none')
    assert found.shape_note == ''
    assert without.labels.max() == len(without.planes) - 1
    assert len(found.planes) == len(without.planes)
    on_plane = without.labels >= 0
    assert (found.labels[on_plane] == without.labels[on_plane]).mean() > 0.999


def test_without_metres_it_is_said_that_nothing_is_searched():
    scene, config = scene_with('ball'), replace(CONFIG, depth=DepthConfig())
    disparity = 3.0 / scene.depth_m - 0.2
    detector = PlaneDetector(config, DepthFunction(lambda rgb: disparity, 'relative_disparity'))
    found = detector.detect(scene.rgb, scene.intrinsics)
    assert (found.shapes, found.shape_note) == ((), 'the unit of depth is not known')
