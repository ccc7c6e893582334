# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Networks of several outputs: units, axes, letterboxing, the lens, and its correction."""

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_geometry_models import (
    angle_deg_of,
    encoded,
    put_in_cache,
    write_canonical_network,
    write_point_map_network,
)

from plane_detector.config import Config, DepthConfig, ScaleConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.observation import DepthFunction
from plane_detector.depth.preprocessing import InputRecipe, rays
from plane_detector.depth.readers import OWN_FOCAL, depth_from_point_map, lens_factor
from plane_detector.evaluation.scenes.rooms import VGA, single_wall
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import CameraIntrinsics

MOGE, METRIC3D = 'moge_2_small_normal', 'metric3d_v2_small'
WIDTH, HEIGHT = 56, 42
LENS = CameraIntrinsics(50.0, 52.0, 20.0, 23.0, WIDTH, HEIGHT)


def wall_m(lens=LENS, slope=0.15):
    """Return the depth of an upright wall that is turned about the vertical."""
    x = rays(lens, (lens.height, lens.width))[..., 0]
    return 2 / (1 + slope * x)


def moge(monkeypatch, tmp_path, lens=LENS, **changes):
    path = write_point_map_network(tmp_path / 'moge.onnx', rays(lens, (HEIGHT, WIDTH)), **changes)
    put_in_cache(monkeypatch, MOGE, path)
    return DepthEstimator(DepthConfig(model=MOGE, cache_dir=str(tmp_path)))


def metric3d(monkeypatch, tmp_path):
    put_in_cache(monkeypatch, METRIC3D, write_canonical_network(tmp_path / 'metric3d.onnx'))
    return DepthEstimator(DepthConfig(model=METRIC3D, cache_dir=str(tmp_path)))


def angles_deg(normals):
    """Return the angle of each normal (sin a, 0, -cos a), after a check of the rest of it."""
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=1e-5)
    np.testing.assert_allclose(normals[..., 1], 0, atol=1e-6)
    return np.degrees(np.arctan2(normals[..., 0], -normals[..., 2]))


@pytest.mark.parametrize('changes', [{}, {'shift': -0.3}, {'facing': -1},
                                     {'element_of_mask': 'BOOL'}])
def test_a_point_map_gives_metres_and_normals_that_look_at_the_camera(
        tmp_path, monkeypatch, changes):
    estimate = moge(monkeypatch, tmp_path, **changes)
    depth_m = np.round(wall_m(), 3)
    blue = np.tile(np.linspace(40, 220, WIDTH).astype(np.uint8), (HEIGHT, 1))
    found = estimate.predict(encoded(depth_m, blue), LENS)
    assert (estimate.output, found.output) == ('metric_depth', 'metric_depth')
    np.testing.assert_allclose(found.values, depth_m, rtol=1e-4)
    np.testing.assert_allclose(angles_deg(found.normals_camera), angle_deg_of(blue), atol=1e-3)
    assert found.values.dtype == found.normals_camera.dtype == np.float32


def test_masked_pixels_are_nan(tmp_path, monkeypatch):
    depth_m = np.round(wall_m(), 3)
    depth_m[:10] = 0  # the sky
    found = moge(monkeypatch, tmp_path).predict(encoded(depth_m, 100), LENS)
    np.testing.assert_array_equal(np.isnan(found.values), depth_m == 0)
    np.testing.assert_array_equal(np.isnan(found.normals_camera).any(axis=-1), depth_m == 0)


def test_the_lens_is_that_of_the_image_and_not_of_the_input(tmp_path, monkeypatch):
    # The same view in three times as many pixels; a wall face on has one depth in all of them.
    large = CameraIntrinsics(150.0, 156.0, 61.0, 70.0, 3 * WIDTH, 3 * HEIGHT)
    np.testing.assert_allclose(rays(large, (HEIGHT, WIDTH)), rays(LENS, (HEIGHT, WIDTH)),
                               atol=1e-6)
    found = moge(monkeypatch, tmp_path).predict(
        encoded(np.full((3 * HEIGHT, 3 * WIDTH), 3.0), 100), large)
    assert found.values.shape == (3 * HEIGHT, 3 * WIDTH)
    assert found.normals_camera.shape == (3 * HEIGHT, 3 * WIDTH, 3)
    np.testing.assert_allclose(found.values, 3.0, rtol=1e-4)


def test_a_file_with_other_outputs_than_in_the_zoo_is_refused(tmp_path, monkeypatch):
    put_in_cache(monkeypatch, MOGE, write_canonical_network(tmp_path / 'n.onnx'))
    with pytest.raises(ValueError, match='must have an input num_tokens of int64.*pixel_values'):
        DepthEstimator(DepthConfig(model=MOGE, cache_dir=str(tmp_path)))
    other = write_point_map_network(tmp_path / 'm.onnx', rays(LENS, (HEIGHT, WIDTH)))
    put_in_cache(monkeypatch, METRIC3D, other)
    with pytest.raises(ValueError, match='must have one input, of float32'):
        DepthEstimator(DepthConfig(model=METRIC3D, cache_dir=str(tmp_path)))


def test_noise_moves_the_shift_of_a_point_map_by_less_than_itself():
    rng = np.random.default_rng(0)
    x = rays(LENS, (HEIGHT, WIDTH))
    z = wall_m().astype(np.float32)
    points = np.dstack([x * z[..., None], z - 0.7]) * (1 + 0.02 * rng.standard_normal(
        (HEIGHT, WIDTH, 1)))
    is_valid = rng.random((HEIGHT, WIDTH)) < 0.9
    points[~is_valid] = np.nan
    found = depth_from_point_map(points.astype(np.float32), is_valid, x)
    np.testing.assert_array_equal(np.isnan(found), ~is_valid)
    assert abs(np.nanmedian(found - z)) < 0.01


def test_near_points_decide_the_shift_of_a_point_map():
    """An error of a share of the distance is that of a pixel; a far one leads metres off."""
    x, z = rays(LENS, (HEIGHT, WIDTH)), np.where(np.arange(WIDTH) % 2, 10.0, 1.0)
    z = np.tile(z, (HEIGHT, 1))
    points = np.dstack([x * z[..., None], z - 0.7])
    points[z == 10, :2] *= 1.05  # the shift of these alone is 1.2
    found = depth_from_point_map(points.astype(np.float32), np.ones(z.shape, bool), x)
    np.testing.assert_allclose(found - z, 0, atol=0.01)


@pytest.mark.parametrize(('width', 'height', 'focal_at_input'), [
    (1064, 400, 500.0), (500, 616, 500.0), (532, 308, 1000.0)])
def test_canonical_depth_becomes_metres_by_the_focal_length_at_the_input(
        tmp_path, monkeypatch, width, height, focal_at_input):
    lens = CameraIntrinsics(500.0, 500.0, width / 2, height / 2, width, height)
    estimate = metric3d(monkeypatch, tmp_path)
    assert estimate.input_size(width, height) == (1064, 616)
    raw = np.full((height, width), 4.0)
    if width != 532:  # not resized, so that every pixel can be told from its neighbours
        raw = np.round(np.linspace(2, 9, width * height).reshape(height, width), 3)
    found = estimate.predict(encoded(raw, 77), lens)
    np.testing.assert_allclose(found.values, raw * focal_at_input / 1000, rtol=1e-4)
    np.testing.assert_allclose(angles_deg(found.normals_camera), angle_deg_of(77), atol=1e-3)
    np.testing.assert_allclose(found.normal_confidence, 77 / 255, rtol=1e-4)
    assert found.normal_confidence.shape == (height, width)


def test_a_map_smaller_than_the_input_is_cropped_where_the_image_lies():
    recipe = InputRecipe(1.0, (0.0,) * 3, (1.0,) * 3, border_rgb=(0.0,) * 3)
    framing = recipe.framing((640, 160), (64, 32))
    assert (framing.left, framing.top, framing.width, framing.height) == (0, 8, 64, 16)
    rows = np.repeat(np.arange(16)[:, None], 32, axis=1)
    np.testing.assert_array_equal(framing.crop(rows)[:, 0], np.arange(4, 12))


def wide_network(depth_m, output):
    """Return a model that assumes a camera with half the focal length."""
    values = depth_m / 2 if output == 'metric_depth' else 2 / depth_m
    return DepthFunction(lambda rgb: values, output, focal_per_height=0.5 * VGA.fy / VGA.height)


@pytest.mark.parametrize(('reference_px', 'own', 'factor'), [
    (OWN_FOCAL, 0.0, 1.0), (0.0, 1.2, 1.0), (262.5, 1.2, 2.0), (OWN_FOCAL, 2 * 525 / 480, 0.5)])
def test_factor(reference_px, own, factor):
    assert lens_factor(VGA, reference_px, own) == pytest.approx(factor)


@pytest.mark.parametrize('output', ['metric_depth', 'disparity'])
def test_the_pipeline_corrects_the_lens_unless_switched_off(output):
    scene = single_wall(distance_m=3.0)
    network = wide_network(scene.depth_m, output)
    corrected = PlaneDetector(Config(), network).detect(scene.rgb, VGA)
    assert corrected.planes[0].offset_m == pytest.approx(scene.planes[0, 3], rel=1e-3)
    np.testing.assert_allclose(corrected.depth_m, scene.depth_m, rtol=1e-5)
    uncorrected = Config(scale=ScaleConfig(reference_focal_px=0.0))
    as_it_is = PlaneDetector(uncorrected, network).detect(scene.rgb, VGA)
    assert as_it_is.planes[0].offset_m == pytest.approx(scene.planes[0, 3] / 2, rel=1e-3)


def test_measured_depth_has_no_lens():
    scene = single_wall(distance_m=3.0)
    config = Config(depth=DepthConfig(source='topic'),
                    scale=ScaleConfig(reference_focal_px=100.0))
    found = PlaneDetector(config).detect(scene.rgb, VGA, scene.depth_m)
    assert found.planes[0].offset_m == pytest.approx(scene.planes[0, 3], rel=1e-4)
