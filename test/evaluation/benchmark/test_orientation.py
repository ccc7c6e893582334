# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the benchmark of directions and orientations."""

import numpy as np

from plane_detector.evaluation.benchmark import orientation
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.textures import textured


def test_planes_with_and_without(monkeypatch, capsys):
    scene = textured(random_room, 304)
    frame = Frame('rooms', '304', scene.rgb, scene.depth_m, scene.intrinsics)
    wrong_m = with_disparity_noise(scene.depth_m, 0.02, np.random.default_rng(304), 0.998, 90.0)
    monkeypatch.setattr(orientation, 'load_network', lambda model: lambda rgb: wrong_m)
    orientation.report_planes('rooms', [frame], 'any')
    row = next(line for line in capsys.readouterr().out.splitlines() if '**all**' in line)
    cells = [float(cell) for cell in row.split('|')[2:-1]]
    assert cells[4] < 0.6 * cells[0]


def test_rendered_scenes(capsys, monkeypatch):
    monkeypatch.setattr(orientation, 'SCENES', {'rooms': random_room})
    orientation.report_rendered([300])
    printed = capsys.readouterr().out
    assert '1 of 1 answer' in printed
    assert '0 of 1 answer' in printed
