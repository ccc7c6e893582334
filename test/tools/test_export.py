# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A map as floor plan and as PLY: a room with a doorway and a table, built by hand."""

import json
import re
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml
from map_helpers import map_plane

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.map_file import SavedMap, write_map
from plane_detector.mapping.map_plane import as_planes, new_axes
from plane_detector.tools.export import convex_pieces, floor_plan, main, to_ply
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
    write_map(tmp_path / 'map.json', saved, as_planes(saved.planes))
    names = {option: tmp_path / name for option, name in (
        ('--floor-plan', 'plan.svg'), ('--geojson', 'plan.json'), ('--ply', 'planes.ply'),
        ('--keep-out', 'keep_out.yaml'))}
    words = [word for option, path in names.items() for word in (option, str(path))]
    assert main([str(tmp_path / 'map.json'), *words]) == 0
    svg = ElementTree.parse(names['--floor-plan']).getroot()
    walls = [one for one in svg if one.tag.endswith('line')]
    assert len(walls) == 2
    (metre_px,) = (float(re.search(r'h([0-9.]+)', one.get('d'))[1]) for one in svg
                   if one.get('class') == 'ink')
    ends_px = sorted(float(wall.get(end)) for wall in walls for end in ('x1', 'x2'))
    assert np.diff(ends_px) / metre_px == pytest.approx([1.5, 0.9, 1.6], abs=0.01)
    assert float(svg.get('width')) > 600
    texts = [one.text for one in svg if one.tag.endswith('text')]
    assert '0.75 m' in texts and '1 m, frame odom' in texts
    kinds = [feature['properties']['kind'] for feature in json.loads(
        names['--geojson'].read_text())['features']]
    assert kinds == ['wall', 'wall', 'floor', 'surface']
    mask = cv2.imread(str(tmp_path / 'keep_out.pgm'), cv2.IMREAD_UNCHANGED)
    _, columns = np.nonzero(mask == 0)
    assert len(columns) == pytest.approx(3.1 / 0.05, abs=4)  # 1.5 and 1.6 m of wall
    assert 'element face' in names['--ply'].read_text()
    assert 'is written' in capsys.readouterr().out


@pytest.mark.parametrize('name', ['keep out.yaml', 'keep #2.yaml', 'a: b.yaml', "it's.yaml"])
def test_nav2_finds_the_wall_where_it_stands(saved, tmp_path, name):
    write_map(tmp_path / 'map.json', saved, as_planes(saved.planes))
    assert main([str(tmp_path / 'map.json'), '--keep-out', str(tmp_path / name)]) == 0
    facts = yaml.safe_load((tmp_path / name).read_text())
    mask = cv2.imread(str(tmp_path / facts['image']), cv2.IMREAD_UNCHANGED)

    def is_occupied(x_m, y_m):  # as the map server reads it: the last row is at the origin
        place_m = np.array([x_m, y_m]) - facts['origin'][:2]
        column, row = (place_m / facts['resolution']).astype(int)
        return (mask[len(mask) - 1 - row - 1:len(mask) - row + 1, column] == 0).any()

    assert all(is_occupied(x_m, 3.0) for x_m in (0.1, 1.4, 2.5, 3.9))
    assert not any(is_occupied(x_m, y_m) for x_m, y_m in (
        (1.9, 3.0), (0.1, 2.7), (0.1, 0.5), (2.0, 1.0), (3.9, 3.3)))


def test_nothing_is_written_over_the_map_or_another_file(saved, tmp_path, capsys):
    file = tmp_path / 'map.json'
    write_map(file, saved, as_planes(saved.planes))
    before = file.read_text()
    for words in (['--geojson', 'map.json'], ['--ply', 'a', '--geojson', 'a'],
                  ['--keep-out', 'a.pgm'], ['--keep-out', 'a.yaml', '--ply', 'a.pgm']):
        words = [word if word.startswith('--') else str(tmp_path / word) for word in words]
        assert main([str(file), *words]) == 1
        assert 'would overwrite' in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == ['map.json']
    assert file.read_text() == before


def test_a_file_that_is_no_map_gives_a_reason(tmp_path, capsys):
    (tmp_path / 'map.json').write_text('{')
    assert main([str(tmp_path / 'map.json'), '--ply', str(tmp_path / 'out.ply')]) == 1
    assert 'is not a whole map' in capsys.readouterr().err


def area_of(corners):
    """Return the area of a polygon (N, 2), positive if it is counterclockwise."""
    following = np.roll(corners, -1, axis=0)
    return 0.5 * np.sum(corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0])


def is_inside(polygon, points):
    """Return which points (N, 2) a convex counterclockwise polygon has inside."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    away = points[:, None] - polygon
    return (sides[:, 0] * away[..., 1] - sides[:, 1] * away[..., 0] > 0).all(axis=1)


def star(rng, count, middle, radii):
    """Return a polygon around a point that is not convex."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    return middle + rng.uniform(*radii, count)[:, None] * np.column_stack(
        [np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize('seed', range(20))
def test_pieces_are_convex_and_fill_the_outlines_once_without_their_holes(seed):
    rng = np.random.default_rng(seed)
    outer = star(rng, 40, np.zeros(2), (2, 4))
    hole, other = star(rng, 12, [0.2, 0.1], (0.3, 0.6)), star(rng, 9, [9.0, 1.0], (1, 2))
    rings = [outer, hole[::-1], other]
    if seed % 2:  # of cells: many corners of one height
        rings = [np.round(4 * ring) / 4 for ring in rings]
    pieces = convex_pieces(rings)
    for piece in pieces:
        turns = [area_of(np.roll(piece, -k, axis=0)[:3]) for k in range(len(piece))]
        assert len(piece) in (3, 4) and min(turns) > -1e-12
    points = rng.uniform([-5, -5], [12, 5], (4000, 2))
    times = sum(is_inside(piece, points).astype(int) for piece in pieces)
    inside = np.array([[cv2.pointPolygonTest(ring.astype(np.float32), point.tolist(), False) > 0
                        for ring in rings] for point in points]).sum(axis=1) % 2
    assert (times == inside).mean() > 0.998  # rounded outlines cross themselves here and there
    if not seed % 2:
        assert (times == inside).all()
        assert sum(map(area_of, pieces)) == pytest.approx(
            abs(area_of(outer)) - abs(area_of(hole)) + abs(area_of(other)))


def test_a_window_is_a_hole_in_the_mesh_and_a_slanted_border_is_straight():
    """A wall with a window, and a gable over it; faces look to the side that was seen."""
    seen = np.ones((60, 80))
    seen[20:40, 30:50] = 0
    rows, columns = np.mgrid[:60, :80]
    seen[rows > 30 + columns] = 0
    wall = surface(4, PlaneClass.WALL, (0, -1, 0), (0, 3, 0), seen)
    turn = RigidTransform.from_quaternion((0, 0, 0.6, 0.8), (1.0, 2.0, 0.0))
    lines = to_ply(SavedMap((wall,), turn.inverse(), 'odom', 1.0)).splitlines()
    head = lines.index('end_header')
    numbers = {line.split()[1]: int(line.split()[2]) for line in lines if 'element' in line}
    vertices = np.array([line.split() for line in lines[head + 1:][:numbers['vertex']]], float)
    faces = [list(map(int, line.split())) for line in lines[head + 1 + numbers['vertex']:]]
    assert len(faces) == numbers['face'] < 12 and {face[-1] for face in faces} == {4}
    placed, area_m2 = turn.inverse().points(vertices[:, :3]), 0.0
    assert placed[:, 1] == pytest.approx(3, abs=1e-3)
    for count, *corners, _ in faces:
        assert len(corners) == count
        flat = placed[corners][:, [0, 2]]
        area_m2 += area_of(flat)  # x to the right, z up, as seen from -y
        assert not is_inside(flat, np.array([[40 * wall.cells.size_m, 30 * wall.cells.size_m]]))
    assert area_m2 == pytest.approx(seen.sum() * wall.cells.size_m**2, rel=0.02)
