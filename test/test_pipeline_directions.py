# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of the lines of the image in the whole pipeline."""

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, DirectionsConfig, ScaleConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.metrics import angle_deg, overlap, pure_errors
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.textures import ramp_room, textured
from plane_detector.planes.classification import PlaneClass

CAMERA = CameraIntrinsics(525.0, 525.0, 319.5, 239.5, 640, 480)
SCENE = textured(random_room, 300, CAMERA)
WRONG_M = with_disparity_noise(SCENE.depth_m, 0.02, np.random.default_rng(0), 0.998, 90.0)
GIVEN = ScaleConfig(gravity=tuple(SCENE.gravity_camera))
OFF = DirectionsConfig(gravity=False, orient_planes=False)


def network(depth_m=WRONG_M, output='metric_depth'):
    values = 3.0 * (1 / depth_m - 0.1) if output == 'relative_disparity' else depth_m
    return DepthFunction(lambda rgb: values.astype(np.float32), output, 0.004)


def detect(config=None, model=None, rgb=SCENE.rgb, **measured):
    return PlaneDetector(config or Config(), model or network()).detect(rgb, CAMERA, **measured)


def plain():
    """Return an image without any line."""
    return np.full_like(SCENE.rgb, 90)


def same_planes(first, second):
    return np.array_equal(first.labels, second.labels) and all(
        np.array_equal(a.normal, b.normal) for a, b in zip(first.planes, second.planes,
                                                           strict=True))


def test_floors_and_walls_of_a_network_are_turned_upright():
    def worst_deg(found):
        level = [p.normal @ SCENE.gravity_camera for p, kind in zip(found.planes, found.classes,
                                                                strict=True)
                 if kind == PlaneClass.FLOOR]
        return np.degrees(np.arccos(np.abs(level))).max()
    turned = detect(Config(scale=GIVEN))
    assert worst_deg(turned) < 0.9
    raw = detect(Config(scale=GIVEN, directions=DirectionsConfig(orient_planes=False)))
    assert worst_deg(raw) > 1.0


@pytest.mark.parametrize('turns', [1, 2, 3])
def test_axes_turn_planes_of_a_network_although_it_is_open_which_is_down(turns):
    """The lines show three axes at right angles; a network does not show which one is down."""
    rgb, wrong_m, labels = (np.ascontiguousarray(np.rot90(part, turns)) for part in (
        SCENE.rgb, WRONG_M, SCENE.labels))
    camera, planes = CAMERA, SCENE.planes.copy()
    for _ in range(turns):
        camera = CameraIntrinsics(camera.fy, camera.fx, camera.cy, camera.width - 1 - camera.cx,
                                  camera.height, camera.width)
        planes[:, :2] = np.column_stack([planes[:, 1], -planes[:, 0]])

    def errors_deg(directions):
        found = PlaneDetector(Config(directions=directions), network(wrong_m)).detect(rgb, camera)
        seen = overlap(labels, found.labels, np.ones(labels.shape, bool))
        normals = np.stack([[*plane.normal, plane.offset_m] for plane in found.planes])
        errors, pixels = pure_errors(seen, planes, normals)
        return found, np.average(errors, weights=pixels)
    (found, by_axes), (_, raw) = errors_deg(DirectionsConfig()), errors_deg(OFF)
    assert found.gravity.gravity_camera is None and set(found.classes) == {PlaneClass.UNKNOWN}
    assert by_axes < 1.0 < 10.0 < raw


def turned_scene(turns):
    """Return the image, 1/z and planes of a camera that is turned about its axis."""
    rgb, inverse, labels = (np.ascontiguousarray(np.rot90(part, turns)) for part in (
        SCENE.rgb, 1 / SCENE.depth_m, SCENE.labels))
    camera, planes = CAMERA, SCENE.planes.copy()
    for _ in range(turns):
        camera = CameraIntrinsics(camera.fy, camera.fx, camera.cy, camera.width - 1 - camera.cx,
                                  camera.height, camera.width)
        planes[:, :2] = np.column_stack([planes[:, 1], -planes[:, 0]])
    return rgb, inverse, labels, camera, planes


@pytest.mark.parametrize('turns', [1, 2, 3])
def test_a_relative_network_has_true_angles_although_it_is_open_which_axis_is_down(turns):
    """The shift follows from axes; neither metres, nor gravity, nor a class does."""
    rgb, inverse, labels, camera, planes = turned_scene(turns)
    relative = (3.0 * (inverse - 0.1)).astype(np.float32)
    found = PlaneDetector(Config(), DepthFunction(
        lambda rgb: relative, 'relative_disparity', 0.004)).detect(rgb, camera)
    assert found.gravity.gravity_camera is None and found.scale.unit_method == 'relative'
    assert set(found.classes) == {PlaneClass.UNKNOWN}
    assert 'planes and the axes of the scene' in str(found.scale)
    assert 'directions.mounting: upright' in found.gravity.note
    seen = overlap(labels, found.labels, np.ones(labels.shape, bool))
    errors, pixels = pure_errors(seen, planes, np.stack(
        [[*plane.normal, plane.offset_m] for plane in found.planes]))
    assert np.average(errors, weights=pixels) < 1.0


def test_exact_planes_of_a_small_image_do_not_move():
    camera = CameraIntrinsics.from_field_of_view(160, 120, 62.0)
    for make, seed in ((random_room, 303), (ramp_room, 310)):
        scene = textured(make, seed, camera)
        model = DepthFunction(lambda rgb, depth=scene.depth_m: depth.astype(np.float32),
                              'metric_depth', 0)
        found, off = (PlaneDetector(Config(directions=directions), model).detect(
            scene.rgb, camera) for directions in (DirectionsConfig(mounting='upright'), OFF))
        assert found.gravity.source == 'image' and np.array_equal(found.labels, off.labels)
        for one, other in zip(found.planes, off.planes, strict=True):
            assert angle_deg(one.normal, other.normal) < 0.05


def test_measured_depth_is_left_alone():
    topic = DepthConfig(source='topic')
    found, off = (PlaneDetector(Config(depth=topic, directions=directions)).detect(
        SCENE.rgb, CAMERA, depth_m=WRONG_M) for directions in (DirectionsConfig(), OFF))
    assert same_planes(found, off)
    assert found.gravity.source == 'image'


def test_a_relative_network_and_a_height_give_metres_without_an_imu():
    config = Config(scale=ScaleConfig(camera_height=SCENE.height_m),
                    directions=DirectionsConfig(mounting='upright'))
    found = detect(config, network(SCENE.depth_m, 'relative_disparity'))
    assert found.scale.unit_method == 'camera_height'
    ratio = found.depth_m / SCENE.depth_m
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.03)
    without = detect(Config(scale=config.scale, directions=OFF),
                     network(SCENE.depth_m, 'relative_disparity'))
    assert without.scale.unit_method == 'relative'


def test_lines_along_the_black_corners_of_rectification_do_not_count():
    covered = np.zeros(SCENE.depth_m.shape, bool)
    covered[40:440, 60:580] = True
    rgb = np.where(covered[..., None], plain(), 0).astype(np.uint8)
    assert detect(rgb=rgb, covered=covered).gravity.note.startswith('0 straight lines')
