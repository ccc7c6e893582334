# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of a network input that keeps a rate: with simulated times, and on ONNX Runtime."""


import pytest
from onnx_models import write_depth_network

from plane_detector.config import DepthConfig
from plane_detector.depth import estimator as estimators
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.input_rate import LOAD, largest_within, side_for

SIDES = tuple(range(98, 281, 14))
PLAIN = {'input_scale': 1.0, 'mean': (0.0, 0.0, 0.0), 'std': (1.0, 1.0, 1.0),
         'output': 'metric_depth'}


def seconds_of(side):
    return side**2 / 1e6


@pytest.mark.parametrize('limit_s', [0.0, seconds_of(98), 0.03, seconds_of(280), 1.0])
def test_the_largest_that_fits_is_found_from_two_times(limit_s):
    size, seconds = largest_within(SIDES, seconds_of, limit_s)
    assert size == max((s for s in SIDES if seconds_of(s) <= limit_s), default=SIDES[0])
    assert set(seconds) <= {98, 280}


@pytest.mark.parametrize(('share', 'side'), [(1.0, 280), (0.999, 266), (0.25, 140), (0.1, None)])
def test_time_goes_with_the_pixels_of_the_input(share, side):
    assert side_for(280, share, SIDES) == side


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


@pytest.mark.parametrize('other_s', [0.0, 0.01])
def test_the_network_becomes_as_large_as_the_rate_allows(free, timed, other_s):
    timed.estimator = free
    free.fit_to_rate(20.0, other_s)
    side = max(s for s in range(70, 281, 14) if seconds_of(s) <= LOAD / 20.0 - other_s)
    assert free.input_size(640, 480)[1] == side < 280
    facts = free.facts
    assert facts['network_input'].endswith(f' x {side}')
    assert 'depth.target_rate 20 Hz is kept' in facts['network_input_reason']
    assert 'x 280 78 ms' in facts['network_input_reason'], 'the size that is too slow too'
    assert f'beside {1e3 * other_s:.0f} ms' in facts['network_input_reason']


def test_an_unreachable_rate_is_reported(free, timed):
    timed.estimator = free
    free.fit_to_rate(900.0, 0.0)
    assert free.input_size(640, 480)[1] == 70
    assert 'not kept by the smallest input' in free.facts['network_input_reason']


def test_a_fixed_size_stays(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64)
    estimate = DepthEstimator(DepthConfig(model=str(path), **PLAIN))
    estimate.fit_to_rate(900.0, 0.0)
    assert estimate.facts['network_input'] == '64 x 48'
    assert 'fixed size' in estimate.facts['network_input_reason']
    assert 'fixed size' in estimate.advise(0.5)


def test_advice_names_a_size_that_keeps_up(free):
    assert free.advise(0.5) == ("depth.short_side 196 (now 280) would keep up, or "
                                "depth.target_rate at the camera's rate")
    assert 'no input size that is small enough' in free.advise(0.01)


def test_real_times_find_an_input(free):
    free.fit_to_rate(1000.0, 0.0)
    assert free.input_size(640, 480)[1] in range(70, 281, 14)
    assert 'depth.target_rate 1000 Hz' in free.facts['network_input_reason']
