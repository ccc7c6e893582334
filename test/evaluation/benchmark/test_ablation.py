# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Stages are switched off one at a time and come back; changes are paired by scene."""

import inspect
from pkgutil import resolve_name

import numpy as np
import pytest

from plane_detector.evaluation.benchmark.ablation import STAGES, Without, changes, switched_off
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


@pytest.mark.parametrize('stage', STAGES)
def test_what_is_called_instead_takes_the_same_arguments(stage):
    place, instead = STAGES[stage]
    original = resolve_name(place)
    original = getattr(original, '_function', original)  # of a compiled one
    assert len(inspect.signature(original).parameters) == len(
        inspect.signature(instead).parameters)


def test_every_stage_is_switched_off_where_it_is_called_and_comes_back():
    before = {stage: resolve_name(place) for stage, (place, _) in STAGES.items()}
    with switched_off(list(STAGES)):
        assert all(resolve_name(place) is instead for place, instead in STAGES.values())
    assert before == {stage: resolve_name(place) for stage, (place, _) in STAGES.items()}


def test_a_stage_comes_back_after_an_error():
    place = STAGES['small planes'][0]
    before = resolve_name(place)
    with pytest.raises(ZeroDivisionError), switched_off(['small planes']):
        raise ZeroDivisionError
    assert resolve_name(place) is before


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
