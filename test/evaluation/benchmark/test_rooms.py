# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of rendered rooms, and a perfect score for the truth."""

import cv2
import numpy as np
import pytest

from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark.living_rooms import furnished, report_living
from plane_detector.evaluation.benchmark.rooms import (
    HELD_OUT,
    reliability,
    report_rooms,
    room,
    room_score,
)
from plane_detector.evaluation.benchmark.tables import table


class Truth(peers.Method):
    """Returns the true labels, and optionally labels curved surfaces as planes."""

    def __init__(self, scene, curved=False):
        self.scene, self.curved = scene, curved

    def __call__(self, depth_m, intrinsics):
        labels = self.scene.labels.copy()
        if self.curved:
            labels[labels < 0] = len(self.scene.planes)
        return labels, np.vstack([self.scene.planes, [0, 0, -1, 2]])[:labels.max() + 1]


@pytest.mark.parametrize('scene_of', [room, furnished])
def test_the_truth_has_a_perfect_score(scene_of):
    scene = scene_of(0)
    best = room_score(Truth(scene), 0, 0.0, scene_of)
    assert best.segmentation_covering == best.rand_index == best.recall == best.precision == 1
    assert best.normal_error_deg == pytest.approx(0, abs=1e-4)


def test_curved_pixels_count_as_no_plane():
    scene = furnished(0)
    planes = len(scene.planes)
    called_flat = room_score(Truth(scene, curved=True), 0, 0.0, furnished)
    assert called_flat.precision == pytest.approx(planes / (planes + 1))


def test_rooms_are_reported_with_the_absent_named(capsys):
    absent = peers.Ours()
    absent.name, absent.absent = 'nowhere', 'nothing of that name is installed'
    report_rooms([peers.Ours(), absent], count=1, slow_count=1)
    text = capsys.readouterr().out
    assert 'nowhere: absent, nothing of that name is installed.' in text
    assert text.count('| plane_detector | 0 | 1 |') == 2, 'tuning and held-out'
    assert 'share that match' in text


def test_living_rooms_are_reported_and_drawn(capsys, tmp_path):
    report_living([peers.Ours()], count=1, slow_count=1, output=tmp_path / 'sheets')
    text = capsys.readouterr().out
    assert '### Rendered living rooms, tuning seeds 0 to 0' in text
    assert f'### Rendered living rooms, held-out seeds {HELD_OUT} to {HELD_OUT}' in text
    assert text.count('| plane_detector | 0.004 | 1 |') == 2
    sheet = cv2.imread(str(tmp_path / 'sheets' / 'living_rooms.png'))
    assert sheet.shape[1] > 6 * 320
    assert sheet.shape[0] < 2 * 320, 'one row for one room'


def test_tables_are_markdown():
    assert table(('a', 'b'), [(1, 'x')]) == '| a | b |\n| --- | --- |\n| 1 | x |'


def test_reliability_by_hand():
    text = reliability(np.array([0.5, 0.72, 0.78, 1.0]), np.array([False, True, False, True]))
    assert '| 0 to 0.5 | 1 | 0.50 | 0.00 |' in text
    assert '| 0.7 to 0.8 | 2 | 0.75 | 0.50 |' in text
    assert '| 0.95 to 1 | 1 | 1.00 | 1.00 |' in text
    assert '| 0.5 to 0.7 | 0 | nan | nan |' in text
