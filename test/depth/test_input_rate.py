# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of a network input, or of a number of views, that keeps a rate; simulated times."""

import needs_onnxruntime  # noqa: F401
import pytest
from onnx_models import PLAIN, write_depth_network

from plane_detector.config import DepthConfig
from plane_detector.depth import estimator as estimators
from plane_detector.depth.estimator import LOAD, DepthEstimator

PLAIN = {**PLAIN, 'output': 'metric_depth'}


def seconds_of(side):
    return side**2 / 1e6


@pytest.fixture
def free(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx')
    return DepthEstimator(DepthConfig(model=str(path), short_side=280, **PLAIN))


@pytest.fixture
def timed(monkeypatch):
    """Let the time of a network go with the pixels of its input."""
    def pretend(run):
        run()
        return seconds_of(pretend.estimator.input_size(640, 480)[1])
    monkeypatch.setattr(estimators, 'median_seconds', pretend)
    return pretend


@pytest.mark.parametrize(('rate_hz', 'other_s'), [
    (20.0, 0.0), (20.0, 0.01), (LOAD / seconds_of(280), 0.0), (LOAD / seconds_of(70), 0.0),
    (900.0, 0.0)])
def test_the_network_becomes_as_large_as_the_rate_allows(free, timed, rate_hz, other_s):
    timed.estimator = free
    free.fit_to_rate(rate_hz, other_s)
    limit_s = LOAD / rate_hz - other_s + 1e-12
    sides = [side for side in range(70, 281, 14) if seconds_of(side) <= limit_s]
    assert free.input_size(640, 480)[1] == max(sides, default=70)
    facts = free.facts
    assert facts['network_input'].endswith(f' x {max(sides, default=70)}')
    said = 'is kept;' if sides else 'is not kept by the smallest input;'
    assert f'depth.target_rate {rate_hz:g} Hz {said}' in facts['network_input_reason']
    assert 'x 280 78 ms' in facts['network_input_reason'], 'the size that is too slow too'
    assert f'beside {1e3 * other_s:.0f} ms' in facts['network_input_reason']


def test_a_fixed_size_stays(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64)
    estimate = DepthEstimator(DepthConfig(model=str(path), **PLAIN))
    estimate.fit_to_rate(900.0, 0.0)
    assert estimate.facts['network_input'] == '64 x 48'
    assert 'fixed size' in estimate.facts['network_input_reason']
    assert 'fixed size' in estimate.advise(0.5)


def test_advice_names_a_size_that_keeps_up(free):
    assert 'depth.short_side 280 (now 280)' in free.advise(1.0)
    assert 'depth.short_side 266 (now 280)' in free.advise(0.999)
    assert free.advise(0.5) == ("depth.short_side 196 (now 280) would keep up, or "
                                "depth.target_rate at the camera's rate")
    assert 'no input size that is small enough' in free.advise(0.01)
