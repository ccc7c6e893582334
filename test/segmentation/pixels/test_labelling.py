# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Where pixels put the borders of planes whose cells have them elsewhere; narrow gaps; smears."""

import cv2
import numpy as np
import pytest
from cell_helpers import (
    VGA,
    cell_model,
    disparity_image,
    fold,
    frame_of,
    noisy,
    one_patch,
    regions_of_labels,
    view,
    wall,
)

from plane_detector import CameraIntrinsics, segment_planes
from plane_detector.segmentation.cells.model import MAX_DEVIATIONS, PlaneRegions
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.pixels.labelling import label_more_pixels, label_pixels
from plane_detector.segmentation.regions.region_graph import RegionGraph

CAMERA = CameraIntrinsics.from_field_of_view(320, 240, 60.0)
SCENES = {'crease': view(fold(30), intrinsics=CAMERA, angles_deg=(0, 0, 25)),
          'step': view([wall(2, right_m=0), wall(2.3, 0)], intrinsics=CAMERA,
                       angles_deg=(0, 0, 25))}


@pytest.mark.parametrize('scene', SCENES.values(), ids=SCENES)
@pytest.mark.parametrize('shift', [-3, 0, 3])
def test_pixels_move_a_border_that_is_cells_away(scene, shift):
    model, size = cell_model(scene.depth_m), 4
    assert model.grid.size_px == size
    cells = scene.labels[size // 2::size, size // 2::size]
    true = regions_of_labels(model, cells)
    moved = PlaneRegions(np.roll(cells, shift, axis=1).astype(np.int32), true.coefficients)
    moved.labels[:, :3], moved.labels[:, -3:] = cells[:, :3], cells[:, -3:]
    labels = label_pixels(frame_of(disparity_image(scene.depth_m), model),
                          RegionGraph.of(model, moved))
    assert (labels != scene.labels).mean() < 0.004  # less than one pixel a row


@pytest.mark.parametrize('scene', SCENES.values(), ids=SCENES)
def test_a_plane_grows_to_where_the_surface_leaves_it(scene):
    """Cells without a label between the plane and its border do not make it a staircase."""
    model, size = cell_model(scene.depth_m), 4
    cells = scene.labels[size // 2::size, size // 2::size]
    true, is_first = regions_of_labels(model, cells), cells == 0
    is_short = is_first & np.roll(is_first, 3, axis=1) & np.roll(is_first, -3, axis=1)
    short = PlaneRegions(np.where(is_short, 0, -1).astype(np.int32), true.coefficients)
    frame = frame_of(disparity_image(scene.depth_m), model)
    graph = RegionGraph.of(model, short)
    grown = label_pixels(frame, graph)
    assert ((grown == 0) != (scene.labels == 0)).mean() < 0.004  # less than one pixel a row
    kept = np.full(scene.labels.shape, -1, np.int32)
    label_more_pixels(frame, graph, kept, 5)
    assert ((kept == 5) != (scene.labels == 0)).mean() > 0.02


def test_a_plane_takes_the_pixels_within_their_noise():
    """As plain numpy says it, of a wall seen aslant, .3 to 1 m away, in depth of millimetres."""
    depth_m = view([wall(0.5)], intrinsics=CAMERA, angles_deg=(35, 10, 0)).depth_m
    model = cell_model(depth_m)
    every_other = np.indices(model.grid.shape).sum(axis=0) % 2 - 1
    error_m = np.random.default_rng(0).uniform(-0.008, 0.008, depth_m.shape)
    frame = frame_of(disparity_image((depth_m + error_m).astype(np.float32)), model, Noise(0.001))
    graph = RegionGraph.of(model, PlaneRegions(
        every_other.astype(np.int32), one_patch(model).coefficients))
    labels = np.full(depth_m.shape, np.int32(-1))
    label_more_pixels(frame, graph, labels, 0)
    (a, b, c), (v, u) = model.grid.planes_in_pixels(graph.planes)[0], np.indices(depth_m.shape)
    deviations = (np.abs(frame.image.values - (a * u + b * v + c))
                  / frame.noise.variance_floor(frame.image.values) ** 0.5)
    assert deviations.max() > 2 * MAX_DEVIATIONS
    is_clear = np.abs(deviations - MAX_DEVIATIONS) > 0.01
    assert ((labels == 0) == (deviations <= MAX_DEVIATIONS))[is_clear].all()


def test_pixels_without_valid_neighbours_get_a_label():
    """As on sparse lidar."""
    depth_m = noisy(SCENES['step'], 0, 0.003).copy()
    depth_m[np.random.default_rng(1).random(depth_m.shape) < 0.7] = np.nan
    labels = segment_planes(depth_m, CAMERA).labels
    assert (labels[np.isfinite(depth_m)] >= 0).mean() > 0.97


@pytest.mark.parametrize('seed', range(3))
def test_noise_does_not_tear_the_border_of_a_small_step(seed):
    """At a step of 4 deviations a pixel alone is on the wrong side once in 40 times."""
    scene = view([wall(2, right_m=0), wall(2.1, 0)], intrinsics=CAMERA)
    labels = segment_planes(noisy(scene, seed, 0.006, smooth_share=0.0), CAMERA).labels
    true = np.where(scene.labels == scene.labels[120, 60], labels[120, 60], labels[120, 260])
    assert labels[120, 60] != labels[120, 260]
    assert (labels != true)[:, 156:164].mean() < 0.013


JOINTED = CameraIntrinsics(400.0, 500.0, 180.0, 110.0, 320, 240)


def wall_with_joints(depth_of_joints_m, width_px):
    """Return the depth of a slanted wall, 2 m ahead, with a grid of joints behind it."""
    ray = (np.arange(JOINTED.width) - JOINTED.cx) / JOINTED.fx
    depth_m = np.tile(2.0 / (1 + 0.3 * ray), (JOINTED.height, 1))
    is_joint = np.zeros(depth_m.shape, bool)
    for start in range(20, 320, 60):
        is_joint[:, start:start + width_px] = True
        is_joint[start:start + width_px] = True
    return np.where(is_joint, depth_m + depth_of_joints_m, depth_m).astype(np.float32), is_joint


@pytest.mark.parametrize('depth_of_joints_m, belongs', [(0.008, True), (0.08, False)])
def test_joints_belong_to_their_wall_if_they_are_shallow(depth_of_joints_m, belongs):
    depth_m, is_joint = wall_with_joints(depth_of_joints_m, 3)
    labels = segment_planes(depth_m, JOINTED).labels
    assert (labels[~is_joint] == 0).mean() > 0.98
    share = (labels[is_joint] == 0).mean()
    assert share > 0.9 if belongs else share < 0.3


@pytest.mark.parametrize('reach_px', [3, 4, 5, 7])
def test_a_box_smeared_over_its_edges_has_its_front_and_the_wall(reach_px):
    """The mean of 1/z over a square of pixels is linear across an edge."""
    for seed in range(9000, 9003):
        disparity = np.full((480, 640), 1 / 3.0)
        disparity[140:330, 220:420] = 1 / 1.2
        ramps = cv2.blur(disparity, (2 * reach_px + 1,) * 2)
        is_ramp = abs(ramps - disparity) > 0.03
        noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(ramps.shape),
                                 (0, 0), 2)
        found = segment_planes(1 / (ramps + 0.0012 * noise / noise.std()), VGA)
        assert len(found.planes) == 2
        assert (found.labels[is_ramp] >= 0).mean() < 0.3


@pytest.mark.parametrize('angle_deg', [3.0, 6.0, 12.0])
def test_the_side_of_a_box_seen_nearly_from_the_side_is_a_plane(angle_deg):
    """The box stands out of a wall 6 m away; its side begins 1 m away, its end is not the wall."""
    ray_x = np.broadcast_to((np.arange(640) - VGA.cx) / VGA.fx, (480, 640))
    slope = np.tan(np.radians(angle_deg))
    side_m = -0.05 / (ray_x - slope + 1e-9)  # x = -.05 + slope * z, from the front to 3 m
    is_side = (side_m > 1.0) & (side_m < 3.0)
    front = ray_x * 1.0 < -0.05 + slope
    depth_m = np.where(is_side, side_m, np.where(front, 1.0, 6.0))
    wide = is_side[0].sum()
    found = segment_planes(depth_m, VGA)
    seen = found.labels[is_side]
    best = np.bincount(seen + 1, minlength=2)[1:].argmax()
    assert wide > 10
    assert (seen == best).mean() > 0.7
    assert abs(found.planes[best].normal[0]) == pytest.approx(np.cos(np.radians(angle_deg)),
                                                               abs=0.02)
