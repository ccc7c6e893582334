# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What is exported of a map lies where it is in the world.

The room is made by hand in the frame of the poses and kept in that of the map, which is turned
and shifted. No wall has a counterpart: mirrored or turned files are wrong.
"""

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
from plane_detector.tools.export import main
from plane_detector.types import PlaneClass

TO_MAP = RigidTransform.from_quaternion((0, 0, np.sin(0.3), np.cos(0.3)), (5.0, -2.0, 0.4))
# Walls from above, x and y: one along y = 3 with a passage of .6 m and a crack of .2 m, and one
# along x = 0.
WALLS = [((0.0, 3.0), (1.0, 3.0)), ((1.6, 3.0), (4.0, 3.0)), ((0.0, 1.0), (0.0, 3.0))]
PASSAGE = ((1.1, 3.0), (1.5, 3.0))
TABLE = ((3.0, 0.5), (3.6, 0.9))


def surface(label, kind, normal, origin, seen):
    axes = new_axes(np.array([normal], float), np.eye(3)[2])[0] @ TO_MAP.rotation.T
    return map_plane(label, kind, TO_MAP.points(np.array(origin, float)), axes, 10 * seen)


@pytest.fixture(scope='module')
def files(tmp_path_factory):
    """Return the folder of all exports of the room; the cells of its planes are of 5 cm."""
    folder = tmp_path_factory.mktemp('export')
    far = np.ones((50, 80))
    far[:44, 20:32] = 0  # under a lintel
    far[:, 60:64] = 0
    planes = (surface(1, PlaneClass.FLOOR, (0, 0, 1), (0, 3.5, 0), np.ones((85, 70))),
              surface(2, PlaneClass.WALL, (0, -1, 0), (0, 3, 0), far),
              surface(3, PlaneClass.WALL, (1, 0, 0), (0, 1, 0), np.ones((50, 40))),
              surface(4, PlaneClass.OTHER_HORIZONTAL, (0, 0, 1), (3, 0.9, 0.75),
                      np.ones((12, 8))))
    write_map(folder / 'map.json', SavedMap(planes, TO_MAP, 'odom', 1.0), as_planes(planes))
    assert main([str(folder / 'map.json'), *(word for option, name in (
        ('--keep-out', 'keep.yaml'), ('--floor-plan', 'plan.svg'), ('--geojson', 'plan.json'),
        ('--ply', 'planes.ply')) for word in (option, str(folder / name)))]) == 0
    return folder


def along(ends, step_m=0.05):
    """Return points (N, 2) between two ends."""
    first, last = np.array(ends)
    shares = np.linspace(0, 1, round(np.linalg.norm(last - first) / step_m) + 1)
    return first + shares[:, None] * (last - first)


def distances(points, others):
    return np.linalg.norm(np.asarray(points)[:, None] - np.asarray(others)[None], axis=2).min(1)


WALL_POINTS = np.vstack([along(ends) for ends in WALLS])


def test_the_occupied_cells_are_where_the_walls_are(files):
    """As the map server of Nav2 reads them: the origin is the lower left corner of the image."""
    facts = yaml.safe_load((files / 'keep.yaml').read_text())
    image = cv2.imread(str(files / facts['image']), cv2.IMREAD_UNCHANGED)
    rows, columns = np.nonzero((255 - image) / 255 > facts['occupied_thresh'])
    x_y_m = facts['resolution'] * np.column_stack(
        [columns + 0.5, image.shape[0] - rows - 0.5]) + facts['origin'][:2]
    assert distances(x_y_m, WALL_POINTS).max() < 0.08
    assert distances(WALL_POINTS, x_y_m).max() < 0.08
    assert distances(along(PASSAGE), x_y_m).min() > 0.05, 'a robot passes here'
    assert ((255 - image[0]) / 255 < facts['free_thresh']).all()


def test_walls_and_table_of_geojson_are_in_the_frame_of_the_poses(files):
    plan = json.loads((files / 'plan.json').read_text())
    lines = [np.array(one['geometry']['coordinates']) for one in plan['features']
             if one['properties']['kind'] == 'wall']
    drawn = np.vstack([along(ends) for ends in lines])
    assert distances(drawn, WALL_POINTS).max() < 0.04
    assert distances(WALL_POINTS, drawn).max() < 0.04
    table, = (one for one in plan['features'] if one['properties']['label'] == 4)
    corners = np.vstack([np.array(ring) for part in table['geometry']['coordinates']
                         for ring in part])
    assert corners.min(0) == pytest.approx(TABLE[0], abs=0.04)
    assert corners.max(0) == pytest.approx(TABLE[1], abs=0.04)
    assert table['properties']['height_m'] == pytest.approx(0.75, abs=1e-3)


def test_the_floor_plan_has_north_up_and_west_to_the_left(files):
    """The plan is seen from above, x to the right and y up, at one scale."""
    root = ElementTree.parse(files / 'plan.svg').getroot()
    lines = [[float(one.get(name)) for name in ('x1', 'y1', 'x2', 'y2')]
             for one in root.iter() if one.tag.endswith('line')]
    drawn = np.vstack([along(np.reshape(line, (2, 2)), 5.0) for line in lines])
    seen = drawn * [1, -1]  # y of SVG points down
    # Shift and scale are free, the corner of both walls is to the north-west.
    scale = np.ptp(seen[:, 0]) / 4.0
    assert np.ptp(seen[:, 1]) == pytest.approx(2.0 * scale, rel=0.03)
    placed = (seen - [seen[:, 0].min(), seen[:, 1].max()]) / scale + [0.0, 3.0]
    assert distances(placed, WALL_POINTS).max() < 0.08
    table, = (one for one in root.iter() if 'other horizontal 4' in ''.join(one.itertext())
              and one.tag.endswith('path'))
    numbers = np.array(re.findall(r'-?[\d.]+', table.get('d')), float).reshape(-1, 2) * [1, -1]
    middle = ((numbers.min(0) + numbers.max(0)) / 2 - [seen[:, 0].min(), seen[:, 1].max()]
              ) / scale + [0.0, 3.0]
    assert middle == pytest.approx(np.mean(TABLE, axis=0), abs=0.08)


def test_the_surfaces_of_ply_are_those_of_the_room(files):
    lines = (files / 'planes.ply').read_text().splitlines()
    count = int(next(line for line in lines if line.startswith('element vertex')).split()[-1])
    begin = lines.index('end_header') + 1
    vertices = np.array([line.split()[:3] for line in lines[begin:begin + count]], float)
    faces = np.array([line.split() for line in lines[begin + count:]], int)[:, 1:5]
    on = {'floor': abs(vertices[:, 2]) < 1e-3, 'far': abs(vertices[:, 1] - 3) < 1e-3,
          'left': abs(vertices[:, 0]) < 1e-3, 'table': abs(vertices[:, 2] - 0.75) < 1e-3}
    corners = vertices[faces]
    doubled = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    areas = np.linalg.norm(doubled, axis=1) / 2
    # Outlines are a quarter of a cell inside of the border of the cells, and simplified.
    expected = {'floor': 69.5 * 84.5, 'far': 59.5 * 49.5 - 12.5 * 44 + 15.5 * 49.5,
                'left': 49.5 * 39.5, 'table': 7.5 * 11.5}
    for name, cells in expected.items():
        is_own = on[name][faces].all(axis=1)
        assert areas[is_own].sum() == pytest.approx(0.05**2 * cells, rel=5e-3), name
    assert areas.sum() == pytest.approx(0.05**2 * sum(expected.values()), rel=5e-3)
    table = vertices[on['table']]
    assert (table[:, :2].min(0), table[:, :2].max(0)) == (
        pytest.approx(TABLE[0], abs=0.014), pytest.approx(TABLE[1], abs=0.014))
