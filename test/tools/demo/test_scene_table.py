# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's table: floor first, angles by hand, colours by class."""

import numpy as np
import pytest

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.outputs.plane_table import PLANE_DTYPE
from plane_detector.tools.demo.scene_table import (
    by_class,
    scene_table,
)


@pytest.fixture
def planes():
    """Return a wall, a larger floor, a second wall 60 degrees from the first."""
    table = np.zeros(3, PLANE_DTYPE)
    table['label'], table['num_inliers'] = (4, 2, 7), (500, 300, 900)
    table['class'] = PlaneClass.WALL, PlaneClass.FLOOR, PlaneClass.WALL
    turned = np.radians(60)
    table['normal_x'] = 0, 0, np.sin(turned)
    table['normal_y'] = 0, -1, 0
    table['normal_z'] = -1, 0, -np.cos(turned)
    return table


def test_floor_comes_first_then_the_largest_wall(planes):
    assert by_class(planes)['label'].tolist() == [2, 7, 4]


def test_the_table_has_a_row_for_each_plane_and_angles_to_the_others(planes):
    lines = scene_table(planes, 'm').splitlines()
    assert 'd [m]' in lines[0]
    assert lines[0].split()[-3:] == ['2', '7', '4']
    assert [line.split()[:2] for line in lines[1:]] == [['floor', '2'], ['wall', '7'],
                                                       ['wall', '4']]
    assert lines[2].split()[-3:] == ['90', '-', '60']
