# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors err as they should, and by nothing else."""

import numpy as np
import pytest

from plane_detector.evaluation.benchmark.sensors import errors
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.evaluation.scenes.sensors import (
    KINECT_BASELINE_M,
    SENSORS,
)


@pytest.fixture(scope='module')
def scene():
    return random_room(np.random.default_rng(1400))


@pytest.mark.parametrize('name', SENSORS)
def test_depth_is_near_the_truth_and_the_same_for_a_seed(name, scene):
    first, again = (SENSORS[name](scene.depth_m, VGA, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert first.dtype == np.float32
    assert np.isfinite(first).mean() > 0.9
    off = np.abs(1 / first - 1 / scene.depth_m)
    assert np.nanmedian(off) < 0.003
    assert np.isnan(SENSORS[name](np.full((48, 64), np.nan, np.float32), VGA,
                                  np.random.default_rng(5))).all()


@pytest.mark.parametrize('z_m', [1.0, 3.0])
def test_structured_light_has_steps_of_an_eighth_pixel(z_m):
    wall = single_wall(yaw_deg=0, distance_m=z_m)
    measured_m = SENSORS['structured light'](wall.depth_m, VGA, np.random.default_rng(0))
    eighths = 8 * VGA.fx * KINECT_BASELINE_M / measured_m[np.isfinite(measured_m)]
    np.testing.assert_allclose(eighths, np.rint(eighths), atol=1e-3)
    assert len(np.unique(np.rint(eighths))) > 2


def test_structured_light_errs_like_a_kinect_in_every_band():
    wall = single_wall(yaw_deg=20, distance_m=2.5)
    measured_m = SENSORS['structured light'](wall.depth_m, VGA, np.random.default_rng(0))
    (found,) = errors(wall.labels, measured_m)
    # 1/km; a real wall of this size has 0.8 0.8 0.8 1.4 and a bend of 0.7 to 2.
    np.testing.assert_array_less(found[2:], [1.6, 1.2, 1.2, 3.5, 3.0])
    np.testing.assert_array_less([0.7, 0.5, 0.5, 1.0, 0.5], found[2:])
