# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every method is timed on one thread."""

import cv2
import numpy as np
import pytest

from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark import runtime
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.process import one_thread
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=0, distance_m=2.0)


@pytest.mark.parametrize('side', [1, 3])
def test_a_mosaic_has_its_planes(side):
    scene = runtime.mosaic(side)
    assert len(scene.planes) == side**2
    assert np.bincount(scene.labels[scene.labels >= 0]).min() > 0.5 * scene.labels.size / side**2


def test_times_are_taken_of_every_method_and_case():
    case = (WALL.depth_m, SMALL)
    ms = runtime.median_ms([peers.Ours()], [case, case], repeats=2)
    assert ms.shape == (1, 2)
    assert (ms > 0).all()


def test_every_table_is_printed_and_frames_have_one(monkeypatch, capsys):
    monkeypatch.setattr(runtime, 'room', lambda seed: WALL)
    monkeypatch.setattr(runtime, 'VGA', SMALL)
    monkeypatch.setattr(runtime, 'mosaic', lambda side: WALL)
    monkeypatch.setattr(runtime, 'SIZES', ((160, 120),))
    frame = Frame('a_set', 'one', WALL.rgb, WALL.depth_m, SMALL)
    runtime.report_times([peers.Ours(), peers.OpenCv(0.03)], 1, [frame])
    titles = [line for line in capsys.readouterr().out.splitlines() if line.startswith('### ')]
    assert [title.split(',')[0] for title in titles] == [
        '### Time at 640 x 480', '### Time by noise', '### Time on real frames',
        '### Time by resolution', '### Time by number of planes']


def test_the_number_of_threads_is_restored():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before
