# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What is curved loses its labels, planes and folds never do; how far a single one must turn."""

import numpy as np
import pytest
from cell_helpers import (
    EXACT,
    FLOOR,
    ball,
    best_iou,
    disparity_image,
    fold,
    millimetres,
    noisy,
    view,
    wall,
)

from plane_detector import Config, segment_planes
from plane_detector.config import SegmentationConfig
from plane_detector.evaluation.benchmark.samples import noisy_depth
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.surfaces import bar, cone
from plane_detector.segmentation.cells.grid import build_cell_grid, lens_of
from plane_detector.segmentation.cells.model import fit_regions, weigh_cells
from plane_detector.segmentation.cells.noise import estimate_noise
from plane_detector.segmentation.regions.curved import find_curved
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.types import CameraIntrinsics

ROOM = [wall(4), FLOOR]
SIGMA = 0.004
# Smaller planes than these may be facets of a curved thing.
NO_FACETS = Config(segmentation=SegmentationConfig(min_plane_share=0.004))
KEEP = {'float': lambda depth_m: depth_m, '16 bit': millimetres}


def upright(radius):
    """Return a cylinder whose front is 2.2 m away."""
    return cone(radius, radius, -3, 3).at(0, 2.2 + radius)


def lying(radius):
    return bar((-4, 2.2 + radius, -0.3), (4, 2.2 + radius, -0.3), radius)


@pytest.mark.parametrize(('width', 'height'), [(96, 72), (128, 96), (160, 120)])
@pytest.mark.parametrize('rows', [2, 3])
def test_a_wall_above_a_few_rows_of_floor_stays(rows, width, height):
    camera = CameraIntrinsics.from_field_of_view(width, height, 60.0)
    slope = np.broadcast_to((np.arange(height)[:, None] - camera.cy) / camera.fy, (height, width))
    edge = slope[-rows, 0] - 0.5 / camera.fy
    depth_m = np.where(slope > edge, 2 * edge / np.where(slope > edge, slope, 1), 2)
    found = segment_planes(depth_m.astype(np.float32), camera)
    assert (found.labels[:-rows] == 0).all()


@pytest.mark.parametrize('keep', KEEP)
@pytest.mark.parametrize('focal_share', [0.5, 3.0])
@pytest.mark.parametrize('angles_deg', [(0, 0, 0), (20, 30, 5), (75, 10, 20)])
def test_a_plane_is_never_given_up(angles_deg, focal_share, keep):
    camera = CameraIntrinsics(320 * focal_share, 320 * focal_share, 159.5, 119.5, 320, 240)
    scene = view([wall(3, -500, 500)], intrinsics=camera, angles_deg=angles_deg)
    depth_m = KEEP[keep](scene.depth_m)
    found = segment_planes(depth_m, camera)
    assert len(found.planes) == 1
    assert (found.labels[np.isfinite(depth_m)] == 0).mean() > 0.97


def judged(thing, depth_of, angles_deg=(0, -15, 4)):
    """Return the share of a curved thing without a label, and the IoU of the planes beside it."""
    scene = view(ROOM, thing.curved_pieces(), angles_deg=angles_deg)
    found = segment_planes(depth_of(scene), VGA, NO_FACETS)
    large = np.bincount(scene.labels[scene.labels >= 0]) > 1500
    on_curved = (scene.labels < 0) & np.isfinite(scene.depth_m)
    return (found.labels[on_curved] < 0).mean(), best_iou(scene, found.labels)[large].min()


@pytest.mark.parametrize('keep', KEEP)
@pytest.mark.parametrize(('thing', 'angles_deg', 'least_iou'), [
    (ball(0.3), (0, 0, 0), 0.95), (ball(2.0), (0, -15, 4), 0.95),
    (upright(0.3), (0, -15, 4), 0.95), (upright(2.0), (0, -15, 4), 0.6),
    (lying(1.0), (0, -15, 4), 0.95)],
    ids=['ball', 'large ball', 'column', 'thick column', 'pipe'])
def test_curved_things_have_hardly_a_plane(thing, angles_deg, least_iou, keep):
    """Of cylinders slabs along rows or columns are a cell or two wide: these show no curve."""
    share, iou = judged(thing, lambda scene: KEEP[keep](scene.depth_m), angles_deg)
    assert share > 0.95 and iou > least_iou


@pytest.mark.parametrize('angle_deg', [15, 30, 60])
@pytest.mark.parametrize('sigma', [0.0, 0.002, SIGMA])
def test_planes_that_meet_in_a_fold_stay(angle_deg, sigma):
    scene = view(fold(angle_deg))
    found = segment_planes(noisy(scene, 0, sigma), VGA)
    assert best_iou(scene, found.labels).min() > 0.9


# Without the gaps and the bends of a region that a sensor allows, half of them stayed.
@pytest.mark.parametrize(('noise', 'thing', 'least_iou'), [
    *((SIGMA, thing, 0.9) for thing in (upright(0.4), upright(1.0), ball(0.4))),
    *((sensor, thing, 0.8) for sensor in ('structured light', 'filled, 8 bit')
      for thing in (upright(0.25), lying(0.4), ball(0.25)))])
def test_curved_things_have_hardly_a_plane_under_noise(noise, thing, least_iou):
    """In most frames: where no pair of regions is clearly bent, all of them stay."""
    shares, ious = zip(*(judged(thing, lambda scene, seed=seed: noisy_depth(scene, noise, seed))
                         for seed in range(3)), strict=True)
    assert np.median(shares) > 0.9 and min(ious) > least_iou


@pytest.mark.parametrize(('radius_m', 'is_plane'), [(0.5, False), (1.0, False), (5.0, True)])
def test_a_bow_of_millimetres_is_a_plane_a_column_is_not(radius_m, is_plane):
    # A tray of .4 m from .6 m above, with noise that shows its bow of 4 mm.
    camera = CameraIntrinsics(924.0, 924.0, 319.5, 239.5, 640, 480)
    across = (np.arange(640) - camera.cx) / camera.fx * 0.6
    depth_m = np.tile(0.6 + radius_m - np.sqrt(radius_m**2 - across**2), (480, 1))
    noisy_m = with_disparity_noise(depth_m.astype(np.float32), SIGMA, np.random.default_rng(0))
    found = segment_planes(noisy_m, camera)
    assert ((found.labels == 0).mean() > 0.9) == is_plane


DISTANCE_M, LEAST_DEG, MOST_RADIUS_M = 0.8, 2.0, 1.5


def is_curved(radius_m, turn_deg, is_turned):
    """Return whether a column that fills the image is curved, of which so much is seen."""
    v, u = np.mgrid[-239.5:240, -319.5:320]
    half_m = radius_m * np.sin(np.radians(turn_deg / 2))
    across_px, focal_px = (v, 239.5) if is_turned else (u, 319.5)
    focal_px *= DISTANCE_M / half_m
    slope = across_px / focal_px
    # The ray meets the circle about a middle behind the front.
    middle_m = DISTANCE_M + radius_m
    a, b, c = 1 + slope**2, -2 * middle_m, middle_m**2 - radius_m**2
    depth_m = ((-b - np.sqrt(b * b - 4 * a * c)) / (2 * a)).astype(np.float32)
    noisy_m = with_disparity_noise(depth_m, 0.002, np.random.default_rng(0))
    camera = CameraIntrinsics(focal_px, focal_px, 319.5, 239.5, 640, 480)
    grid = build_cell_grid(disparity_image(noisy_m), lens=lens_of(camera))
    noise = estimate_noise(grid, EXACT)
    cells = weigh_cells(grid, noise)
    graph = RegionGraph.of(cells, fit_regions(cells, np.zeros(cells.grid.shape, np.int32), 1))
    return bool(find_curved(graph, noise.density, LEAST_DEG, noise.bending,
                            MOST_RADIUS_M).size)


@pytest.mark.parametrize('is_turned', [False, True])
@pytest.mark.parametrize('radius_m', [3.0, 4.5])
def test_a_column_is_curved_by_its_own_radius_though_it_is_straight_along_its_axis(
        radius_m, is_turned):
    needed_deg = LEAST_DEG * radius_m / MOST_RADIUS_M
    assert is_curved(radius_m, 1.4 * needed_deg, is_turned)
    assert not is_curved(radius_m, 0.7 * needed_deg, is_turned)
