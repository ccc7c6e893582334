# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The table of accuracy and time, its processes, and the figure made of the same samples."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark import samples as benchmark_samples
from plane_detector.evaluation.benchmark.accuracy import report
from plane_detector.evaluation.benchmark.plots import write_figure
from plane_detector.evaluation.benchmark.samples import Sample, plan, run_job
from plane_detector.evaluation.datasets import UNKNOWN, LabelledFrame
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=20, distance_m=2.0)
COUNTS = {'rooms': 2, 'living': 1, 'curved': 2}


class Fixed(peers.Method):
    """Gives the true labels and planes of the wall."""

    name = 'fixed'

    def run(self, prepared):
        return WALL.labels, WALL.planes

    def result(self, raw):
        return raw


def sample(covering=0.5, shares=(), found=(), **differences):
    numbers = {'SC': covering, 'recall': np.nan, 'precision': 0.25, 'unlabelled': 0.125}
    usual = Sample('ours', 'rooms', '1', 0.004, 1.0, numbers, np.array(shares, float),
                   np.array(found, bool))
    return replace(usual, **differences)


def test_a_scene_is_measured_at_every_noise(monkeypatch):
    monkeypatch.setitem(benchmark_samples._SCENES, 'rooms', lambda seed: WALL)
    job, *_ = plan([Fixed()], COUNTS, 9000, 1, [])
    found = run_job(job)
    assert [one.noise for one in found] == list(benchmark_samples.SIGMAS)
    assert all(one.numbers == {'SC': 1, 'recall': 1, 'precision': 1, 'unlabelled': 0}
               for one in found)
    assert all(one.plane_shares == [1] and one.found == [True] for one in found)


def test_a_frame_labelled_by_hand_is_scored_on_its_labels():
    labels = WALL.labels.copy()
    labels[:, :40] = UNKNOWN
    frame = LabelledFrame('office', '1', WALL.rgb, WALL.depth_m, SMALL, labels)
    found, = run_job(plan([Fixed()], dict.fromkeys(COUNTS, 0), 9000, 1, [frame])[0])
    assert found.numbers == {'SC': 1, 'recall': 1, 'pieces': 1, 'merged': 0, 'unlabelled': 0}


def test_tables_and_figure_compare_all_methods(tmp_path, capsys):
    pytest.importorskip('matplotlib', reason='the extra plane_detector[benchmark] is missing')
    found = [sample(method=method, noise=noise, covering=covering, scene=scene, cpu_ms=cpu_ms,
                    shares=(0.03,), found=(1,))
             for noise in (0.004, 0.01) for method in ('ours', 'other')
             for scene, covering, cpu_ms in (('1', 0.5, 2.0), ('2', 0.75, 3.0), ('3', 1.0, 9.0))]
    report(found)
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith('| rooms')] == [
        f'| rooms | {sigma} | ours | 3 | 0.7500 | 0.500 (1) | nan | 0.2500 | 0.1250 | 3.0 | 9.0 |'
        for sigma in ('0.004', '0.01')]
    cells = '0.750 / nan / 0.250 | 0.750 / nan / 0.250 | 3'
    assert [line for line in lines if line.startswith(('| ours', '| other'))] == [
        f'| {method} | 3 | {cells} |' for method in ('ours', 'other')]
    drawn = [write_figure(found, tmp_path).read_text() for _ in range(2)]
    assert '<svg' in drawn[0]
    assert drawn[0] == drawn[1], 'the same samples, the same file'
