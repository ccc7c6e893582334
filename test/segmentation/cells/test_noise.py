# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rounded disparities are known as such, exact and real depth is not taken for them."""

import numpy as np
import pytest
from cell_helpers import disparity_image, millimetres, noisy, scored

from plane_detector import segment_planes
from plane_detector.evaluation.benchmark.samples import CURVED, curved_scene
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.model import weigh_cells
from plane_detector.segmentation.cells.noise import Noise, estimate_noise, with_quantisation
from plane_detector.segmentation.cells.plane_fit import fit_planes

FLOOR = Noise(0.0005)


def rounded(depth_m, step):
    """Return depth whose inverse is a multiple of the step."""
    return (1 / (np.rint(1 / depth_m / step) * step)).astype(np.float32)


def step_of(depth_m):
    """Return the step between disparities whose uniform error is the floor."""
    return with_quantisation(FLOOR, disparity_image(depth_m)).disparity_floor * 12**0.5


@pytest.mark.parametrize('step', [0.001, 0.003, 0.01])
@pytest.mark.parametrize('yaw_deg', [10, 40])
def test_the_step_of_rounded_disparities_is_found(step, yaw_deg):
    depth_m = rounded(single_wall(yaw_deg=yaw_deg).depth_m, step)
    assert step_of(depth_m) == pytest.approx(step, rel=0.01)
    assert len(segment_planes(depth_m, VGA).planes) == 1


@pytest.mark.parametrize('seed', range(2))
def test_rounded_rooms_do_not_fall_into_stripes(room, seed):
    scene = room(seed)
    result = scored(scene, segment_planes(rounded(scene.depth_m, 0.003), scene.intrinsics))
    assert result.segmentation_covering > 0.95
    assert result.precision > 0.9


@pytest.mark.parametrize('content', [('column', 0.4), ('ball', 0.7), ('pipe', 0.25)])
@pytest.mark.parametrize('step', [0.003, 0.01])
def test_rounding_does_not_make_planes_of_curved_things(content, step):
    """A sensor with steps in disparity is a sensor, not a network that bends planes."""
    kind, radius_m = content
    scene = curved_scene(CURVED.index((radius_m, (0, -15, 4), kind)))
    depth_m = with_disparity_noise(scene.depth_m, 0.001, np.random.default_rng(0))
    labels = segment_planes(rounded(depth_m, step), scene.intrinsics).labels
    assert (labels[scene.labels < 0] >= 0).mean() < 0.1
    for plane in range(len(scene.planes)):
        is_plane = scene.labels == plane
        own = labels == np.bincount(labels[is_plane] + 1).argmax() - 1
        assert np.count_nonzero(own & is_plane) > 0.9 * np.count_nonzero(own | is_plane)


@pytest.mark.parametrize('yaw_deg', [0, 5])
@pytest.mark.parametrize('distance_m', [1.0, 6.0])
def test_exact_walls_and_those_in_millimetres_are_not_rounded(yaw_deg, distance_m):
    depth_m = single_wall(yaw_deg=yaw_deg, distance_m=distance_m).depth_m
    assert step_of(depth_m) == step_of(millimetres(depth_m)) == 0


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('sigma', [0.0, 0.004])
def test_rooms_are_not_rounded(room, seed, sigma):
    assert step_of(noisy(room(seed), seed, sigma)) == 0


def test_cells_of_few_pixels_are_known_to_be_noisier():
    rng = np.random.default_rng(0)
    depth_m = with_disparity_noise(single_wall(yaw_deg=20).depth_m, 0.004, rng, smooth_share=0.0)
    full = build_cell_grid(disparity_image(depth_m))
    depth_m = np.where(rng.random(depth_m.shape) > 0.25, np.float32(np.nan), depth_m)
    grid = build_cell_grid(disparity_image(depth_m))
    noise = estimate_noise(grid, FLOOR)
    assert noise.mean_sigma < 0.7 * 0.004 / 4  # sixteen of 64 pixels
    plane = fit_planes(full.moments.sum(axis=0)[None])[0]
    residual = grid.mean[:, 2] - grid.mean[:, :2] @ plane[:2] - plane[2]
    table = weigh_cells(grid, noise).table
    assert np.mean(residual**2 * table[:, 5]) == pytest.approx(1, abs=0.3)
    tilt = ((grid.slope - plane[:2])**2).sum(axis=1) / 2
    assert np.mean(tilt * table[:, 6]) == pytest.approx(1, abs=0.3)
