# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark on curved surfaces: pixels that count as labelled."""

import numpy as np
import pytest

from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark import curved as benchmark_curved
from plane_detector.evaluation.benchmark.curved import curved_scenes, judge, report_curved
from plane_detector.evaluation.benchmark.rooms import SIGMAS

SCENES = list(curved_scenes())


class Fixed(peers.Method):
    """Gives the same labels for any image."""

    name = 'fixed'

    def __init__(self, labels):
        self.labels = labels

    def __call__(self, depth_m, intrinsics):
        return self.labels, np.zeros((2, 4))


def test_every_scene_shows_a_curved_thing_and_planes_beside_it():
    assert len(SCENES) == 36
    for scene in SCENES:
        curved = (scene.labels < 0) & np.isfinite(scene.depth_m)
        assert 0.02 < curved.mean() < 0.9
        assert len(scene.planes) >= 1


def test_the_truth_labels_no_curved_pixel():
    scene = SCENES[0]
    assert judge(Fixed(scene.labels), scene, 0.0, 0) == (0.0, 1.0)


def test_a_label_everywhere_covers_all_curved_pixels():
    scene = SCENES[0]
    share, least_iou = judge(Fixed(np.zeros_like(scene.labels)), scene, 0.0, 0)
    assert share == 1
    assert least_iou < 0.5


def test_half_of_the_curved_pixels_count_as_half():
    scene = SCENES[0]
    rows = np.indices(scene.labels.shape)[0]
    half = np.where((scene.labels < 0) & (rows % 2 == 0), len(scene.planes), scene.labels)
    share, least_iou = judge(Fixed(half), scene, 0.0, 0)
    assert share == pytest.approx(0.5, abs=0.01)
    assert least_iou == 1


def test_the_table_leaves_slow_and_absent_methods_out(monkeypatch, capsys):
    monkeypatch.setattr(benchmark_curved, 'curved_scenes', lambda: SCENES[:1])
    slow, absent = Fixed(SCENES[0].labels), Fixed(SCENES[0].labels)
    slow.name, slow.slow, absent.name, absent.absent = 'slow', True, 'absent', 'not installed'
    report_curved([Fixed(SCENES[0].labels), slow, absent])
    text = capsys.readouterr().out
    assert text.count('| fixed |') == len(SIGMAS)
    assert '| fixed | 0.004 | 1 | 0.00 | 0.00 | 1.000 | 1.00 |' in text
    assert '| slow |' not in text
    assert '| absent |' not in text
