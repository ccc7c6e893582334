# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A map as floor plan and as PLY: a room with a doorway and a table, built by hand."""

import json
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from map_helpers import map_plane

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.map_file import SavedMap, write_map
from plane_detector.mapping.map_plane import new_axes
from plane_detector.tools.export import floor_plan, main
from plane_detector.types import PlaneClass


def surface(label, kind, normal, origin, seen):
    axes = new_axes(np.array([normal], float), np.eye(3)[2])[0]
    return map_plane(label, kind, origin, axes, 10 * seen)


@pytest.fixture
def saved():
    """A floor, a wall of 4 m with a doorway of .9 m under a lintel, and a table .75 m high."""
    wall = np.ones((50, 80))
    wall[:42, 30:48] = 0
    return SavedMap((surface(1, PlaneClass.FLOOR, (0, 0, 1), (0, 0, 0.1), np.ones((60, 80))),
                     surface(2, PlaneClass.WALL, (0, -1, 0), (0, 3, 0.1), wall),
                     surface(3, PlaneClass.OTHER_HORIZONTAL, (0, 0, 1), (1, 1, 0.85),
                             np.ones((14, 24)))),
                    RigidTransform.identity(), 'odom', 1.0)


def test_a_doorway_is_a_gap_and_the_table_has_height_and_size(saved):
    plan = floor_plan(saved)
    lengths = sorted(np.linalg.norm(ends[1] - ends[0]) for _, ends in plan.walls)
    assert lengths == pytest.approx([1.5, 1.6], abs=1e-6)
    assert {label for label, _ in plan.walls} == {2}
    floor, table = plan.levels
    assert (floor.kind, table.kind) == ('floor', 'surface')
    assert floor.height_m == pytest.approx(0)
    assert table.height_m == pytest.approx(0.75)
    assert table.size_m == pytest.approx((1.2, 0.7), abs=0.01)


def test_files(saved, tmp_path, capsys):
    write_map(tmp_path / 'map.json', saved)
    names = {option: tmp_path / name for option, name in (
        ('--floor-plan', 'plan.svg'), ('--geojson', 'plan.json'), ('--ply', 'planes.ply'),
        ('--keep-out', 'keep_out.yaml'))}
    words = [word for option, path in names.items() for word in (option, str(path))]
    assert main([str(tmp_path / 'map.json'), *words]) == 0
    svg = ElementTree.parse(names['--floor-plan']).getroot()
    assert len([one for one in svg if one.tag.endswith('line')]) == 2
    kinds = [feature['properties']['kind'] for feature in json.loads(
        names['--geojson'].read_text())['features']]
    assert kinds == ['wall', 'wall', 'floor', 'surface']
    mask = cv2.imread(str(tmp_path / 'keep_out.pgm'), cv2.IMREAD_UNCHANGED)
    _, columns = np.nonzero(mask == 0)
    assert len(columns) == pytest.approx(3.1 / 0.05, abs=4)  # 1.5 and 1.6 m of wall
    assert 'origin: [' in (tmp_path / 'keep_out.yaml').read_text()
    assert 'element face' in names['--ply'].read_text()
    assert 'is written' in capsys.readouterr().out


def test_a_file_that_is_no_map_gives_a_reason(tmp_path, capsys):
    (tmp_path / 'map.json').write_text('{')
    assert main([str(tmp_path / 'map.json'), '--ply', str(tmp_path / 'out.ply')]) == 1
    assert 'is not a whole map' in capsys.readouterr().err
