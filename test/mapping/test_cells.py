# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells of a plane: what hits, hides and removes them; their outlines and rectangles."""

import numpy as np
import pytest

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.cells import (
    THROUGH,
    Cells,
    View,
    are_near,
    extents,
    runs,
    shared_cells,
    vote,
)
from plane_detector.mapping.heights import PlaneFrames
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(100.0, 100.0, 49.5, 49.5, 100, 100)
# A wall 2 m ahead, over a frame with u to the right and v up.
WALL = PlaneFrames(np.array([[0.0, 0.0, 2.0]]), np.array([[[1, 0, 0], [0, -1, 0], [0, 0, -1.0]]]),
                   np.zeros((1, 3)), np.zeros((1, 3, 3)))


def cells_of(seen, low=(0, 0)):
    counts = 4 * np.asarray(seen, np.uint8)
    return Cells(low, counts, counts.copy(), 0.1)


def view_of(depth_m, labels):
    labels = np.broadcast_to(labels, (100, 100)).astype(np.int32)
    return View(labels, np.full((100, 100), depth_m, np.float32),
                (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy), RigidTransform.identity(), 2, 0.001)


def voted(depth_m, labels, cells, own=(True, False)):
    view = view_of(depth_m, labels)
    (steps,) = view.steps(WALL, np.array([cells.low]), cells.size_m)
    return vote(view, steps, cells, np.array(own), 0.03)


@pytest.mark.parametrize('depth_m, label, hits, looks', [
    (2.0, 0, 1, 1),  # the plane itself
    (2.0, 1, 0, 1),  # another plane in its place
    (2.0, -1, 0, 0),  # in its place, but of no plane
    (1.5, 1, 0, 0),  # hidden
    (2.5, 1, 0, 3),  # seen through
    (np.nan, -1, 0, 0)])
def test_what_a_pixel_says_of_a_cell(depth_m, label, hits, looks):
    after = voted(depth_m, label, Cells.none(0.1).grown(np.array([-0.2, -0.2]),
                                                        np.array([0.2, 0.2])))
    assert (after.hits == hits).all()
    assert (after.looks == looks).all()


def test_cells_outside_of_the_image_are_not_looked_at():
    """At 2 m the image spans 1 m to each side."""
    cells = Cells.none(0.1).grown(np.array([-2.0, -0.1]), np.array([2.0, 0.1]))
    looked = voted(2.0, 0, cells).looks.any(axis=0)
    assert np.flatnonzero(looked).tolist() == list(range(10, 30))


def test_what_is_gone_is_forgotten_and_counts_stay_small():
    cells = cells_of(np.ones((4, 4)))
    for _ in range(30):
        cells = voted(2.0, 0, cells)
    assert cells.count == 16
    assert cells.looks.max() <= 22
    for _ in range(10):
        cells = voted(3.0, 1, cells)
    assert cells.count == 0
    assert cells.is_gone


def test_a_found_plane_shares_the_cells_that_its_pixels_show():
    labels = np.zeros((100, 100), np.int32)
    labels[:, 50:] = 1
    cells = cells_of(np.ones((10, 20)), (-10, -5))
    view = view_of(2.0, labels)
    (steps,) = view.steps(WALL, np.array([cells.low]), cells.size_m)
    assert shared_cells(view, steps, cells).tolist() == [25, 25, 50]


def test_growing_keeps_what_is_there():
    cells = cells_of(np.ones((2, 3)), (5, -2))
    grown = cells.grown(np.array([-1.0, -1.0]), np.array([1.0, 1.0]))
    assert grown.count == 6
    assert grown.centroid_m == pytest.approx(cells.centroid_m)
    assert grown.grown(np.array([0.0, 0.0]), np.array([0.1, 0.1])) is grown


def test_outlines_of_a_frame_with_its_hole():
    seen = np.ones((10, 10))
    seen[3:6, 3:6] = 0
    (outer, is_hole), (inner, is_inner_hole) = cells_of(seen).outlines
    assert (is_hole, is_inner_hole) == (False, True)
    assert np.ptp(outer, axis=0) == pytest.approx([1.0, 1.0], abs=0.06)
    assert inner.mean(axis=0) == pytest.approx([0.45, 0.45], abs=0.03)


def test_runs_cover_all_cells_once():
    seen = np.random.default_rng(0).random((20, 30)) < 0.6
    covered = np.zeros(seen.shape, int)
    for top, bottom, left, right in runs(cells_of(seen)):
        covered[top:bottom, left:right] += 1
    assert (covered == seen).all()
    assert len(runs(cells_of(np.ones((5, 7))))) == 1


def test_reach():
    cells = cells_of(np.ones((2, 2)))
    points = np.array([[0.45, 0.1], [3.0, 0.0]])
    assert are_near(points, cells, 0.3) == 0.5
    assert are_near(points, cells, 0.1) == 0.0


def test_who_walked_by_is_gone_when_most_is_looked_through():
    # Seen in two images; then of a fifth of it nothing was seen, and the rest was looked through.
    hits = np.full((10, 10), 2, np.uint8)
    looks = hits.copy()
    looks[:8] += 2 * THROUGH
    assert Cells((0, 0), hits, looks, 0.04).is_gone
    looks[4:] = 2
    assert not Cells((0, 0), hits, looks, 0.04).is_gone


def test_extents_of_points_over_the_frames_of_their_planes():
    points_m = np.array([[0.0, 0.0, 2.0], [1.0, -2.0, 2.0], [5.0, 5.0, 2.0]])
    frames = WALL.selected([0, 0])
    lows_m, highs_m = extents(points_m, np.array([0, 2, 3]), np.array([1, -1]), frames)
    assert lows_m.tolist() == [[np.inf, np.inf], [0.0, 0.0]]
    assert highs_m.tolist() == [[-np.inf, -np.inf], [1.0, 2.0]]
