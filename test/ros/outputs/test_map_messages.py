# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a map of one plane, whose poses have been corrected."""

import numpy as np
import output_scene as scene
import pytest
from map_helpers import map_plane
from ros_helpers import cloud_array, header
from scipy.spatial.transform import Rotation

from plane_detector.mapping.map_plane import as_planes
from plane_detector.mapping.plane_map import MapSnapshot
from plane_detector.ros.outputs.frame import MapView
from plane_detector.ros.outputs.map_messages import (
    map_boundaries_to_msg,
    map_markers_to_msg,
    map_planes_to_msg,
)
from plane_detector.types import PlaneClass

AXES = Rotation.from_euler('xyz', [20, 30, 40], degrees=True).as_matrix()
WALL = map_plane(4, PlaneClass.WALL, [1.0, 2.0, 3.0], AXES, np.ones((4, 8)), variance=1e-4)
CORNERS_M = scene.TARGET.points(WALL.points(np.array([[0, 0], [0.4, 0], [0.4, 0.2], [0, 0.2]])))
NORMAL = scene.TARGET.rotation @ AXES[2]
VIEW = MapView(header(1.5), MapSnapshot((WALL,), as_planes([WALL]).moved(scene.TARGET),
                                        scene.TARGET), {9: 4})


def xyz(table, prefix=''):
    return np.stack([table[f'{prefix}{axis}'] for axis in 'xyz'], axis=-1)


def test_planes_of_a_map_are_in_the_frame_of_the_poses():
    (row, gone), = cloud_array(map_planes_to_msg(VIEW))
    middle_m = CORNERS_M.mean(axis=0)
    np.testing.assert_allclose(xyz(row, 'normal_'), NORMAL, atol=1e-6)
    assert row['d'] == pytest.approx(-middle_m @ NORMAL, abs=1e-6)
    np.testing.assert_allclose([xyz(row), xyz(row, 'rect_')], [middle_m] * 2, atol=1e-6)
    assert (row['rect_width'], row['rect_height']) == pytest.approx((0.4, 0.2))
    axes = Rotation.from_quat([row[f'rect_q{axis}'] for axis in 'xyzw']).as_matrix()
    np.testing.assert_allclose(axes[:, 2], NORMAL, atol=1e-6)
    assert abs(axes[:, 0] @ (CORNERS_M[1] - CORNERS_M[0])) == pytest.approx(0.4, abs=1e-6)
    assert row['sigma_normal'] == pytest.approx(0.01 * np.sqrt(2))  # about two axes
    assert (row['views'], row['first_seen'], row['last_seen']) == (5, 0.0, 1.0)
    assert (gone['label'], gone['subsumed_by'], gone['num_inliers']) == (9, 4, 0)


def test_outlines_and_surfaces_of_a_map_are_in_the_frame_of_the_poses():
    (corners,) = cloud_array(map_boundaries_to_msg(VIEW))
    assert set(corners['label']) == {4} and not corners['hole'].any()
    off_m = np.linalg.norm(xyz(corners)[:, None] - CORNERS_M, axis=2)
    assert max(off_m.min(axis=0).max(), off_m.min(axis=1).max()) < 0.02  # within half a cell
    _, surface = map_markers_to_msg(VIEW).markers
    points_m = np.array([[p.x, p.y, p.z] for p in surface.points]).reshape(-1, 3, 3)
    doubled = np.cross(points_m[:, 1] - points_m[:, 0], points_m[:, 2] - points_m[:, 0])
    np.testing.assert_allclose(doubled.sum(axis=0), 0.16 * NORMAL, atol=1e-9)
    np.testing.assert_allclose(points_m.max(axis=(0, 1)), CORNERS_M.max(axis=0), atol=1e-9)
