# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of units: a scene has the same planes in metres and in relative disparity."""

import numpy as np
import pytest

from plane_detector.evaluation.benchmark import units
from plane_detector.evaluation.benchmark.__main__ import main


def test_agreement_counts_the_pixels_on_the_corresponding_plane():
    labels = np.array([[0, 0, 0, 1, 1, -1]])
    assert units.agreement(labels, labels) == 1
    assert units.agreement(labels, np.array([[4, 4, -1, 2, 3, 0]])) == pytest.approx(3 / 5)
    assert units.agreement(labels, np.full((1, 6), -1)) == 0
    assert units.agreement(np.full((1, 6), -1), labels) == 0


def test_rooms_have_the_same_planes_in_all_units(capsys, tmp_path):
    main(['units', '--rooms', '1', '--first-seed', '300', '--shares', '0.01', '--data',
          str(tmp_path), '--output', str(tmp_path / 'images')])
    rows = [[cell.strip() for cell in line.split('|')[1:-1]]
            for line in capsys.readouterr().out.splitlines() if line.startswith('| room')]
    assert [cells[0] for cells in rows] == ['room 300, size 1', 'room 300, size 10']
    for _, _, metric, disparity, relative, same, same_relative, labelled in rows:
        assert int(metric) > 3 and metric == disparity == relative
        assert float(same) > 0.99 and float(same_relative) > 0.99
        assert float(labelled) > 0.9
    assert len(list((tmp_path / 'images').glob('*.png'))) == 2


def test_strong_networks_have_the_same_planes_in_all_units(data_folder):
    for frame in units.strong_networks(data_folder / units.STRONG):
        found = units.in_all_units(frame, 0.006, units.NO_DIRECTIONS)
        metric = found['metric_depth']
        assert metric.count >= 5
        assert metric.count == found['disparity'].count
        # The floors of the noise differ by a thousandth, which decides single cells.
        assert abs(metric.count - found['relative_disparity'].count) <= 2
        assert units.agreement(metric.labels, found['relative_disparity'].labels) > 0.97
