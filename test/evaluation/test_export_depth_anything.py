# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
import pytest

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.evaluation import export_depth_anything

pytest.importorskip('torch', reason='the development extra plane_detector[export] is missing')
pytest.importorskip('transformers', reason='plane_detector[export] is missing')


def test_the_true_architecture_runs_at_free_sizes_and_agrees_with_torch(tmp_path):
    model = export_depth_anything.build(seed=0)
    assert sum(parameter.numel() for parameter in model.parameters()) == 24785089
    path = tmp_path / 'random.onnx'
    export_depth_anything.export(model, path)
    estimate = DepthEstimator(DepthConfig(model=str(path), output='relative_disparity',
                                          short_side=252))
    assert estimate.input_size(640, 480) == (336, 252)
    for size in ((252, 336), (280, 210)):
        assert export_depth_anything.largest_difference(model, path, size) < 1e-3
