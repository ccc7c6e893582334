# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's table: floor first, angles by hand, colours by class."""

import numpy as np
import pytest

from plane_detector import drawing
from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.outputs.plane_table import PLANE_DTYPE
from plane_detector.tools.demo.scene_table import (
    COLOURS,
    angles_deg,
    by_class,
    class_colours,
    legend,
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


def test_angles_between_planes_do_not_depend_on_the_side(planes):
    np.testing.assert_allclose(angles_deg(planes), [[0, 90, 60], [90, 0, 90], [60, 90, 0]],
                               atol=0.05)  # of float32 normals
    planes['normal_z'][0] = 1
    assert angles_deg(planes)[0, 2] == pytest.approx(60, abs=0.05)


def test_the_table_has_a_row_for_each_plane_and_angles_to_the_others(planes):
    lines = scene_table(planes, 'm').splitlines()
    assert 'd [m]' in lines[0]
    assert lines[0].split()[-3:] == ['2', '7', '4']
    assert [line.split()[:2] for line in lines[1:]] == [['floor', '2'], ['wall', '7'],
                                                       ['wall', '4']]
    assert lines[2].split()[-3:] == ['90', '-', '60']


def test_without_gravity_labels_keep_their_colours(planes):
    planes['class'] = PlaneClass.UNKNOWN
    assert 'gravity is not known' in scene_table(planes, 'm')
    assert legend(planes) == ''
    np.testing.assert_array_equal(class_colours(planes)[[2, 4, 7]],
                                  drawing.label_colours(np.array([2, 4, 7])))


def test_classes_have_their_colours(planes):
    assert legend(planes) == 'floor green, wall blue'
    colours = class_colours(planes)
    np.testing.assert_array_equal(colours[2], COLOURS[PlaneClass.FLOOR][1])
    np.testing.assert_array_equal(colours[[4, 7]], [COLOURS[PlaneClass.WALL][1]] * 2)
    labels = np.zeros((20, 30), np.uint32)
    labels[:, 15:] = 7
    drawn = drawing.tint(np.zeros((20, 30, 3), np.uint8), labels, colours)
    assert (drawn[:, :15] == 0).all()
    np.testing.assert_allclose(drawn[5, 20], 0.55 * colours[7], atol=1)


def test_a_table_without_planes(planes):
    assert scene_table(planes[:0], 'm') == '  no plane found'
    assert class_colours(planes[:0]).shape == (1, 3)
