# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The pipeline from image to planes, with given depth instead of a network."""

from dataclasses import fields, replace

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, PlaneDetector, segment_planes
from plane_detector._runtime.stopping import Stop, Stopped
from plane_detector.config import (
    Config,
    DepthConfig,
    DirectionsConfig,
    RansacConfig,
    ScaleConfig,
    SegmentationConfig,
    TrackingConfig,
)
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.geometry.disparity import noise_reference
from plane_detector.segmentation.search import ransac
from plane_detector.settings import Settings

SMALL = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
SCENE = random_room(np.random.default_rng(3), SMALL)
SCALE, SHIFT = 0.02, 0.05
TOPIC = Config(depth=DepthConfig(source='topic'))


def network(output, noise_share=0.0):
    """Return a model that gives the true depth in the requested unit."""
    disparity = 1 / SCENE.depth_m
    values = {'metric_depth': SCENE.depth_m, 'disparity': disparity,
              'relative_disparity': (disparity - SHIFT) / SCALE}[output]
    return DepthFunction(lambda rgb: values, output, noise_share)


def detect(model, config=None):
    return PlaneDetector(config or Config(), model).detect(SCENE.rgb, SMALL)


def test_metric_depth_is_segmented_unchanged():
    as_it_is = Config(directions=DirectionsConfig(orient_planes=False))
    found = detect(network('metric_depth'), as_it_is)
    expected = segment_planes(SCENE.depth_m, SMALL)
    np.testing.assert_array_equal(found.labels, expected.labels)
    np.testing.assert_array_equal(plane_array(found), plane_array(expected))
    assert found.scale.unit_method == 'metric'
    np.testing.assert_array_equal(found.depth_m, SCENE.depth_m)


@pytest.mark.parametrize(('output', 'scale', 'method'), [
    ('disparity', ScaleConfig(), 'metric'),
    ('relative_disparity', ScaleConfig(method='fixed', disparity_scale=SCALE,
                                       disparity_shift=SHIFT), 'fixed')])
def test_disparity_of_known_scale_gives_the_planes_of_the_depth(output, scale, method):
    found, expected = detect(network(output), Config(scale=scale)), detect(network('metric_depth'))
    assert found.scale.unit_method == method
    np.testing.assert_allclose(found.depth_m, SCENE.depth_m, rtol=1e-3)
    assert len(found.planes) == pytest.approx(len(expected.planes), abs=1)
    np.testing.assert_allclose(plane_array(found)[:2], plane_array(expected)[:2], atol=2e-3)


def test_the_stated_noise_of_a_network_is_used():
    least = 0.05 * noise_reference(1 / SCENE.depth_m)
    assert detect(network('metric_depth', 0.05)).disparity_noise >= least * (1 - 1e-6)
    assert detect(network('metric_depth')).disparity_noise < 0.5 * least


def test_measured_depth_needs_no_network():
    found = PlaneDetector(TOPIC).detect(SCENE.rgb, SMALL, SCENE.depth_m)
    np.testing.assert_array_equal(found.labels, segment_planes(SCENE.depth_m, SMALL).labels)
    assert found.scale.unit_method == 'metric'
    assert str(found.scale) == found.scale_event.removeprefix('scale: ')
    assert str(found.scale) == 'metric: measured depth'


def test_depth_of_another_size_than_the_image_is_refused():
    detector = PlaneDetector(Config(), lambda rgb: np.ones((4, 5), np.float32))
    with pytest.raises(ValueError, match='one size'):
        detector.detect(SCENE.rgb, SMALL)


def test_pixels_outside_the_image_have_no_depth_and_no_plane():
    scene = single_wall()
    covered = np.ones(scene.depth_m.shape, bool)
    covered[:, :100] = False
    found = PlaneDetector(Config(), lambda rgb: scene.depth_m).detect(
        scene.rgb, scene.intrinsics, covered=covered)
    assert np.isnan(found.depth_m[:, :100]).all()
    assert (found.labels[:, :100] == -1).all() and (found.labels[:, 100:] == 0).all()


def test_tracking_can_be_switched_off(room):
    source = DepthConfig(source='topic')
    for enabled in (True, False):
        detector = PlaneDetector(Config(depth=source, tracking=TrackingConfig(enabled=enabled)))
        for scene in (room(3), room(5)):
            detection = detector.detect(scene.rgb, scene.intrinsics, scene.depth_m)
        by_size = list(range(1, len(detection.planes) + 1))
        assert (detection.planes.labels.tolist() != by_size) == enabled
        assert 'tracking' in detection.stage_seconds


CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
RGB = np.zeros((120, 160, 3), np.uint8)


def depth_of(rgb):
    return np.full(rgb.shape[:2], 2.0, np.float32)


@pytest.mark.parametrize('restart', ['reset', 'jump', None])
def test_depth_is_averaged_until_a_reset_or_a_jump_back_in_time(restart):
    rng = np.random.default_rng(0)
    rgb, noisy_m = rng.integers(0, 255, RGB.shape, np.uint8), 2 + rng.normal(
        0, 0.004, (4, *RGB.shape[:2]))
    given = iter(noisy_m.astype(np.float32))
    detector = PlaneDetector(Config(), lambda rgb: next(given))
    for stamp_s in (5.0, 5.1, 5.2):
        detector.detect(rgb, CAMERA, stamp_s=stamp_s)
    if restart == 'reset':
        detector.reset()
    found = detector.detect(rgb, CAMERA, stamp_s=3.0 if restart == 'jump' else 5.3)
    is_own = np.abs(found.depth_m - noisy_m[3]) < 1e-5
    assert is_own.all() if restart else is_own.mean() < 0.1


def test_no_stage_starts_after_a_stop():
    stop = Stop()

    def estimate(rgb):
        stop.set()
        return depth_of(rgb)

    with pytest.raises(Stopped), stop.applies():
        PlaneDetector(Config(), estimate).detect(RGB, CAMERA)


def test_the_search_looks_at_the_stop_before_every_pass(monkeypatch):
    """Over curved depth and with the largest settings, where one pass finds many planes."""
    stop, passes, find = Stop(), [], ransac.find_planes

    def counted(*arguments):
        passes.append(1)
        stop.set()
        return find(*arguments)

    monkeypatch.setattr(ransac, 'find_planes', counted)
    rows, columns = np.mgrid[:120, :160] / 120
    noise = np.random.default_rng(0).normal(0, 0.02, rows.shape)
    depth_m = (2 + np.sin(9 * rows) * np.cos(7 * columns) + noise).astype(np.float32)
    config = Config(segmentation=SegmentationConfig(max_planes=255, min_plane_share=0.0),
                    ransac=RansacConfig(max_iterations=1000000))
    with pytest.raises(Stopped), stop.applies():
        PlaneDetector(config, lambda rgb: depth_m).detect(RGB, CAMERA)
    assert len(passes) == 1


# Valid values of settings whose type and range say too little.
VALUES = {'scale.gravity': (0.0, 1.0, 0.0), 'shapes.types': 'sphere',
          'scale.imu_to_camera': (1.0, 0.0, 0.0, 0.0),
          'ground.ignore_box': (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)}


def live_settings():
    for section in fields(Config):
        settings = getattr(Config(), section.name)
        for field in fields(settings) if isinstance(settings, Settings) else ():
            if not field.metadata['read_only']:
                yield section.name, field


def other_value(name, field):
    value, meta = field.default, field.metadata
    if name in VALUES:
        return VALUES[name]
    if isinstance(value, bool):
        return not value
    if meta['choices']:
        return next(choice for choice in meta['choices'] if choice != value)
    candidates = (type(value)(one) for one in (value + 1, value / 2, meta['high'], meta['low']))
    return next(one for one in candidates if one != value and meta['low'] <= one <= meta['high'])


def state_of(thing):
    """Return what an object of this package holds, and what its parts hold."""
    if not type(thing).__module__.startswith('plane_detector') or not hasattr(thing, '__dict__'):
        return repr(thing)
    return {name: state_of(part) for name, part in vars(thing).items()}


@pytest.mark.parametrize(('section', 'field'), list(live_settings()),
                         ids=lambda one: getattr(one, 'name', one))
def test_no_part_of_a_detector_keeps_a_setting_that_may_change(section, field):
    settings = replace(getattr(Config(), section),
                       **{field.name: other_value(f'{section}.{field.name}', field)})
    default = state_of(PlaneDetector(Config(), depth_of))
    changed = state_of(PlaneDetector(Config(**{section: settings}), depth_of))
    assert changed.pop('config') != default.pop('config')
    assert changed == default


@pytest.mark.parametrize(('make', 'changes', 'said'), [
    (DepthConfig, {'mean': (0.5,)}, 'mean must be 3 numbers'),
    (DepthConfig, {'std': (1.0, 1.0)}, 'std must be 3 numbers'),
    (DepthConfig, {'providers': ()}, 'at least one'),
    *((ScaleConfig, {name: value}, name) for name, value in (
        ('gravity', (0.0, 1.0)), ('imu_to_camera', (0.0,) * 4), ('method', 'guess'),
        ('camera_height', -1.0)))])
def test_impossible_settings_are_refused(make, changes, said):
    with pytest.raises(ValueError, match=said):
        make(**changes)


@pytest.mark.parametrize('rgb, depth_m, said', [
    (np.zeros((60, 80, 3), np.uint8), np.ones((120, 160), np.float32),
     'the image is 80 x 60, the intrinsics are for 160 x 120'),
    (np.zeros((120, 160), np.uint8), np.ones((120, 160), np.float32), 'must be .H, W, 3. uint8'),
    (np.zeros((120, 160, 3)), np.ones((120, 160), np.float32), 'uint8, not .* float64'),
    (np.zeros((120, 160, 3), np.uint8), np.full((120, 160), 2000, np.uint16),
     'not 2-D uint16; uint16 millimetres: divide by 1000'),
    (np.zeros((120, 160, 3), np.uint8), np.ones((60, 80), np.float32), 'depth is 80 x 60, the')])
@pytest.mark.parametrize('source', ['topic', 'model'])
def test_image_and_depth_of_another_size_or_type_are_refused(source, rgb, depth_m, said):
    camera = CameraIntrinsics.from_field_of_view(160, 120, 60.0)
    detector = PlaneDetector(Config(depth=DepthConfig(source=source)),
                             None if source == 'topic' else lambda rgb: np.ones((120, 160)))
    with pytest.raises(ValueError, match=said):
        detector.detect(rgb, camera, depth_m)
