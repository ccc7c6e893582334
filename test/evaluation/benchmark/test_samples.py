# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes are scored at every noise; what the benchmarks measure is what it says."""

from dataclasses import replace

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest

from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark import samples, shapes
from plane_detector.evaluation.benchmark.ablation import STAGES, Without, changes
from plane_detector.evaluation.benchmark.samples import (
    CURVED,
    SIGMAS,
    Job,
    Sample,
    curved_scene,
    noisy_depth,
    plan,
    room,
    run_job,
)
from plane_detector.evaluation.datasets import UNKNOWN, LabelledFrame
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.evaluation.scenes.sensors import SENSORS
from plane_detector.evaluation.scenes.shapes import SeenShape, ShapeScene
from plane_detector.types import CameraIntrinsics, ShapeType

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=20, distance_m=2.0)
COUNTS = {'rooms': 2, 'living': 1, 'curved': 2}


class Fixed(peers.Method):
    """Gives these labels and planes."""

    name = 'fixed'

    def __init__(self, labels=WALL.labels, planes=WALL.planes):
        self.segments = labels, planes

    def run(self, prepared):
        return self.segments

    def result(self, raw):
        return raw


def sample(method='ours', scene='1', covering=0.5, recall=np.nan, **differences):
    numbers = {'SC': covering, 'recall': recall, 'precision': 0.25, 'unlabelled': 0.125}
    return replace(Sample(method, 'rooms', scene, 0.004, 1.0, numbers), **differences)


def test_a_scene_is_measured_at_every_noise(monkeypatch):
    monkeypatch.setitem(samples.SCENES, 'rooms', lambda seed: WALL)
    jobs = plan([Fixed()], COUNTS, 9000, 1, [])
    assert [(job.kind, job.scene) for job in jobs] == [
        ('rooms', 9000), ('rooms', 9001), ('lived-in rooms', 9000), ('curved', 0),
        ('curved', len(CURVED) - 1)]
    found = run_job(jobs[0])
    assert [one.noise for one in found] == [*SIGMAS, *SENSORS]
    assert all(one.numbers == {'SC': 1, 'recall': 1, 'precision': 1, 'unlabelled': 0}
               for one in found)
    assert all(one.plane_shares == [1] and one.found == [True] for one in found)


@pytest.mark.parametrize('index', range(0, len(CURVED), 7))
def test_the_labels_of_a_curved_scene_are_judged(index):
    scene = curved_scene(index)
    is_curved, rows = scene.labels < 0, np.indices(scene.labels.shape)[0]
    assert 0.02 < (is_curved & np.isfinite(scene.depth_m)).mean() < 0.9
    half = np.where(is_curved & (rows % 2 == 0), len(scene.planes), scene.labels)
    for labels, taken in ((scene.labels, 0), (half, pytest.approx(0.5, abs=0.01)),
                          (np.zeros_like(half), 1)):
        planes = np.zeros((labels.max() + 1, 4))
        (found,) = run_job(Job('curved', index, (0.0,), [Fixed(labels, planes)]))
        assert found.numbers['curved'] == taken
        assert (found.numbers['IoU'] == 1) == (taken != 1)


def test_a_frame_labelled_by_hand_is_scored_on_its_labels():
    labels = WALL.labels.copy()
    labels[:, :40] = UNKNOWN
    frame = LabelledFrame('office', '1', WALL.rgb, WALL.depth_m, SMALL, labels)
    found, = run_job(plan([Fixed()], dict.fromkeys(COUNTS, 0), 9000, 1, [frame])[0])
    assert found.numbers == {'SC': 1, 'recall': 1, 'pieces': 1, 'merged': 0, 'unlabelled': 0}


def test_without_a_stage_the_planes_that_it_adds_are_missing():
    scene = room(8004)
    given = scene.depth_m, scene.intrinsics
    labels, planes = peers.Ours()(*given)
    fewer, found = Without('small planes', ['small planes'])(*given)
    assert len(found) < len(planes)
    assert np.count_nonzero(fewer >= 0) < np.count_nonzero(labels >= 0)
    _, found = Without('all', list(STAGES))(noisy_depth(scene, 0.004, 8004), scene.intrinsics)
    assert len(found) >= 3
    np.testing.assert_array_equal(peers.Ours()(*given)[0], labels)


def test_changes_are_those_of_the_same_scene():
    found = changes([sample('ours', '1', 0.9, 1.0), sample('ours', '2', 0.5),
                     sample('less', '1', 0.8, 0.5), sample('less', '2', 0.4)], ('SC', 'recall'))
    assert found.splitlines()[2:] == ['| all stages | 0.700 / 1.000 |',
                                      '| without less | -0.100 (0.000) / -0.500 |']


def seen(kind, rows, radius=0.2, axis=(0.0, 1.0, 0.0)):
    mask = np.zeros((100, 100), bool)
    mask[rows] = True
    return SeenShape(kind, np.zeros(3), np.array(axis), radius, 0.0, mask)


def test_matches_need_the_type_and_half_of_the_pixels():
    column, ball, small = true = (
        seen(ShapeType.CYLINDER, np.s_[:20]), seen(ShapeType.SPHERE, np.s_[40:60], axis=(0, 0, 0)),
        seen(ShapeType.CONE, np.s_[80:85]))
    found = [seen(ShapeType.CYLINDER, np.s_[:18], 0.22), seen(ShapeType.CONE, np.s_[40:60]),
             seen(ShapeType.CYLINDER, np.s_[0:20])]
    ((shape, matched),), (missed,), wrong = shapes.match(ShapeScene(None, true, ''), found)
    assert shape is found[0] and matched is column
    assert missed is ball, 'the cone is too small to be missed'
    assert wrong == 2
