# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What is curved loses its labels where depth is exact, planes never do."""

import numpy as np
import pytest
from cell_helpers import (
    FLOOR,
    ball,
    best_iou,
    cell_model,
    hand_made,
    millimetres,
    one_patch,
    view,
    wall,
)

from plane_detector import segment_planes
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.surfaces import bar, cone, sheet
from plane_detector.segmentation.regions import curved
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.types import CameraIntrinsics

ROOM = [wall(4), FLOOR]
KEEP = {'float': lambda depth_m: depth_m, '16 bit': millimetres}


def find_curved(model, regions, noise_density=0.0):
    return curved.find_curved(RegionGraph.of(model, regions), noise_density, 0.0).tolist()


def upright(radius):
    """Return a cylinder whose front is 2.2 m away."""
    return cone(radius, radius, -3, 3).at(0, 2.2 + radius)


def lying(radius):
    return bar((-4, 2.2 + radius, -0.3), (4, 2.2 + radius, -0.3), radius)


def wave(height_m, length_m):
    """Return a curtain with folds 2.5 m away."""
    x = np.linspace(-1, 1, 1500)
    y = 2.5 + height_m * np.sin(2 * np.pi * x / length_m)
    return sheet(np.stack([x, y, np.full(1500, -0.9)], axis=1), np.array([0, 0, 1.8]))


def slab(scene, column, width):
    """Return model and one region: an upright slab so many cells wide."""
    model = cell_model(scene.depth_m)
    labels = np.full(model.grid.shape, -1)
    labels[15:45, column:column + width] = 0
    return model, hand_made(model, labels)


@pytest.mark.parametrize('radius', [0.3, 0.5, 1.0, 2.0])
@pytest.mark.parametrize('width', [4, 6, 10])
def test_a_slab_of_a_cylinder_is_given_up(radius, width):
    scene = view([], upright(radius).curved_pieces(), angles_deg=(0, 0, 5))
    assert find_curved(*slab(scene, 40 - width // 2, width)) == [0]


def test_nothing_is_given_up_under_noise():
    model, regions = slab(view([], upright(0.5).curved_pieces()), 35, 10)
    assert find_curved(model, regions) == [0]
    assert find_curved(model, regions, 0.1**2) == []


def test_planes_beside_a_curved_region_stay():
    scene = view([wall(4)], upright(0.5).curved_pieces(), angles_deg=(0, 0, 5))
    model = cell_model(scene.depth_m)
    labels = np.full(model.grid.shape, -1)
    labels[20:40, 36:44], labels[:, :20], labels[:, 60:] = 1, 0, 2
    regions = hand_made(model, labels)
    assert find_curved(model, regions) == [1]


@pytest.mark.parametrize('keep', KEEP)
@pytest.mark.parametrize('focal_share', [0.5, 0.8, 1.5, 3.0])
@pytest.mark.parametrize('angles_deg', [(0, 0, 0), (20, 30, 5), (60, 0, 0), (75, 10, 20)])
def test_a_plane_is_never_given_up(angles_deg, focal_share, keep):
    camera = CameraIntrinsics(320 * focal_share, 320 * focal_share, 159.5, 119.5, 320, 240)
    scene = view([wall(3, -500, 500)], intrinsics=camera, angles_deg=angles_deg)
    depth_m = KEEP[keep](scene.depth_m)
    model = cell_model(depth_m)
    regions = one_patch(model)
    assert find_curved(model, regions) == []
    found = segment_planes(depth_m, camera)
    assert len(found.planes) == 1
    assert (found.labels[np.isfinite(depth_m)] == 0).mean() > 0.97


def unlabelled(thing, keep, angles_deg):
    """Return the share of a curved thing without a label, and the IoU of the planes beside it."""
    scene = view(ROOM, thing.curved_pieces(), angles_deg=angles_deg)
    curved = (scene.labels < 0) & np.isfinite(scene.depth_m)
    found = segment_planes(KEEP[keep](scene.depth_m), VGA)
    large = np.bincount(scene.labels[scene.labels >= 0]) > 1500
    return (found.labels[curved] < 0).mean(), best_iou(scene, found.labels)[large].min()


@pytest.mark.parametrize('keep', KEEP)
@pytest.mark.parametrize('radius', [0.3, 2.0])
@pytest.mark.parametrize('angles_deg', [(0, 0, 0), (0, -15, 4)])
def test_a_ball_has_no_plane(radius, angles_deg, keep):
    share, least_iou = unlabelled(ball(radius), keep, angles_deg)
    assert share > 0.97
    assert least_iou > 0.95


@pytest.mark.parametrize('keep', KEEP)
@pytest.mark.parametrize(('thing', 'least', 'iou'), [
    (upright(0.3), 0.96, 0.95), (upright(0.5), 0.9, 0.95), (upright(1.0), 0.9, 0.95),
    (upright(2.0), 0.97, 0.6), (lying(0.3), 0.97, 0.95), (lying(1.0), 0.95, 0.95)], ids=str)
def test_a_cylinder_at_an_angle_to_the_rows_has_hardly_a_plane(thing, least, iou, keep):
    """Slabs along rows or columns are only a cell or two wide: these show no curve."""
    share, least_iou = unlabelled(thing, keep, (0, -15, 4))
    assert share > least
    assert least_iou > iou


@pytest.mark.parametrize('keep', KEEP)
@pytest.mark.parametrize(('height_m', 'length_m'), [(0.05, 0.3), (0.1, 1.0)])
def test_planes_beside_a_curtain_are_whole_and_much_of_it_is_none(height_m, length_m, keep):
    """Where folds turn from in to out they are flat to a third order: slabs of that remain."""
    share, least_iou = unlabelled(wave(height_m, length_m), keep, (0, -15, 4))
    assert share > 0.5
    assert least_iou > 0.95
