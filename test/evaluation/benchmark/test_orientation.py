# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the benchmark of directions and orientations."""

import argparse

import cv2
import numpy as np
import pytest

from plane_detector.evaluation.benchmark import orientation
from plane_detector.evaluation.benchmark.orientation_figure import write_figure
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.pipeline import segment_planes


@pytest.fixture(scope='module')
def scene():
    return textured(random_room, 300)


@pytest.fixture
def frame(scene):
    return Frame('rooms', '300', scene.rgb, scene.depth_m, scene.intrinsics)


def test_true_gravity_is_that_of_the_floor(scene):
    down = orientation.true_down(segment_planes(scene.depth_m, scene.intrinsics))
    assert orientation.angle_deg(down, scene.gravity_camera) < 0.1


def test_gravity_is_reported_for_each_frame(frame, capsys):
    orientation.report_gravity('rooms', [frame])
    printed = capsys.readouterr().out
    assert '1 of 1 answer' in printed
    assert '| 300 | 0.1 |' in printed or '| 300 | 0.0 |' in printed


def test_refusals_are_reported_with_their_reason(scene, capsys):
    plain = Frame('rooms', 'plain', np.full_like(scene.rgb, 90), scene.depth_m, scene.intrinsics)
    orientation.report_gravity('rooms', [plain])
    assert '0 straight lines' in capsys.readouterr().out


def test_planes_with_and_without(monkeypatch, capsys):
    scene = textured(random_room, 304)
    frame = Frame('rooms', '304', scene.rgb, scene.depth_m, scene.intrinsics)
    wrong_m = with_disparity_noise(scene.depth_m, 0.02, np.random.default_rng(304), 0.998, 90.0)
    monkeypatch.setattr(orientation, 'load_network', lambda model: (lambda rgb: wrong_m, 'wrong'))
    orientation.report_planes('rooms', [frame], 'any')
    row = next(line for line in capsys.readouterr().out.splitlines() if '**all**' in line)
    cells = [float(cell) for cell in row.split('|')[2:-1]]
    assert cells[5] < 0.6 * cells[0]


def test_rendered_scenes(capsys, monkeypatch):
    monkeypatch.setattr(orientation, 'SCENES', {'rooms': random_room})
    orientation.report_rendered(1, 300)
    printed = capsys.readouterr().out
    assert '1 of 1 answer' in printed
    assert '0 of 1 answer' in printed


def test_options():
    parser = argparse.ArgumentParser()
    orientation.add_arguments(parser)
    assert parser.parse_args(['--only', 'gravity']).only == ['gravity']


def test_the_figure_shows_answers_and_refusals(tmp_path):
    path = write_figure(tmp_path / 'directions.png', {'rooms': random_room}, 1, 300)
    image = cv2.imread(str(path))[..., ::-1].astype(int)
    # One answer: its upright lines are red; and strokes, whose lines have no direction.
    red, yellow = ((np.abs(image - colour).max(2) < 40).sum() for colour in (
        (230, 40, 40), (240, 200, 60)))
    assert red > 100 and yellow > 100
