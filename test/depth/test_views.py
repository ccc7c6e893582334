# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The average of several views of an image, and networks that are run on them."""

import dataclasses
import hashlib

import numpy as np
import pytest
from onnx_models import millimetres_as_rgb, write_depth_network

from plane_detector.config import DepthConfig
from plane_detector.depth import estimator as estimators
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.input_rate import LOAD
from plane_detector.depth.networks import NETWORKS
from plane_detector.depth.views import View, average_views, choose_views
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


def test_a_view_is_a_part_of_the_image():
    image = np.arange(10 * 20).reshape(10, 20)
    assert (View().of(image) == image).all()
    assert (View(0.5).of(image) == image[:5, :10]).all()
    mirrored = View(0.5, is_at_end=True, is_mirrored=True).of(image)
    assert (mirrored == image[5:, :9:-1]).all()
    assert mirrored.flags.c_contiguous
    assert View(0.1).of(image[:1, :1]).shape == (1, 1)


@pytest.mark.parametrize(('ratio', 'shares'), [
    (0.5, (1, 0.85, 0.85)), (0.912, (1, 0.912, 0.912)), (1.0, (1,)), (1.7, (1,))])
def test_crops_have_the_lens_of_the_training(ratio, shares):
    assert tuple(view.share for view in choose_views(ratio, 3)) == shares
    assert len(choose_views(ratio, 1)) == 1


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
    np.testing.assert_allclose(average_views(VIEWS, views).values, whole, rtol=1e-5)
    views[0].values[:] = np.nan
    assert np.isnan(average_views(VIEWS[:1], views[:1]).values).all()


def test_errors_that_differ_between_views_are_averaged_without_a_seam():
    """A step at the side of a crop would look like an edge."""
    views = predictions(ramp(96, 128), 'disparity')
    for view in views[1:]:
        view.values[:] += np.float32(0.1)
    error = average_views(VIEWS, views).values - views[0].values
    assert np.abs(error).max() > 0.005
    assert max(np.abs(np.diff(error, axis=axis)).max() for axis in (0, 1)) < 0.002


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
    network = dataclasses.replace(
        NETWORKS['fastdepth'], file_name=path.name, size_bytes=path.stat().st_size,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    monkeypatch.setitem(NETWORKS, 'fastdepth', network)
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


def test_views_need_a_known_lens(fixed, tmp_path):
    with pytest.raises(ValueError, match=r'depth\.views 2 needs a metric network'):
        fixed(views=2, model=str(tmp_path / 'fixed.onnx'), output='metric_depth')


def test_fewer_views_keep_the_rate(fixed, monkeypatch):
    estimate = fixed()

    def pretend(run):
        run()
        return 0.01 * estimate._views
    monkeypatch.setattr(estimators, 'median_seconds', pretend)
    estimate.fit_to_rate(LOAD / 0.02, 0.0)
    facts = estimate.facts
    assert facts['network_input'] == '64 x 48, up to 2 views'
    assert 'is kept' in facts['network_input_reason']
    assert '64 x 48, up to 3 views 30 ms' in facts['network_input_reason']


def test_advice_names_the_views_that_keep_up(fixed):
    assert fixed().advise(0.7).startswith('depth.views 2 (now 3) would keep up')
    assert 'fixed size' in fixed().advise(0.3)


def test_fewer_views_are_no_advice_for_a_lens_that_needs_one(fixed):
    estimate = fixed()
    rgb = millimetres_as_rgb(np.full((48, 64), 2.0))
    estimate.predict(rgb, dataclasses.replace(WIDE, fx=80.0, fy=80.0))
    assert 'fixed size' in estimate.advise(0.7)
