# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes in the tables and clouds of a replay."""

import numpy as np
import pytest
from bags import write_bag
from clouds import read_ply
from replay_helpers import CAMERA, START_S, camera_messages, rows_of

from plane_detector.evaluation.scenes.rendering import Rectangle, camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import ellipsoid
from plane_detector.ros.outputs.clouds import SHAPE_DTYPE

WALLS = [Rectangle(*(np.array(vector, float) for vector in one)) for one in (
    ([-5, 4, -1], [10, 0, 0], [0, 0, 4]), ([-5, -1, 0], [10, 0, 0], [0, 5, 0]))]
RADIUS_M = 0.5


def with_ball():
    ball = ellipsoid(RADIUS_M, RADIUS_M).at(0.1, 1.9, 0.9).curved_pieces()
    return render(WALLS, camera_rotation(3, -12, 2), np.array([0, 0, 1.2]), CAMERA,
                  np.random.default_rng(0), ball)


def test_shapes_have_a_table_and_their_labels_are_in_the_cloud(replay, tmp_path):
    scene = with_ball()
    source = write_bag(tmp_path / 'walk', camera_messages([scene, scene]))
    code, _, text = replay(source, '-p', 'shapes.types:=all', '--csv', tmp_path / 'planes.csv',
                           '--ply', tmp_path / 'ply')
    assert code == 0, text
    rows = rows_of(tmp_path / 'planes_shapes.csv')
    assert list(rows[0]) == ['frame', 'stamp', *SHAPE_DTYPE.names]
    assert [row['frame'] for row in rows] == ['0', '1']
    assert float(rows[0]['stamp']) == START_S
    assert float(rows[0]['radius']) == pytest.approx(RADIUS_M, rel=0.02)
    labels = read_ply(tmp_path / 'ply' / '000000.ply')[1]['label']
    assert (labels == int(rows[0]['label'])).sum() == int(rows[0]['num_inliers']) > 900
    assert rows[0]['label'] not in {row['label'] for row in rows_of(tmp_path / 'planes.csv')}
