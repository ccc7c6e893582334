# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The grid of free and occupied cells, on rendered terrain with its truth."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from plane_detector.config import GridConfig, GroundConfig
from plane_detector.evaluation.scenes.terrain import Kind, terrain
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ground.grid import FREE, OCCUPIED, UNKNOWN, level_frame, occupancy_grid
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import (
    METRIC,
    CameraIntrinsics,
    Detection,
    GroundLack,
    GroundResult,
    Planes,
)

GRID = GridConfig(resolution=0.05, size=8.0)


def seen(name, seed):
    """Return a view, and its grid in the world, whose origin is on the floor at the robot."""
    view = terrain(name, np.random.default_rng([seed, *name.encode()]))
    found = PlaneDetector(depth_model=lambda rgb: view.scene.depth_m).detect(
        view.scene.rgb, view.scene.intrinsics, gravity_camera=view.scene.gravity_camera)
    to_world = RigidTransform(view.to_world, view.position_m)
    return view, found, occupancy_grid(
        found, view.scene.intrinsics, to_world, GroundConfig(), GRID)


def cells_at(grid, points_m):
    """Return the cells of points in the world that are inside the grid, and which points are."""
    places = np.floor(np.asarray(points_m)[:, :2] / GRID.resolution + len(grid) / 2).astype(int)
    inside = ((places >= 0) & (places < len(grid))).all(axis=1)
    return grid[places[inside, 1], places[inside, 0]], inside


@pytest.mark.parametrize('seed', range(8300, 8303))
@pytest.mark.parametrize('name', ['boxes, tables, cables', 'ramp up', 'stairs down', 'hole',
                                  'quay', 'kerb down'])
def test_ground_is_free_and_neither_obstacles_nor_edges_are(name, seed):
    view, found, grid = seen(name, seed)
    assert set(np.unique(grid)) <= {UNKNOWN, FREE, OCCUPIED}
    kinds, points_m = view.kinds.ravel(), view.points_m.reshape(-1, 3)
    floor_m = points_m[kinds == Kind.FLOOR]
    others_m = np.concatenate([points_m[kinds > Kind.RAMP], view.edges_m, [[99.0, 99.0, 0.0]]])
    apart_m = cKDTree(others_m[:, :2]).query(floor_m[:, :2])[0]
    assert (cells_at(grid, floor_m)[0] != UNKNOWN).all()
    apart, _ = cells_at(grid, floor_m[apart_m > 0.2])
    assert (apart == FREE).sum() >= 0.99 * len(apart)  # a false drop may be there
    above_m = view.above_m.ravel()
    obstacles_m = points_m[(kinds == Kind.OBSTACLE) & (above_m > 0.1) & (
        above_m < GRID.max_height - 0.1)]
    of_obstacles, _ = cells_at(grid, obstacles_m)
    assert (of_obstacles == OCCUPIED).sum() >= 0.97 * len(of_obstacles)
    if len(found.drops_m):
        edges_m = view.edges_m[view.is_visible & (view.drops_m > 0.1)
                               & (np.linalg.norm(view.edges_m[:, :2], axis=1) < 2.5)]
        assert (cells_at(grid, edges_m)[0] == FREE).sum() <= 0.03 * len(edges_m)


def test_far_rows_leave_no_gaps_in_the_floor():
    _, _, grid = seen('flat', 8301)
    ahead = grid[:, len(grid) // 2 - 2:len(grid) // 2 + 2]
    known = np.flatnonzero((ahead == FREE).any(axis=1))
    assert len(known) > 20
    assert (ahead[known[0] + 1:known[-1]] == FREE).mean() > 0.97


@pytest.mark.parametrize('gravity, ahead', [
    ((0, 1, 0), (0, 0, 1)), ((1, 0, 0), (0, 0, 1)), ((0, 0, 1), (0, -1, 0)),
    ((0, 0, -1), (0, 1, 0)), ((0, 0.6, 0.8), (0, -0.8, 0.6)), ((0, -1, 0), (0, 0, 1))])
def test_the_level_frame_is_under_the_camera(gravity, ahead):
    gravity, ahead = np.array(gravity, float), np.array(ahead, float)
    frame = level_frame(gravity, 1.2)
    np.testing.assert_allclose(frame.points(1.2 * gravity), 0, atol=1e-12)
    np.testing.assert_allclose(frame.points(1.2 * gravity + ahead), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)


@pytest.mark.parametrize('further_m, lower_m, is_free', [
    (0.2, 0.0, True), (0.25, 0.02, True), (0.28, 0.1, False), (0.5, 0.1, False)])
def test_between_two_pixels_the_ground_goes_on_but_not_over_a_drop(further_m, lower_m, is_free):
    camera = CameraIntrinsics(1.0, 1.0, 0.0, 0.0, 1, 2)
    nothing = np.zeros((2, 1), np.float32)
    found = Detection(Planes.of([]), np.full((2, 1), -1, np.int32), 0.0, nothing + 1, METRIC,
                      ground_result=GroundResult(GroundLack.NOTHING, nothing == 0, nothing > 0,
                                                 nothing, nothing))
    # The rays are (0, 0, 1) and (0, 1, 1): the second column is the way from pixel to pixel.
    place = RigidTransform(np.array([[0, further_m, 0], [0, 0, 0], [0, -lower_m, 0]]),
                           np.array([1.0, 0.0, 0.0]))
    grid = occupancy_grid(found, camera, place, GroundConfig(), GRID)
    assert cells_at(grid, [[1.0, 0.0], [1.0 + further_m, 0.0]])[0].tolist() == [FREE, FREE]
    (middle,) = cells_at(grid, [[1.0 + further_m / 2, 0.0]])[0]
    assert middle == (FREE if is_free else UNKNOWN)
