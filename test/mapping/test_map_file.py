# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The file of a map: there and back, damaged, of another frame, of a later version, too large."""

import json
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from map_file_faults import hostile, odd_bytes, odd_fields, set_field

from plane_detector.config import MapConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.cells import Cells
from plane_detector.mapping.map_file import SavedMap, read_map, write_map
from plane_detector.mapping.map_plane import CLASSES, MapPlane, as_planes, rectangles_of
from plane_detector.mapping.plane_map import PlaneMap


def surface(label, rng, cells=(60, 80), apart=()):
    seen = (rng.random(cells) < 0.97).astype(np.uint8)
    return MapPlane(label, rng.normal(size=3), np.eye(3), rng.normal(0, 0.01, 3),
                    np.diag(rng.uniform(1e-6, 1e-5, 3)),
                    Cells((-3, 5), 10 * seen, 10 * seen, 0.04), 7, 1.5, 9.25, 3,
                    np.eye(CLASSES)[3], frozenset(apart))


def write(path, saved):
    to_poses = saved.transform.inverse()
    write_map(path, saved, as_planes(saved.planes).moved(to_poses))


@pytest.fixture
def saved():
    rng = np.random.default_rng(0)
    return SavedMap((surface(4, rng, apart=[9]), surface(9, rng, apart=[4])),
                    RigidTransform.from_quaternion((0, 0, 0.1, 1), (0.1, 0.2, 0.3)), 'odom', 12.5)


def test_there_and_back(saved, tmp_path):
    file = tmp_path / 'map.json'
    write(file, saved)
    back = read_map(file, 'odom')
    assert back.stamp_s == saved.stamp_s
    assert back.transform.translation_m == pytest.approx(saved.transform.translation_m)
    assert back.transform.rotation == pytest.approx(saved.transform.rotation)
    for before, after in zip(saved.planes, back.planes, strict=True):
        assert (after.cells.seen == before.cells.seen).all()
        for name in ('label', 'views', 'first_seen_s', 'last_seen_s', 'apart', 'plane_class'):
            assert getattr(after, name) == getattr(before, name)
        for name in ('origin_m', 'axes', 'coefficients', 'covariance'):
            assert (getattr(after, name) == getattr(before, name)).all()
    assert list(tmp_path.iterdir()) == [file]


def test_others_can_read_the_planes_where_the_last_pose_sees_them(saved, tmp_path):
    write(tmp_path / 'map.json', saved)
    row = json.loads((tmp_path / 'map.json').read_text())['planes'][0]
    corner = np.array(row['polygons'][0]['corners'][0])
    assert np.dot(row['normal'], corner) + row['d'] == pytest.approx(0, abs=2e-3)
    assert row['class'] == 'wall'


@pytest.fixture
def good(saved, tmp_path):
    """Return the content of a good file, and a map that was loaded from it."""
    write(tmp_path / 'good.json', saved)
    planes = PlaneMap()
    planes.load(tmp_path / 'good.json', 'odom')
    return json.loads((tmp_path / 'good.json').read_text()), planes


def refuse(planes, data, path):
    """Load what is refused, and check that the map stays; return the reason."""
    before = planes.snapshot()
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    with pytest.raises(ValueError, match='.') as refused:
        planes.load(path, 'odom')
    after = planes.snapshot()
    assert after.surfaces == before.surfaces
    assert (after.planes.covariances == before.planes.covariances).all()
    return str(refused.value)


@pytest.mark.parametrize('change, reason', [
    (lambda text: text[:len(text) // 2], 'is not a whole map'),
    (lambda text: '', 'is not a whole map'),
    (lambda text: '[' * 200_000, 'is not a whole map'),
    (lambda text: '[1, 2]', 'it has no version'),
    (lambda text: text.replace('"version": 1', '"version": 2'), 'version 2, this program reads'),
    (lambda text: text.replace('"frame": "odom"', '"frame": "map"'), "the frame 'map', not in"),
    (lambda text: text + 32_000_000 * ' ', 'too large'),
    (lambda text: '[' + 2_000_000 * '0,' + '0]', 'is not a map of planes'),
    (lambda text: '[' + 2_000_001 * '0,' + '0]', 'more than 2000000 values'),
    (lambda text: 500_001 * '[', 'lists and objects')])
def test_a_file_that_does_not_fit_is_refused_and_the_map_stays(good, tmp_path, change, reason):
    content, planes = good
    assert reason in refuse(planes, change(json.dumps(content)), tmp_path / 'bad.json')


@pytest.mark.parametrize('field, value', [
    ('planes.0.label', 2**40), ('planes.0.label', -1), ('planes.0.label', 0),
    ('planes.0.label', True), ('planes.0.label', 9), ('planes.1.label', 4),
    ('planes.0.views', -1), ('planes.0.views', 2**40), ('planes.0.views', 2.5),
    ('planes.0.votes', [1]), ('planes.0.votes.0', -1), ('planes.0.apart', [2**40]),
    ('planes.0.first_seen', float('nan')), ('planes.0.last_seen', '1'),
    ('planes.0.kept.cell', 0), ('planes.0.kept.cell', -1), ('planes.0.kept.cell', float('nan')),
    ('planes.1.kept.cell', 0.05), ('planes.0.kept.low', [0]), ('planes.0.kept.low.0', 3000),
    ('planes.0.kept.low.0', 2000), ('planes.0.kept.columns', 0), ('planes.0.kept.columns', -80),
    ('planes.0.kept.columns', 79), ('planes.0.kept.columns', 10**9),
    ('planes.0.kept.runs', [10**11]), ('planes.0.kept.runs', [0, 4096 * 4096 + 80]),
    ('planes.0.kept.runs', [4800]), ('planes.0.kept.runs', [-1, 4801]), ('planes.0.kept.runs', []),
    ('planes.0.kept.origin', 2), ('planes.0.kept.origin.1', float('inf')),
    ('planes.0.kept.axes', [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    ('planes.0.kept.axes', [[1, 0, 0], [0, 1, 0], [0, 1, 0]]),
    ('planes.0.kept.axes', [[2, 0, 0], [0, 2, 0], [0, 0, 2]]),
    ('planes.0.kept.coefficients', [5.0, 0, 0]), ('planes.0.kept.coefficients', [0, 0]),
    ('planes.0.kept.covariance', [[0] * 3] * 3), ('planes.0.kept.covariance.0.1', 1.0),
    ('planes.0.kept.covariance', [[1e-6, 2e-6, 0], [2e-6, 1e-6, 0], [0, 0, 1e-6]]),
    ('planes.0.kept', []), ('planes.0', 3), ('planes', {}), ('frame', ''), ('frame', 3),
    ('stamp', float('-inf')), ('correction.translation', 2),
    ('correction.translation.2', float('nan')), ('correction.quaternion', [0, 0, 0, 0]),
    ('correction.quaternion', [0, 0, 0, 2]), ('correction', None)])
def test_the_field_that_is_not_what_it_must_be_is_named(good, tmp_path, field, value):
    content, planes = good
    reason = refuse(planes, set_field(content, field, value), tmp_path / 'bad.json')
    names = [name for name in field.split('.') if not name.isdigit()]  # of a number, its list
    assert 'damaged map of planes: ' in reason and names[-1] in reason


def test_fields_for_other_programs_are_not_read(good, tmp_path):
    content, planes = good
    for field in ('class', 'normal', 'd', 'covariance', 'area', 'polygons'):
        (tmp_path / 'odd.json').write_text(set_field(content, f'planes.0.{field}', 'x'))
        planes.load(tmp_path / 'odd.json', 'odom')
    assert [plane.label for plane in planes.planes] == [4, 9]


@pytest.mark.parametrize('odd', ['fields', 'bytes'])
def test_whatever_a_file_holds_the_map_is_whole_and_goes_on(good, tmp_path, odd, monkeypatch):
    """What is refused changes nothing; what is accepted can be shown and written again."""
    monkeypatch.setattr('os.fsync', lambda _: None)
    content, planes = good
    kinds = {'fields': odd_fields(content),
             'bytes': odd_bytes(json.dumps(content), np.random.default_rng(0), 1000)}
    path, accepted = tmp_path / 'odd.json', 0
    for case, data in kinds[odd]:
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        before = planes.planes
        try:
            planes.load(path, 'odom')
        except ValueError:
            assert planes.planes is before, case
            continue
        accepted += 1
        shown = planes.snapshot()
        assert np.isfinite(shown.planes.covariances).all(), case
        assert np.isfinite(rectangles_of(shown.surfaces).centres_m).all(), case
        planes.save(path, 'odom', 0.0)
        read_map(path, 'odom')
    assert accepted > 10


def test_files_that_cost_much_are_refused_and_take_little_memory(good, tmp_path):
    _, planes = good
    for name, data in hostile().items():
        path = tmp_path / name
        path.write_bytes(data)
        del data
        tracemalloc.start()
        try:
            with pytest.raises(ValueError, match='.'):
                planes.load(path, 'odom')
            assert tracemalloc.get_traced_memory()[1] < 200e6, name
        finally:
            tracemalloc.stop()


def test_a_time_that_is_not_known_stays_so(saved, tmp_path):
    """As of images without a stamp in Python: JSON has no NaN."""
    write(tmp_path / 'map.json', replace(saved, stamp_s=math.nan))
    assert math.isnan(read_map(tmp_path / 'map.json').stamp_s)
    assert 'NaN' not in (tmp_path / 'map.json').read_text()


def test_other_cells_are_refused_with_their_size(saved, tmp_path):
    write(tmp_path / 'map.json', saved)
    with pytest.raises(ValueError, match=r'cells of 0.04 m, map.cell is 0.05: set it to that'):
        PlaneMap(MapConfig(cell=0.05)).load(tmp_path / 'map.json', 'odom')


def test_what_is_no_file_is_not_read(tmp_path):
    with pytest.raises(ValueError, match='is not a file'):
        read_map(tmp_path)


def test_a_file_that_cannot_be_written_leaves_the_one_before(saved, tmp_path, monkeypatch):
    file = tmp_path / 'map.json'
    write(file, saved)
    before = file.read_text()

    def full(_descriptor):
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr('os.fsync', full)
    with pytest.raises(OSError, match='the map cannot be written to'):
        write(file, SavedMap((), saved.transform, 'odom', 0.0))
    assert file.read_text() == before
    assert list(tmp_path.iterdir()) == [file]


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        PlaneMap().load(tmp_path / 'none.json', 'odom')


def test_a_hundred_planes_take_at_most_a_megabyte(tmp_path):
    rng = np.random.default_rng(0)
    write(tmp_path / 'map.json', SavedMap(
        tuple(surface(label, rng, (40, 50)) for label in range(1, 101)),
        RigidTransform.identity(), 'odom', 0.0))
    assert (tmp_path / 'map.json').stat().st_size < 1e6
