# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Distance of missed planes relative to the noise."""

import numpy as np
import pytest
from cell_helpers import rectangle, view, wall

from plane_detector.evaluation.benchmark import missed_planes as benchmark_misses
from plane_detector.evaluation.benchmark.missed_planes import missed, report_misses

SIGMA = 0.01


def board(before_m):
    """Return a wall 2.5 m ahead with a board in front of it."""
    return view([wall(2.5), rectangle([-0.3, 2.5 - before_m, -0.25], [0.6, 0, 0], [0, 0, 0.5])])


def says(monkeypatch, labels, planes):
    monkeypatch.setattr(benchmark_misses, 'Ours', lambda: lambda depth_m, intrinsics: (
        labels, planes))


def test_a_board_merged_with_its_wall_is_missed_by_its_thickness(monkeypatch):
    scene = board(0.1)
    says(monkeypatch, np.zeros_like(scene.labels), scene.planes[:1])
    (deviation,) = missed(scene, SIGMA, 0)
    assert deviation == pytest.approx((1 / 2.4 - 1 / 2.5) / SIGMA, rel=1e-3)


def test_a_board_without_any_plane_is_infinitely_far(monkeypatch):
    scene = board(0.1)
    says(monkeypatch, np.where(scene.labels == 1, -1, 0), scene.planes[:1])
    assert list(missed(scene, SIGMA, 0)) == [np.inf]


def test_found_or_small_planes_are_not_missed(monkeypatch):
    scene = board(0.1)
    says(monkeypatch, scene.labels, scene.planes)
    assert list(missed(scene, SIGMA, 0)) == []
    small = view([wall(2.5), rectangle([0, 2.4, 0], [0.1, 0, 0], [0, 0, 0.1])])
    says(monkeypatch, np.zeros_like(small.labels), small.planes[:1])
    assert list(missed(small, SIGMA, 0)) == []


def test_the_table_counts_by_distance(monkeypatch, capsys):
    scene = board(0.1)  # 0.0167 per metre: 4.2 and 1.7 times the noise
    says(monkeypatch, np.zeros_like(scene.labels), scene.planes[:1])
    report_misses('Boards', lambda seed: scene, range(2))
    text = capsys.readouterr().out
    assert '| 0.004 | 2 | 0 | 0 | 0 | 2 | 0 |' in text
    assert '| 0.01 | 2 | 0 | 0 | 2 | 0 | 0 |' in text
