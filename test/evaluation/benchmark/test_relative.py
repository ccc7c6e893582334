# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated relative networks, on rendered and on real images."""

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest

from plane_detector.config import ScaleConfig
from plane_detector.evaluation.benchmark.relative import angles, network_view, with_network_errors
from plane_detector.evaluation.datasets import frames
from plane_detector.evaluation.reference_planes import true_floor
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.scale.methods import apply_scale


def test_the_errors_have_the_stated_size():
    exact = np.full((240, 320), 0.5)
    exact[:20] = np.nan
    found = with_network_errors(exact, 0.03, np.random.default_rng(0))
    assert np.isnan(found[:20]).all()
    assert np.nanstd(found / exact) == pytest.approx(0.03, rel=0.2)


def test_errors_by_the_shift_are_distinguished_from_those_of_the_network():
    view = network_view(random_room(np.random.default_rng(3)), 0.015, np.random.default_rng(3))
    true = view.estimate(view.true_scale)
    found = angles(view, true)
    assert found.by_shift_deg == pytest.approx(0, abs=1e-6)
    assert found.normal_deg == found.at_true_shift_deg > 0.3
    shifted = ScaleConfig(method='fixed', disparity_scale=true.scale,
                          disparity_shift=true.shift + 0.2)
    bent = angles(view, view.estimate(shifted))
    assert bent.by_shift_deg > 5 and bent.at_true_shift_deg == found.at_true_shift_deg


@pytest.mark.parametrize('name', ['kinect', 'nyu'])
def test_camera_height_brings_real_images_to_metres(name, data_folder):
    rng, errors = np.random.default_rng(5), []
    for frame in frames(data_folder, (name,)):
        if (floor := true_floor(frame)) is None:
            continue
        view = network_view(frame, 0.0, rng)
        scale = view.estimate(ScaleConfig(camera_height=floor.offset_m), down_tolerance_deg=0.5,
                              gravity_camera=-floor.normal)
        if scale.method == 'camera_height':
            depth_m = apply_scale(view.disparity, scale)
            errors.append(np.nanmedian(np.abs(depth_m / frame.depth_m - 1)))
        else:  # where no floor was segmented it refuses
            assert not scale.is_metric
    assert len(errors) >= 2 and max(errors) < 0.04
