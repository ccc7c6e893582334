# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Steps cut regions apart, noise, quantisation and holes do not."""

from functools import cache

import numpy as np
import pytest
from cell_helpers import (
    EXACT,
    best_iou,
    cell_model,
    disparity_image,
    frame_of,
    hand_made,
    one_patch,
    rectangle,
    view,
    wall,
)

from plane_detector import segment_planes
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import VGA, single_wall
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions import depth_steps
from plane_detector.segmentation.regions.depth_steps import split_at_depth_steps

SIGMA = 0.01
STEP = 0.003
NOISE = Noise(EXACT.depth_floor_m, mean_sigma=0.006, slope_sigma=0.2, pixel_sigma=0.007)
WALL_M = 2.5
FRAMES = {'wide': (-0.35, -0.25, 0.8, 0.6), 'high': (-0.3, -0.4, 0.6, 0.8)}
V, U = np.mgrid[:480, :640]
OFF = np.hypot(U - 320, V - 240)
HOLES = {'disc': OFF < 90, 'box': (abs(U - 320) < 100) & (abs(V - 240) < 70),
         'ring': abs(OFF - 130) < 12, 'thin ring': abs(OFF - 130) < 4,
         'speckle': np.random.default_rng(5).random((480, 640)) < 0.3}


@cache
def framed(frame, gap_m):
    """Return a wall with a picture frame of 60 x 80 cm that is so far off it."""
    left, low, width, height = FRAMES[frame]
    return view([wall(WALL_M), rectangle([left, WALL_M - gap_m, low], [width, 0, 0],
                                         [0, 0, height])])


@cache
def bare(seed):
    """Return the depth of the wall under noise, half of whose variance is smooth."""
    return with_disparity_noise(view([wall(WALL_M)]).depth_m, SIGMA, np.random.default_rng(seed))


def split(depth_m, noise=None):
    """Return the pieces that the whole image, taken as one region, is cut into."""
    image = disparity_image(depth_m)
    noise = noise or estimate_noise(build_cell_grid(image), EXACT)
    model = cell_model(depth_m, noise)
    regions = one_patch(model)
    return split_at_depth_steps(frame_of(image, model, noise), regions,
                                Correlation.of(model, regions, noise))


@pytest.mark.parametrize(('frame', 'gap_m', 'least'), [
    ('wide', 0.06, 2), ('high', 0.06, 6), ('wide', 0.08, 5), ('high', 0.08, 9)])
def test_a_picture_frame_is_a_plane_of_its_own(frame, gap_m, least):
    """At 6 cm, 1.4 deviations of the smooth part, 10 and 26 of 40; at 8 cm 30 and 39."""
    scene, hits = framed(frame, gap_m), 0
    for seed in range(10):
        noisy_m = with_disparity_noise(scene.depth_m, SIGMA, np.random.default_rng(seed))
        hits += best_iou(scene, segment_planes(noisy_m, VGA).labels).min() > 0.5
    assert hits >= least


def test_a_piece_takes_its_cells_and_both_get_planes_of_their_own():
    scene = framed('wide', 0.12)
    depth_m = with_disparity_noise(scene.depth_m, SIGMA, np.random.default_rng(0))
    pieces = split(depth_m, NOISE)
    assert len(pieces.coefficients) == 2
    middle = scene.labels[4::8, 4::8] == scene.labels[240, 320]
    assert ((pieces.labels == 1) & middle).sum() > 0.9 * middle.sum()
    assert ((pieces.labels == 1) & ~middle).sum() < 0.15 * middle.sum()
    np.testing.assert_allclose(1 / pieces.coefficients[:, 2], [WALL_M, WALL_M - 0.12], atol=0.02)
    fitted = hand_made(cell_model(depth_m, NOISE), pieces.labels).coefficients
    np.testing.assert_allclose(pieces.coefficients, fitted, rtol=1e-6)


def test_pixels_without_depth_do_not_hide_a_step():
    depth_m = with_disparity_noise(framed('wide', 0.12).depth_m, SIGMA, np.random.default_rng(0))
    depth_m[np.random.default_rng(5).random(depth_m.shape) < 0.05] = np.nan
    assert len(split(depth_m).coefficients) == 2


def test_a_block_is_compared_at_the_pixels_that_it_has():
    depth_m = view([wall(WALL_M)], angles_deg=(40, 20, 0)).depth_m
    depth_m[np.random.default_rng(5).random(depth_m.shape) < 0.2] = np.nan
    image, model = disparity_image(depth_m), cell_model(depth_m)
    region, grid = one_patch(model), model.grid
    residual, owner = depth_steps._block_residuals(
        image.values, image.valid, region.labels, grid.planes_in_pixels(region.coefficients),
        grid.size_px)
    assert (owner >= 0).mean() > 0.7
    assert np.abs(residual[owner >= 0]).max() < 1e-6


def test_a_bare_wall_stays_one_plane():
    """Alone in all of 30; in the whole 27 of 30, where a bulge may survive the merging."""
    assert [len(split(bare(seed)).coefficients) for seed in range(30)] == 30 * [1]
    counts = [len(segment_planes(bare(seed), VGA).planes) for seed in range(30)]
    assert counts.count(1) >= 27
    assert max(counts) <= 2


@pytest.mark.parametrize('yaw_deg', [5, 10, 20, 40])
def test_rounded_disparity_does_not_fall_into_its_stripes(yaw_deg):
    """Each is as flat as can be, and 0.003 per metre from the next."""
    depth_m = single_wall(yaw_deg=yaw_deg).depth_m
    rounded = np.rint(1 / depth_m / STEP)
    assert len(np.unique(rounded)) > 10
    # A little noise before the rounding, as any sensor has.
    noisy_m = with_disparity_noise(depth_m, STEP / 3, np.random.default_rng(0))
    rounded_m = (1 / (np.rint(1 / noisy_m / STEP) * STEP)).astype(np.float32)
    assert len(segment_planes(rounded_m, VGA).planes) == 1


@pytest.mark.parametrize('hole', HOLES)
@pytest.mark.parametrize('seed', range(4))
def test_holes_make_no_steps(hole, seed):
    depth_m = bare(seed).copy()
    depth_m[HOLES[hole]] = np.nan
    assert len(split(depth_m).coefficients) == 1


def test_nothing_to_split_is_returned_as_it_is():
    depth_m = np.full((480, 640), np.nan, np.float32)
    model = cell_model(depth_m)
    none = one_patch(model)
    none = type(none)(np.full(model.grid.shape, -1, np.int32), none.coefficients[:0])
    frame = frame_of(disparity_image(depth_m), model)
    assert split_at_depth_steps(frame, none, None) is none
    assert split_at_depth_steps(frame, none, Correlation(1.0, 0.1, 0.1, 1.0, (60, 80))) is none
