# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The table of scores: a front that falls fails, what has no data is no pass, floors only rise."""

from dataclasses import replace

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest

from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.evaluation.scores import __main__ as program
from plane_detector.evaluation.scores import classes
from plane_detector.evaluation.scores.clips import Shot
from plane_detector.evaluation.scores.measured import lost_planes
from plane_detector.evaluation.scores.table import (
    HIGHER,
    LOWER,
    Floor,
    Measurement,
    Row,
    deviation,
    first_seed,
    read_floors,
    renewed,
    write_floors,
)
from plane_detector.types import PlaneClass, Planes, PlaneSegmentation

SEEDS = '2026-11-27'


@pytest.fixture
def scores(monkeypatch, tmp_path, capsys):
    """Return a function: run measurements; return exit code, output, path of the floors."""
    monkeypatch.setattr(program, 'compile_kernels', lambda subjects: None)
    monkeypatch.setattr(program, 'FLOORS', tmp_path / 'floors.csv')

    def run(measurements, floors, *arguments):
        monkeypatch.setattr(program, 'MEASUREMENTS', measurements)
        monkeypatch.setattr(program, 'GROUPS', tuple({one.group for one in measurements}))
        write_floors(program.FLOORS, SEEDS, floors)
        code = program.main(['--processes', '1', '--data', 'nowhere', '--cases', 'nowhere',
                             *arguments])
        return code, capsys.readouterr().out, program.FLOORS
    return run


def measured(value, better=HIGHER, **options):
    return Measurement('walls', lambda draw: {'walls: SC': value}, {'walls: SC': better},
                       **options)


@pytest.mark.parametrize(('better', 'floor', 'code'), [
    (HIGHER, 0.85, 0), (HIGHER, 0.89, 0), (HIGHER, 0.93, 1),
    (LOWER, 0.85, 0), (LOWER, 0.77, 0), (LOWER, 0.73, 1)])
def test_a_front_fails_below_its_floor_by_more_than_the_spread(scores, better, floor, code):
    floors = {'walls: SC': Floor(floor, 0.1, 'abc')}
    assert scores((measured(0.8 if better == HIGHER else 0.86, better),), floors)[0] == code


def test_a_front_that_raises_fails_and_the_others_are_measured(scores):
    def broken(draw):
        raise ValueError('no lens')
    table = (Measurement('walls', broken, {'walls: recall': HIGHER}), measured(0.9))
    code, text, _ = scores(table, {})
    assert code == 1
    assert 'FAILS: ValueError: no lens' in text
    assert '0.9 ± 0' in text


def test_without_its_data_a_front_is_not_run_and_no_pass(scores):
    code, text, _ = scores((measured(0.9, needs=('data',)),), {'walls: SC': Floor(0.5, 0, 'abc')})
    assert code == 0
    assert 'not run: no data, nowhere is not there' in text
    assert '1 not run' in text
    assert 'holds' not in text


@pytest.mark.parametrize(('value', 'reason', 'kept'), [
    (0.95, '', 0.95), (0.905, '', 0.9), (0.85, '', 0.9), (0.85, 'half the time', 0.85)])
def test_floors_rise_by_more_than_their_spread_and_fall_for_a_reason(scores, value, reason, kept):
    _, _, path = scores((measured(value),), {'walls: SC': Floor(0.9, 0.01, 'abc')},
                        '--write-floors', '--reason', reason)
    seeds, floors = read_floors(path)
    assert seeds == SEEDS
    assert floors['walls: SC'].value == kept
    assert floors['walls: SC'].reason == (reason if kept < 0.9 else '')


def test_a_front_that_was_not_run_keeps_its_floor():
    floors = {'walls: SC': Floor(0.9, 0.01, 'abc')}
    assert renewed(floors, [Row('walls', 'walls: SC', HIGHER)], 'def', 'any') == floors


def test_the_spread_is_two_errors_of_the_mean_of_the_draws():
    row = Row('', '', HIGHER, {1: [0.1, 0.3], 2: [0.5, 0.7], 3: [0.9, float('nan')]})
    assert row.value == pytest.approx(0.5)
    assert row.worst == 0.1
    assert row.spread == pytest.approx(2 * np.std([0.2, 0.6, 0.9], ddof=1) / 3**0.5)


def test_the_deviation_is_that_of_each_image():
    row = Row('', 'walls', LOWER, {1: [1.0, 50.0], 2: [3.0, 50.0]})
    assert deviation(row).value == pytest.approx((2**0.5 + 0) / 2)


def test_seeds_of_a_date_are_for_reporting():
    assert first_seed('9000') == 9000
    assert {first_seed(f'2026-11-{day}') - first_seed('2026-11-10') for day in (11, 12)} == {
        100, 200}
    assert first_seed('2027-05-19') >= 9000
    with pytest.raises(ValueError, match='are for tuning'):
        first_seed('8999')


def test_every_floor_is_of_a_front_and_every_name_is_of_one():
    names = [name for one in program.MEASUREMENTS for name in one.all_fronts]
    assert len(names) == len(set(names))
    assert set(read_floors(program.FLOORS)[1]) <= set(names)


def detection(scene, wanted):
    """Return the true planes of a scene with a class each."""
    planes = Planes.of([])
    count = len(scene.planes)
    planes = replace(planes, offsets_m=np.zeros(count), classes=np.array(wanted, np.uint8))
    return PlaneSegmentation(planes, scene.labels, 0.0)


def test_classes_by_depth_are_those_of_the_planes():
    scene = random_room(np.random.default_rng(11))
    by_planes = classes.classes_of_planes(scene)
    by_depth = classes.classes_of_depth(scene.depth_m, scene.intrinsics, scene.gravity_camera)
    known = by_depth != classes.UNKNOWN
    assert known.mean() > 0.5
    # Windows beside edges see both sides.
    assert (by_depth == by_planes)[known].mean() > 0.95


def test_shares_of_right_and_wrong_classes():
    scene = single_wall()
    truth = classes.classes_of_planes(scene)
    shares = {wanted: classes.class_shares(detection(scene, [wanted]), truth)
              for wanted in (PlaneClass.WALL, PlaneClass.FLOOR, PlaneClass.UNKNOWN)}
    assert shares == {PlaneClass.WALL: (1.0, 0.0), PlaneClass.FLOOR: (0.0, 1.0),
                      PlaneClass.UNKNOWN: (0.0, 0.0)}


@pytest.mark.parametrize('quarters', [1, 2, 3])
def test_a_turned_camera_sees_the_same_points(quarters):
    scene = random_room(np.random.default_rng(3))
    shot = Shot(scene.rgb, scene.depth_m, scene.intrinsics, scene.gravity_camera, 0.0)
    turned = shot.turned(quarters)
    # Down keeps its angle to the ray of each pixel: of the brightest one, found in both images.
    marked = np.zeros(scene.labels.shape)
    marked[100, 500] = 1
    (row, column), = np.argwhere(np.rot90(marked, quarters) == 1)

    def cosine(one, v, u):
        ray = np.array([(u - one.intrinsics.cx) / one.intrinsics.fx,
                        (v - one.intrinsics.cy) / one.intrinsics.fy, 1.0])
        return one.down @ ray / np.linalg.norm(ray)
    assert turned.depth_m[row, column] == scene.depth_m[100, 500]
    assert cosine(turned, row, column) == pytest.approx(cosine(shot, 100, 500))
    assert turned.rgb.shape[:2] == (turned.intrinsics.height, turned.intrinsics.width)


def test_a_plane_whose_holes_flicker_is_not_lost():
    halves = [np.where(np.indices((8, 8))[1] % 4 < 2, 0, -1),
              np.where(np.indices((8, 8))[1] % 4 > 0, 0, -1)]
    everywhere = np.ones((8, 8), bool)
    assert lost_planes(*halves, everywhere)[0] == 1
    seen = (halves[0] == 0) & (halves[1] == 0)
    assert lost_planes(*halves, seen) == (0, [(0, 0)])
    assert lost_planes(halves[0], np.full((8, 8), -1), everywhere)[0] == 1
