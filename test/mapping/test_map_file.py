# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The file of a map: there and back, damaged, of another frame, of a later version, too large."""

import json

import numpy as np
import pytest

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.cells import Cells
from plane_detector.mapping.map_file import SavedMap, read_map, write_map
from plane_detector.mapping.map_plane import CLASSES, MapPlane
from plane_detector.mapping.plane_map import PlaneMap


def surface(label, rng, cells=(60, 80)):
    seen = (rng.random(cells) < 0.97).astype(np.uint8)
    return MapPlane(label, rng.normal(size=3), np.eye(3), rng.normal(0, 0.01, 3),
                    np.diag(rng.uniform(1e-6, 1e-5, 3)),
                    Cells((-3, 5), 10 * seen, 10 * seen, 0.04), 7, 1.5, 9.25, 3,
                    np.eye(CLASSES)[3], frozenset({label + 1}))


@pytest.fixture
def saved():
    rng = np.random.default_rng(0)
    return SavedMap(tuple(surface(label, rng) for label in (4, 9)),
                    RigidTransform.from_quaternion((0, 0, 0.1, 1), (0.1, 0.2, 0.3)), 'odom', 12.5)


def test_there_and_back(saved, tmp_path):
    file = tmp_path / 'map.json'
    write_map(file, saved)
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
    write_map(tmp_path / 'map.json', saved)
    row = json.loads((tmp_path / 'map.json').read_text())['planes'][0]
    corner = np.array(row['polygons'][0]['corners'][0])
    assert np.dot(row['normal'], corner) + row['d'] == pytest.approx(0, abs=2e-3)
    assert row['class'] == 'wall'


@pytest.mark.parametrize('change, reason', [
    (lambda text: text[:len(text) // 2], 'is not a whole map'),
    (lambda text: '', 'is not a whole map'),
    (lambda text: '[1, 2]', 'it has no version'),
    (lambda text: text.replace('"version":1', '"version":2'), 'version 2, this program reads up'),
    (lambda text: text.replace('"frame":"odom"', '"frame":"map"'), 'the frame map, not in odom'),
    (lambda text: text.replace('"coefficients"', '"other"'), 'damaged map of planes: KeyError'),
    (lambda text: text.replace('"runs":[', '"runs":[-1,'), 'damaged map of planes')])
def test_a_file_that_does_not_fit_is_refused_and_the_map_stays(saved, tmp_path, change, reason):
    file = tmp_path / 'map.json'
    write_map(file, saved)
    planes = PlaneMap()
    planes.load(file, 'odom')
    file.write_text(change(file.read_text()))
    with pytest.raises(ValueError, match=reason):
        planes.load(file, 'odom')
    assert [plane.label for plane in planes.planes] == [4, 9]


def test_a_file_that_cannot_be_written_leaves_the_one_before(saved, tmp_path, monkeypatch):
    file = tmp_path / 'map.json'
    write_map(file, saved)
    before = file.read_text()

    def full(_descriptor):
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr('os.fsync', full)
    with pytest.raises(OSError, match='the map cannot be written to'):
        write_map(file, SavedMap((), saved.transform, 'odom', 0.0))
    assert file.read_text() == before
    assert list(tmp_path.iterdir()) == [file]


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        PlaneMap().load(tmp_path / 'none.json', 'odom')


def test_a_hundred_planes_take_at_most_a_megabyte(tmp_path):
    rng = np.random.default_rng(0)
    write_map(tmp_path / 'map.json', SavedMap(
        tuple(surface(label, rng, (40, 50)) for label in range(1, 101)),
        RigidTransform.identity(), 'odom', 0.0))
    assert (tmp_path / 'map.json').stat().st_size < 1e6
