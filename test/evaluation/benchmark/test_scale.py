# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The results of the benchmark of the scale hold on real images."""

import numpy as np
import pytest

from plane_detector.config import ScaleConfig
from plane_detector.evaluation.benchmark import scale as benchmark_scale


@pytest.mark.parametrize('name', ['kinect', 'nyu'])
def test_camera_height_brings_real_images_to_metres(name, data_folder, monkeypatch):
    monkeypatch.setattr(benchmark_scale, 'DRAWS_PER_IMAGE', 1)
    answered = 0
    for view in benchmark_scale.real_views(data_folder / name, np.random.default_rng(5)):
        scale = view.estimate(ScaleConfig(camera_height=view.height_m), down_tolerance_deg=0.5,
                              gravity_camera=view.gravity_camera)
        if scale.method != 'camera_height':  # where no floor was segmented it refuses
            assert not scale.is_metric
            continue
        answered += 1
        errors = benchmark_scale.measure(view, scale)
        assert np.median(errors.distance_share) < 0.04
        assert np.median(errors.angle_deg) < 3.0
    assert answered >= 2
