# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth sources: a sensor, a model, or a function as a model."""

from dataclasses import replace

import cv2
import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_models import PLAIN, write_depth_network

from plane_detector.config import Config, DepthConfig
from plane_detector.depth.estimator import BLUR_INPUT_PX, DepthEstimator
from plane_detector.depth.observation import (
    DepthFunction,
    ModelDepth,
    Observation,
    SensorDepth,
    make_source,
)
from plane_detector.types import CameraIntrinsics, DepthModel, Prediction

CAMERA = CameraIntrinsics(20.0, 20.0, 3.5, 2.5, 8, 6)
RGB = np.zeros((6, 8, 3), np.uint8)
VALUES = np.full((6, 8), 2.0, np.float32)
VALUES[0, :4] = [0.0, np.nan, np.inf, 100.0]
TOPIC = Config(depth=DepthConfig(source='topic'))


def test_a_network_is_a_depth_model(tmp_path):
    path = str(write_depth_network(tmp_path / 'n.onnx', height=6, width=8))
    estimator = DepthEstimator(DepthConfig(model=path, output='disparity', **PLAIN))
    assert isinstance(estimator, DepthModel)
    assert estimator.edge_blur_px(80, 60) == pytest.approx(10 * BLUR_INPUT_PX)
    assert estimator.facts['depth_model'] == path
    assert 'CPUExecutionProvider' in estimator.facts['execution_provider']


@pytest.mark.parametrize(('asked_for', 'output'), [
    ('auto', 'metric_depth'), ('relative_disparity', 'relative_disparity')])
def test_a_plain_function_is_wrapped_once(asked_for, output):
    def wall(rgb):
        return VALUES
    source = make_source(Config(depth=DepthConfig(output=asked_for)), wall)
    assert isinstance(source.model, DepthFunction)
    assert isinstance(source.model, DepthModel)
    assert (source.output, source.facts) == (output, {'depth_model': 'wall'})


def test_an_incomplete_depth_model_is_refused_with_the_missing_attributes():
    def wall(rgb):
        return VALUES
    wall.output = 'relative_disparity'
    with pytest.raises(ValueError, match='has output, but not noise_share, focal_per_height'):
        make_source(Config(), wall)


@pytest.mark.parametrize('output', ['metric_depth', 'disparity', 'relative_disparity'])
def test_noise_is_a_share_of_the_disparities_of_the_image_in_any_unit(output):
    ramp = np.tile(np.linspace(10.0, 30.0, 400, dtype=np.float32), (40, 1))
    for unit in (1, 0.01):
        values = 1 / (unit * ramp) if output == 'metric_depth' else unit * ramp
        seen = Observation(RGB, CAMERA, Config(), Prediction(output, values), noise_share=0.1)
        assert seen.disparity_noise == pytest.approx(2.0 * unit, rel=0.06)
        assert replace(seen, noise_share=0.0).disparity_noise == 0.0


@pytest.mark.parametrize('source', [
    ModelDepth(DepthFunction(lambda rgb: VALUES)),
    ModelDepth(DepthFunction(lambda rgb: np.where(VALUES > 0, 1 / VALUES, np.nan), 'disparity'))])
def test_invalid_or_too_far_depth_is_nan(source):
    given = VALUES.copy()
    with np.errstate(divide='ignore'):
        found = source.observe(RGB, CAMERA, given, Config(depth=DepthConfig(max_depth=50.0)))
        nearer = source.observe(RGB, CAMERA, given, Config(depth=DepthConfig(max_depth=1.0)))
    is_valid = np.isfinite(found.prediction.values)
    assert not is_valid[0, :4].any() and is_valid[1:].all() and is_valid[0, 4:].all()
    assert np.isnan(nearer.prediction.values).all(), 'the settings may change between two frames'
    np.testing.assert_array_equal(given, VALUES)


@pytest.mark.parametrize('unit', [1e-6, 1.0, 1e6])
def test_relative_depth_is_in_units_of_its_median(unit):
    ramp = np.where(VALUES == 2, np.arange(1, 49, dtype=np.float32).reshape(6, 8), VALUES)
    source = ModelDepth(DepthFunction(lambda rgb: unit * ramp, 'relative_depth'))
    found = source.observe(RGB, CAMERA, None, Config()).prediction.values
    median = np.median(ramp[np.isfinite(ramp) & (ramp > 0)])
    np.testing.assert_allclose(found[1:], ramp[1:] / median, rtol=1e-5)


def test_a_sensor_measures():
    found = SensorDepth().observe(RGB, CAMERA, VALUES, TOPIC)
    assert found.is_measured and found.noise_share == found.edge_blur_px == 0
    with pytest.raises(ValueError, match='depth.source is topic'):
        SensorDepth().observe(RGB, CAMERA, None, TOPIC)


@pytest.mark.parametrize('output', ['metric_depth', 'disparity', 'relative_disparity'])
def test_flicker_of_a_large_still_image_is_averaged_until_a_reset(output):
    """Its noise is that of a small input: twelve images have less than half of it."""
    rng, size = np.random.default_rng(0), (1280, 960)
    rgb = cv2.resize(rng.integers(0, 255, (60, 80, 3), np.uint8), size,
                     interpolation=cv2.INTER_NEAREST)
    true = cv2.resize(np.linspace(0.2, 0.5, 48, dtype=np.float32).reshape(6, 8), size)
    true[:100] = np.nan

    def predict(_):
        noise = cv2.resize(rng.normal(0, 0.01, (60, 80)).astype(np.float32), size)
        return 1 / (true + noise) if output == 'metric_depth' else true + noise

    source = make_source(Config(depth=DepthConfig(output=output)), predict)
    camera = CameraIntrinsics.from_field_of_view(*size, 60.0)

    def observed():
        return source.observe(rgb, camera, None, Config()).disparity

    off = [np.nanstd(observed() - true) for _ in range(12)]
    assert off[-1] < 0.5 * off[0]
    assert np.isnan(observed()[:100]).all()
    source.reset()
    assert np.nanstd(observed() - true) > 0.8 * off[0]
