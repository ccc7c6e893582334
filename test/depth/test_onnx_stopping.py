# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A network that is running or warming up can be stopped."""

from dataclasses import replace

import numpy as np
import pytest
from onnx_models import PLAIN
from slow_networks import HEIGHT, WIDTH, write_slow_network

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.stopping import Background, Stopped

STUCK_S = 20.0
BRIGHT = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)


def config(path):
    return replace(DepthConfig(model=str(path), output='metric_depth'), **PLAIN)


def test_inference_ends_between_two_operators(tmp_path):
    estimator = DepthEstimator(config(write_slow_network(tmp_path / 'slow.onnx')))
    call = Background(lambda: estimator(BRIGHT), 'inference')
    assert not call.wait(0.2)
    call.stop.set()
    assert call.wait(STUCK_S)
    with pytest.raises(Stopped):
        call.result()
    assert np.isfinite(estimator(BRIGHT // 4)).all(), 'it can be used again'


def test_the_warm_up_ends_too(tmp_path):
    path = write_slow_network(tmp_path / 'slow.onnx', always=True)
    call = Background(lambda: DepthEstimator(config(path)), 'warm-up')
    assert not call.wait(0.5)
    call.stop.set()
    assert call.wait(STUCK_S)
    with pytest.raises(Stopped):
        call.result()
