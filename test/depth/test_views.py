# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The average of several views of an image, and networks that are run on them."""

import dataclasses

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_geometry_models import put_in_cache
from onnx_models import millimetres_as_rgb, write_depth_network

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.views import average_views, choose_views
from plane_detector.types import CameraIntrinsics, Prediction

VIEWS = choose_views(0.9, 3)
WIDE = CameraIntrinsics(50.0, 50.0, 31.5, 23.5, 64, 48)
KINDS = ('metric_depth', 'disparity')


def ramp(height=48, width=64):
    """Return depth that no view of another part shows."""
    v, u = np.mgrid[:height, :width].astype(np.float32)
    return 2 + 0.03 * u + 0.01 * v


def predictions(depth_m, kind, factors=(1.0, 1.0, 1.0)):
    values = depth_m if kind == 'metric_depth' else 1 / depth_m
    return [Prediction(kind, view.of(values) * np.float32(factor))
            for view, factor in zip(VIEWS, factors, strict=True)]


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('count', [1, 2, 3])
def test_views_that_agree_up_to_scale_give_the_whole_image(kind, count):
    views = predictions(ramp(), kind, (1.0, 1.2, 0.7))
    averaged = average_views(VIEWS[:count], views[:count])
    assert averaged.output == kind
    np.testing.assert_allclose(averaged.values, views[0].values, rtol=1e-5)


@pytest.mark.parametrize('kind', KINDS)
def test_a_view_fills_what_another_lacks(kind):
    views = predictions(ramp(), kind)
    whole = views[0].values.copy()
    views[0].values[20:24, 30:34] = np.nan
    views[1].values[5:9, 5:9] = views[2].values[3:6, 3:6] = np.nan
    np.testing.assert_allclose(average_views(VIEWS, views).values, whole, rtol=1e-5)
    views[0].values[:] = np.nan
    assert np.isnan(average_views(VIEWS[:1], views[:1]).values).all()


def test_a_crop_ends_without_a_step():
    """It differs from the whole by up to a tenth, at the inner sides that the feather ends at."""
    whole = np.ones((480, 640), np.float32)
    for view in VIEWS[1:]:
        crop = view.of(whole) + 0.1 * np.linspace(-1, 1, 576, dtype=np.float32)
        averaged = average_views([VIEWS[0], view], [Prediction('disparity', whole),
                                                    Prediction('disparity', crop)]).values
        assert np.ptp(averaged) > 0.05
        assert max(abs(np.diff(averaged, axis=axis)).max() for axis in (0, 1)) < 0.003


def test_independent_errors_become_smaller():
    rng, views = np.random.default_rng(3), predictions(ramp(96, 128), 'disparity')
    truth = views[0].values.copy()
    for view in views:
        view.values[:] += 0.01 * rng.standard_normal(view.values.shape).astype(np.float32)
    middle = np.s_[24:-24, 32:-32]
    before, after = (np.std((values - truth)[middle])
                     for values in (views[0].values, average_views(VIEWS, views).values))
    assert after < 0.7 * before


@pytest.fixture
def fixed(tmp_path, monkeypatch):
    """Return a maker of networks with a fixed input, from a path or in place of FastDepth."""
    path = write_depth_network(tmp_path / 'fixed.onnx', height=48, width=64)
    put_in_cache(monkeypatch, 'fastdepth', path)
    return lambda **settings: DepthEstimator(DepthConfig(
        **{'model': 'fastdepth', 'cache_dir': str(tmp_path), **settings}))


def test_a_network_on_three_views_sees_the_same_plain_wall(fixed, monkeypatch):
    rgb, runs = millimetres_as_rgb(np.full((48, 64), 2.0)), []
    estimate, whole = fixed(), fixed(views=1).predict(rgb, WIDE)
    run = estimate._session.run
    monkeypatch.setattr(estimate._session, 'run', lambda array: runs.append(1) or run(array))
    np.testing.assert_allclose(estimate.predict(rgb, WIDE).values, whole.values, rtol=1e-5)
    assert len(runs) == 3
    estimate.predict(rgb, dataclasses.replace(WIDE, fx=80.0, fy=80.0))
    estimate.predict(rgb)
    assert len(runs) == 3 + 1 + 1, 'a longer lens, and one that is not known: the whole image'
    assert estimate.facts['network_input'] == '64 x 48, up to 3 views'
