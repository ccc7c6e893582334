# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scale and shift of a relative disparity, against rendered scenes with exact truth."""

import dataclasses

import numpy as np
import pytest
from labelled_regions import labelled_regions
from scale_helpers import SCALE, SHIFT, SMALL, estimate, evidence, relative_disparity, room, sparse

from plane_detector.config import ScaleConfig
from plane_detector.evaluation.scenes import rooms as scenes
from plane_detector.geometry.disparity import to_disparity
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.scale.methods import ScaleEvidence, apply_scale, estimate_scale


def upright(scene, tolerance_deg=1.0):
    return {'gravity_camera': scene.gravity_camera, 'down_tolerance_deg': tolerance_deg}


def worst_angle_error_deg(scene, scale):
    """Return the largest error of an angle between two true planes at an estimated scale."""
    coefficients = -scene.planes[:, :3] / scene.planes[:, 3:]
    gain = scale.scale / SCALE
    bent = gain * coefficients + [0.0, 0.0, scale.shift - gain * SHIFT]
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    true = scene.planes[:, :3]
    angles_deg = [np.degrees(np.arccos((n @ n.T).clip(-1, 1))) for n in (bent, -true)]
    return np.abs(angles_deg[0] - angles_deg[1]).max()


def median_depth_error(scene, scale):
    depth_m = apply_scale(relative_disparity(scene.depth_m), scale)
    return np.nanmedian(np.abs(depth_m / scene.depth_m - 1.0))


def test_depth_beyond_the_largest_is_invalid_only_where_there_are_metres():
    scene = room()
    fixed = estimate(scene, method='fixed', disparity_scale=1.0)
    disparity = np.array([[1.0, 0.5, 0.1, 0.0, -1.0, np.nan]], np.float32)
    depth_m = apply_scale(disparity, fixed, max_depth_m=5.0)
    np.testing.assert_array_equal(depth_m, [[1.0, 2.0, np.nan, np.nan, np.nan, np.nan]])
    relative = estimate(scene, method='none')
    assert np.isfinite(apply_scale(disparity, relative, max_depth_m=1e-3)[0, 0])


def test_without_knowledge_the_scale_is_relative_with_reasons():
    scale = estimate(scenes.single_wall(SMALL))
    assert (scale.method, scale.is_metric, scale.has_true_angles) == ('relative', False, False)
    assert scale.unit_method == 'relative'
    for method in ('metric', 'depth_topic', 'camera_height', 'manhattan', 'fixed'):
        assert f'{method}: ' in scale.note


def test_metric_network_keeps_its_metres():
    scene = room()
    disparity = to_disparity(scene.depth_m)
    scale = estimate_scale(evidence(scene, disparity, output='metric_depth'))
    assert scale.method == 'metric' and scale.is_metric
    np.testing.assert_allclose(apply_scale(disparity, scale), scene.depth_m, rtol=1e-5)


@pytest.mark.parametrize('seed', [3, 5, 16])
def test_camera_height_is_exact_without_noise(seed):
    scene = room(seed)
    scale = estimate(scene, known=upright(scene, 0.5), camera_height=scene.height_m)
    assert scale.method == 'camera_height' and scale.is_metric
    assert worst_angle_error_deg(scene, scale) < 0.2
    assert median_depth_error(scene, scale) < 2e-3


def test_camera_height_needs_a_direction_known_well():
    scene = room()
    scale = estimate(scene, known=upright(scene, 20.0), method='camera_height', camera_height=1.5)
    assert not scale.is_metric and 'too inaccurate' in scale.note


def test_metres_that_are_too_uncertain_are_not_given_but_angles_are():
    scene = room()
    given = evidence(scene, relative_disparity(scene.depth_m), **upright(scene))
    config = ScaleConfig(camera_height=scene.height_m)
    certain = estimate_scale(given, config)
    assert certain.is_metric and certain.uncertainty < 0.1
    vague = dataclasses.replace(given)
    vague.__dict__['shift'] = dataclasses.replace(
        given.shift, sigma=given.shift.sigma / certain.uncertainty)
    scale = estimate_scale(vague, config)
    assert (scale.is_metric, scale.has_true_angles, scale.unit_method) == (False, True, 'relative')
    assert 'metres are uncertain by' in scale.note


def test_right_angles_fix_the_angles_but_claim_no_metres():
    scene = room()
    scale = estimate(scene)
    assert (scale.method, scale.is_metric, scale.has_true_angles) == ('manhattan', False, True)
    assert scale.unit_method == 'relative' and 'unit unknown' in str(scale)
    assert worst_angle_error_deg(scene, scale) < 0.5


def test_right_angles_coarse_gravity_and_height_give_metres():
    scene = room()
    coarse = scene.gravity_camera + [0.15, 0.0, 0.1]
    known = {'gravity_camera': coarse, 'down_tolerance_deg': 20.0}
    scale = estimate(scene, known=known, camera_height=scene.height_m)
    assert scale.method == 'manhattan' and scale.is_metric
    assert median_depth_error(scene, scale) < 0.01


@pytest.mark.parametrize('make', [scenes.attic, scenes.hexagon_room])
def test_rooms_without_right_angles_are_not_bent(make):
    refused = 0
    for seed in range(3000, 3020):
        scene = make(np.random.default_rng(seed), SMALL)
        scale = estimate(scene, 0.004, method='manhattan')
        refused += not scale.has_true_angles
        assert scale.note and not scale.is_metric
        if scale.has_true_angles:
            assert worst_angle_error_deg(scene, scale) < 6.0
    assert refused >= 18


@pytest.mark.parametrize('gain, offset', [(7.0, 0.0), (0.01, -3.0), (1.0, 40.0)])
def test_the_networks_own_unit_does_not_matter(gain, offset):
    scene = room()
    disparity = relative_disparity(scene.depth_m).astype(np.float64)
    config = ScaleConfig(camera_height=scene.height_m)
    other = gain * disparity + offset
    depths = [apply_scale(d, estimate_scale(evidence(scene, d, **upright(scene)), config))
              for d in (disparity, other)]
    np.testing.assert_allclose(depths[1], depths[0], rtol=1e-3)


def test_auto_takes_the_first_that_gives_metres():
    scene = room()
    known = {'disparity_scale': SCALE, 'disparity_shift': SHIFT}
    assert estimate(scene).method == 'manhattan'
    assert estimate(scene, **known).method == 'fixed'
    known['camera_height'] = scene.height_m
    seen = upright(scene)
    assert estimate(scene, known=seen, **known).method == 'camera_height'
    seen['sensor_depth_m'] = sparse(scene.depth_m, 100)
    assert estimate(scene, known=seen, **known).method == 'depth_topic'
    seen['output'] = 'disparity'
    assert estimate(scene, known=seen, **known).method == 'metric'


@pytest.mark.parametrize('disparity', [np.full((240, 320), np.nan, np.float32),
                                       np.zeros((240, 320), np.float32),
                                       np.ones((240, 320), np.float32)])
def test_images_without_information_give_relative(disparity):
    planes = ray_planes(labelled_regions(disparity, np.zeros(disparity.shape, int)), SMALL)
    scale = estimate_scale(
        ScaleEvidence(disparity, lambda: planes, gravity_camera=np.array([0.0, 1.0, 0.0]),
                      sensor_depth_m=disparity), ScaleConfig(camera_height=1.0))
    assert scale.method == 'relative'
    assert apply_scale(disparity, scale).shape == disparity.shape
