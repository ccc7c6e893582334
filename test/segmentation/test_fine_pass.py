# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes too narrow for whole cells."""

import numpy as np
import pytest
from cell_helpers import EXACT, best_iou, disparity_image, view, wall

from plane_detector import segment_planes
from plane_detector.config import Config, SegmentationConfig
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.model import Frame
from plane_detector.segmentation.fine_pass import MIN_CELL_SHARE, add_small_planes
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.segmentation.search.plane_search import search_planes
from plane_detector.segmentation.segment import MIN_TURN_DEG
from plane_detector.types import CameraIntrinsics

CONFIG = Config()
NEAR_M, LEFT_M, RIGHT_M = 1.9, 2.0, 2.3
# The strip begins here, which is no border of cells.
FIRST_PX = 323


def strip(width_px, roll_deg=0.0, first_px=FIRST_PX, yaw_deg=0.0):
    """Return an upright strip before two walls, of other depth than both."""
    start_m, end_m = ((px - 319.5) * NEAR_M / 525 for px in (first_px, first_px + width_px))
    return view([wall(LEFT_M, right_m=start_m), wall(NEAR_M, start_m, end_m),
                 wall(RIGHT_M, end_m)], angles_deg=(yaw_deg, 0, roll_deg))


def before_narrow(depth_m, config=CONFIG):
    """Return what :func:`add_small_planes` takes: what the search on whole cells leaves."""
    image = disparity_image(depth_m)
    least_pixels = MIN_CELL_SHARE * config.segmentation.min_plane_share * depth_m.size
    frame, regions = search_planes(Frame(image, build_cell_grid(image), EXACT, least_pixels,
                                         config, np.random.default_rng(0)))
    graph = RegionGraph.of(frame.cells, regions)
    return frame, label_pixels(frame, graph), graph, MIN_TURN_DEG


@pytest.mark.parametrize('width_px', [8, 13, 18])
@pytest.mark.parametrize('roll_deg', [0.0, 10.0])
def test_a_narrow_strip_is_found(width_px, roll_deg):
    scene = strip(width_px, roll_deg)
    found = segment_planes(scene.depth_m, scene.intrinsics)
    assert len(found.planes) == 3
    assert best_iou(scene, found.labels).min() > 0.8
    offsets_m = sorted(plane.offset_m for plane in found.planes)
    np.testing.assert_allclose(offsets_m, [NEAR_M, LEFT_M, RIGHT_M], atol=2e-3)


@pytest.mark.parametrize('roll', [0.0, 0.3])
def test_a_narrow_face_gets_the_pixels_on_its_side_of_the_edges(roll):
    """Its neighbours, found before, are within the noise of a scanner's depth there."""
    v, u = np.indices((512, 512))
    across = (u - 250) * np.cos(roll) + (v - 250) * np.sin(roll)
    depth_m = 1 / (1 / 0.9 - 0.0025 * np.clip(across, 0, 12))
    depth_m += np.random.default_rng(0).normal(0, 0.0005, depth_m.shape)
    scanner = CameraIntrinsics(1611.0, 2337.0, 255.0, 255.0, 512, 512)
    found = segment_planes((0.0013 * np.round(depth_m / 0.0013)).astype(np.float32), scanner)
    is_face = (across >= 0) & (across < 12)
    own = found.labels == np.bincount(found.labels[is_face] + 1).argmax() - 1
    assert len(found.planes) == 3
    assert np.count_nonzero(own & is_face) > 0.85 * np.count_nonzero(own | is_face)


@pytest.mark.parametrize('second_px', [335, 500])
def test_two_strips_are_two(second_px):
    """Side by side, where whole cells would straddle both, or far from each other."""
    edges_m = [(px - 319.5) * NEAR_M / 525 for px in (323, 335, second_px, second_px + 12)]
    scene = view([wall(2.5), wall(NEAR_M, *edges_m[:2]), wall(NEAR_M + 1e-2, *edges_m[2:])],
                 angles_deg=(0, 0, 10))
    given = before_narrow(scene.depth_m)
    labels, planes = given[1], add_small_planes(*given)
    assert len(planes) == len(given[2].planes) + 2
    assert best_iou(scene, labels)[1:].min() > 0.8


@pytest.mark.parametrize('most', [2, 3])
def test_no_more_planes_than_wanted(most):
    config = Config(segmentation=SegmentationConfig(max_planes=most))
    given = before_narrow(strip(12, 10.0).depth_m, config)
    before = given[1].copy()
    assert len(add_small_planes(*given)) == most
    assert np.array_equal(given[1], before) == (most == 2)
