# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Stages are switched off one at a time and come back; changes are paired by scene."""


import numpy as np
import pytest

from plane_detector.evaluation.benchmark.ablation import STAGES, Without, changes
from plane_detector.evaluation.benchmark.rooms import noisy_depth, room
from plane_detector.evaluation.benchmark.samples import Sample
from plane_detector.evaluation.peers import Ours

SEED = 8004


@pytest.fixture(scope='module')
def scene():
    return room(SEED)


def sample(method, scene, covering, recall):
    return Sample(method, 'rooms', scene, 0.004, 1.0, {'SC': covering, 'recall': recall},
                  np.zeros(0), np.zeros(0, bool))


def test_without_a_stage_the_planes_that_it_adds_are_missing(scene):
    given = noisy_depth(scene, 0.0, SEED), scene.intrinsics
    labels, planes = Ours()(*given)
    fewer, found = Without('small planes', ['small planes'])(*given)
    assert len(found) < len(planes)
    assert np.count_nonzero(fewer >= 0) < np.count_nonzero(labels >= 0)
    np.testing.assert_array_equal(Ours()(*given)[0], labels)


def test_without_all_stages_there_are_still_planes(scene):
    _, planes = Without('all', list(STAGES))(noisy_depth(scene, 0.004, SEED), scene.intrinsics)
    assert len(planes) >= 3


def test_changes_are_those_of_the_same_scene():
    found = changes([sample('ours', '1', 0.9, 1.0), sample('ours', '2', 0.5, np.nan),
                     sample('less', '1', 0.8, 0.5), sample('less', '2', 0.4, np.nan)],
                    ('SC', 'recall'))
    assert found.splitlines()[2:] == ['| all stages | 0.700 / 1.000 |',
                                      '| without less | -0.100 (0.000) / -0.500 |']
