# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Constants in depth are no measurement; walls seen exactly from the front are."""

import numpy as np
import pytest
from cell_helpers import FLOOR, millimetres, view, wall

from plane_detector import Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig
from plane_detector.evaluation.benchmark.samples import curved_scene, noisy_depth, room
from plane_detector.segmentation.cells.constant_depth import without_constants
from plane_detector.segmentation.segment import metric_noise_floor

NOISE_FLOOR = metric_noise_floor(Config())
V, U = np.mgrid[0:480, 0:640]
REGIONS = {'body': 380 - 60 * (abs(U - 320) < 200) < V, 'strip': U < 70,
           'blob': (V - 330) ** 2 + (U - 250) ** 2 < 70**2}


@pytest.mark.parametrize('value_m', [0.3, 1.0, 5.0, 65.535])
@pytest.mark.parametrize('region', REGIONS)
@pytest.mark.parametrize('noise', [0.001, 'active stereo'])
def test_a_mask_is_invalid_and_the_rest_keeps_its_planes(noise, region, value_m):
    scene, at = room(1), REGIONS[region]
    depth_m = noisy_depth(scene, noise, 1)
    masked_m = np.where(at, np.float32(value_m), depth_m)
    kept_m = without_constants(masked_m, NOISE_FLOOR)
    assert np.isnan(kept_m[at]).mean() > 0.98
    np.testing.assert_array_equal(kept_m[~at & (depth_m != value_m)],
                                  depth_m[~at & (depth_m != value_m)])
    found = segment_planes(masked_m, scene.intrinsics)
    assert not (found.labels[at] >= 0).any()
    blanked = segment_planes(np.where(at, np.nan, depth_m).astype(np.float32), scene.intrinsics)
    assert abs((found.labels >= 0).mean() - (blanked.labels >= 0).mean()) < 0.01


@pytest.mark.parametrize('share', [0.1, 0.4])
@pytest.mark.parametrize('beyond_m', [None, 10.0, 65.535])
def test_what_lies_beyond_the_range_is_invalid(beyond_m, share):
    depth_m = noisy_depth(room(1), 0.001, 1)
    limit_m = np.float32(np.nanquantile(depth_m, 1 - share))
    far = depth_m >= limit_m
    kept_m = without_constants(np.where(far, np.float32(beyond_m or limit_m), depth_m),
                               NOISE_FLOOR)
    assert np.isnan(kept_m[far]).mean() > 0.98 and np.isfinite(kept_m[~far]).all()


@pytest.mark.parametrize('keep', [lambda depth_m: depth_m, millimetres,
                                  lambda depth_m: np.round(depth_m, 2).astype(np.float32)])
def test_exact_depth_stays_as_it_is(keep):
    # A wall seen from the front above a floor; beside one that is nearer; behind a pipe.
    for depth_m in (view([wall(3), FLOOR]).depth_m, view([wall(3), wall(2, 0, 500)]).depth_m,
                    curved_scene(29).depth_m, np.full((480, 640), 2.0, np.float32)):
        kept_m = keep(depth_m)
        assert without_constants(kept_m, NOISE_FLOOR) is kept_m


@pytest.mark.parametrize('noise', ['structured light', 'filled, 8 bit', 'whole cm'])
def test_steps_of_quantised_depth_are_no_constants(noise):
    for seed in range(3):
        depth_m = noisy_depth(room(seed), noise, seed)
        assert without_constants(depth_m, NOISE_FLOOR) is depth_m


def test_all_outputs_see_a_mask_as_invalid():
    scene, at = room(1), REGIONS['body']
    depth_m = np.where(at, np.float32(5.0), noisy_depth(scene, 0.001, 1))
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    assert np.isnan(detector.detect(scene.rgb, scene.intrinsics, depth_m).depth_m[at]).all()
