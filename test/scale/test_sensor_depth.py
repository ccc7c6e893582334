# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scale and shift from measured depth."""

import numpy as np
import pytest
from scale_helpers import SCALE, SHIFT, estimate, relative_disparity, room, sparse

from plane_detector.scale.sensor_depth import fit_measured_depth


@pytest.mark.parametrize('count, wrong_share', [(8, 0.0), (200, 0.2), (76000, 0.1)])
def test_measured_depth_gives_scale_and_shift(count, wrong_share):
    scene = room()
    scale = estimate(scene, known={'sensor_depth_m': sparse(scene.depth_m, count, wrong_share)})
    assert scale.method == 'depth_topic' and scale.is_metric
    assert scale.scale == pytest.approx(SCALE, rel=1e-3)
    assert scale.shift == pytest.approx(SHIFT, abs=1e-3)


def test_measured_depth_with_noise_is_as_good_as_its_uncertainty():
    scene = room()
    disparity = relative_disparity(scene.depth_m, noise=0.004)
    fit = fit_measured_depth(disparity, sparse(scene.depth_m, 200))
    error = np.array([fit.scale - SCALE, fit.shift - SHIFT])
    assert error @ np.linalg.solve(fit.covariance, error) < 16.0
    assert abs(error[0]) < 0.05 * SCALE


def test_measured_depth_that_does_not_determine_the_scale_is_refused():
    scene = room()
    disparity = relative_disparity(scene.depth_m)
    assert '4 points' in fit_measured_depth(disparity, sparse(scene.depth_m, 4)).refusal
    wall_m = np.full(scene.depth_m.shape, 2.0, np.float32)
    noisy = 2.0 + 0.01 * np.random.default_rng(0).standard_normal(wall_m.shape)
    assert 'varies too little' in fit_measured_depth(noisy, wall_m).refusal
    assert fit_measured_depth(-disparity, scene.depth_m).refusal
