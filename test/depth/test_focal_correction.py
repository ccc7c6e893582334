# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Correction of the metres of a network that was trained with another lens."""

import numpy as np
import pytest

from plane_detector.config import Config, DepthConfig, ScaleConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.depth.readers import OWN_FOCAL, lens_factor
from plane_detector.evaluation.scenes.rooms import VGA, single_wall
from plane_detector.pipeline import PlaneDetector


def wide_network(depth_m, output):
    """Return a model that assumes a camera with half the focal length."""
    values = depth_m / 2 if output == 'metric_depth' else 2 / depth_m
    return DepthFunction(lambda rgb: values, output, focal_per_height=0.5 * VGA.fy / VGA.height)


@pytest.mark.parametrize(('reference_px', 'own', 'factor'), [
    (OWN_FOCAL, 0.0, 1.0), (0.0, 1.2, 1.0), (262.5, 1.2, 2.0), (OWN_FOCAL, 2 * 525 / 480, 0.5)])
def test_factor(reference_px, own, factor):
    assert lens_factor(VGA, reference_px, own) == pytest.approx(factor)


@pytest.mark.parametrize('output', ['metric_depth', 'disparity'])
def test_the_pipeline_corrects_the_lens_unless_told_not_to(output):
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
