# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered scenes: a perfect score for their truth, and what counts on curved surfaces."""

import numpy as np
import pytest

from plane_detector.evaluation.benchmark.confidence import reliability
from plane_detector.evaluation.benchmark.rooms import (
    CURVED,
    curved_scene,
    furnished,
    judge_curved,
    room,
)
from plane_detector.evaluation.metrics import score


@pytest.mark.parametrize('scene_of', [room, furnished])
def test_the_truth_has_a_perfect_score(scene_of):
    scene = scene_of(0)
    seen = np.isfinite(scene.depth_m)
    best = score(scene.labels, scene.planes, scene.labels, scene.planes, seen)
    assert best.segmentation_covering == best.rand_index == best.recall == best.precision == 1
    assert best.normal_error_deg == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize('index', range(0, len(CURVED), 7))
def test_the_labels_of_a_curved_scene_are_judged(index):
    scene = curved_scene(index)
    assert 0.02 < ((scene.labels < 0) & np.isfinite(scene.depth_m)).mean() < 0.9
    assert judge_curved(scene.labels, scene) == (0, 1)
    share, least_iou = judge_curved(np.zeros_like(scene.labels), scene)
    assert share == 1
    assert least_iou < 0.5 or len(scene.planes) == 1
    rows = np.indices(scene.labels.shape)[0]
    half = np.where((scene.labels < 0) & (rows % 2 == 0), len(scene.planes), scene.labels)
    assert judge_curved(half, scene) == (pytest.approx(0.5, abs=0.01), 1)


def test_reliability_by_hand():
    text = reliability(np.array([0.5, 0.72, 0.78, 1.0]), np.array([False, True, False, True]))
    assert '| 0 to 0.5 | 1 | 0.50 | 0.00 |' in text
    assert '| 0.7 to 0.8 | 2 | 0.75 | 0.50 |' in text
    assert '| 0.95 to 1 | 1 | 1.00 | 1.00 |' in text
    assert '| 0.5 to 0.7 | 0 | nan | nan |' in text
