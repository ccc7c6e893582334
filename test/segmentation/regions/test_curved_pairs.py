# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Facets of curved things lose their labels under noise, planes that meet in a fold do not."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cell_helpers import FLOOR, ball, best_iou, cell_model, fold, hand_made, view, wall

from plane_detector import segment_planes
from plane_detector.config import Config
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.surfaces import cone
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.regions import curved
from plane_detector.segmentation.regions.region_graph import RegionGraph

ROOM = [wall(4), FLOOR]
SIGMA = 0.004
X = np.linspace(-0.5, 0.5, 640)
NOISE = Noise(Config().ransac.noise_floor, mean_sigma=SIGMA, slope_sigma=0.05, pixel_sigma=SIGMA)


def column(radius):
    """Return an upright cylinder whose front is 2 m away."""
    return cone(radius, radius, -3, 3).at(0, 2 + radius)


def noisy(scene, sigma, seed=0):
    return with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(seed))


def strips(scene, count=2, noise=NOISE, sigma=SIGMA / 4, width=32):
    """Return model and upright regions that touch, together so many cells wide."""
    model = cell_model(noisy(scene, sigma), noise)
    labels = np.full(model.grid.shape, -1)
    labels[10:50, 40 - width // 2:40 + width // 2] = np.arange(width) * count // width
    return model, hand_made(model, labels)


def facets(count=3):
    """Return model and regions of the front of a column."""
    return strips(view([], column(0.7).curved_pieces()), count)


def upright_strips(disparity, edges):
    """Return model and regions, strips between edges in cells, of disparity (W,) by column."""
    model = cell_model((1 / np.tile(disparity, (480, 1))).astype(np.float32), NOISE)
    labels = np.full(model.grid.shape, -1)
    for k, (left, right) in enumerate(pairwise(edges)):
        labels[20:40, left:right] = k
    return model, hand_made(model, labels)


def find_curved(model, regions, noise_density=np.inf):
    return curved.find_curved(RegionGraph.of(model, regions), noise_density, 4.0)


@pytest.mark.parametrize('count', [2, 3, 4])
def test_facets_of_a_column_are_bent(count):
    assert find_curved(*facets(count)).tolist() == list(range(count))


def test_one_patch_and_none_are_not_bent():
    model, regions = facets(1)
    assert find_curved(model, regions).size == 0
    assert find_curved(model, replace(regions, labels=np.full_like(regions.labels, -1),
                                    coefficients=np.zeros((0, 3)))).size == 0


@pytest.mark.parametrize('seed', range(3))
def test_the_front_of_a_column_in_one_region_is_curved_under_noise_and_a_wall_is_not(seed):
    """Smooth noise of 0.01 per metre: some 25 cells share it."""
    for scene, expected in ((view([], column(0.7).curved_pieces()), [0]), (view([wall(2)]), [])):
        model = cell_model(noisy(scene, 0.01, seed), NOISE)
        is_near = np.nan_to_num(model.grid.mean[:, 2]) > 0.45
        labels = np.where(is_near & model.is_planar, 0, -1).reshape(model.grid.shape)
        assert find_curved(model, hand_made(model, labels), 25 * 0.01**2).tolist() == expected


def test_patches_of_cells_in_a_line_spoil_nothing():
    model, regions = facets()
    labels = regions.labels.copy()
    labels[2, 38:43] = 3
    planes = np.vstack([regions.coefficients, regions.coefficients[:1]])
    with_line = replace(regions, labels=labels, coefficients=planes)
    assert {0, 1, 2} <= set(find_curved(model, with_line))


def test_a_flat_region_beside_them_stays():
    model, regions = facets()
    labels = regions.labels.copy()
    labels[labels >= 0] += 1
    labels[52:58] = 0
    regions = hand_made(model, labels)
    bent = find_curved(model, regions)
    np.testing.assert_array_equal(bent, np.arange(1, len(regions.coefficients)))


def test_what_hardly_turns_is_not_bent():
    """Concrete dips by some degrees: better a floor with a dent than none."""
    regions = strips(view([], column(8.0).curved_pieces()), sigma=0, noise=replace(
        NOISE, mean_sigma=0.0005, slope_sigma=0.01, pixel_sigma=0.0005))
    assert find_curved(*regions).size == 0


def test_patches_with_a_step_between_are_not_bent():
    model, regions = facets(2)
    aside = regions.coefficients + [[0, 0, 0], [0, 0, 4 * SIGMA]]
    assert find_curved(model, replace(regions, coefficients=aside)).size == 0


@pytest.mark.parametrize(('edges', 'is_curved'), [((32, 40, 48), False), ((28, 36, 44, 52), True)])
def test_a_row_of_flat_facets_is_curved_and_one_fold_is_not(edges, is_curved):
    """Chairs are rendered and pressed from facets: each pair of these is an edge of two planes."""
    knots = np.array(edges) / 80 - 0.5
    disparity = 0.5 - np.interp(X, knots, 3 * knots**2)
    assert len(find_curved(*upright_strips(disparity, edges))) == (len(edges) - 1) * is_curved


@pytest.mark.parametrize(('width', 'beside', 'slope', 'bow'), [
    (28, 6, 0.3, 0.3), (24, 8, 0.4, 0.45), (28, 10, 0.4, 0.45)])
def test_a_far_wall_bowed_by_the_calibration_stays_beside_another(width, beside, slope, bow):
    """Most of what a quadric gains on the wide wall it loses on the narrow one, which is flat."""
    corner = width / 160
    disparity = 0.17 + np.where(corner > X, bow * (corner**2 - X**2), -slope * (X - corner))
    edges = 40 - width // 2, 40 + width // 2, 40 + width // 2 + beside
    assert find_curved(*upright_strips(disparity, edges)).size == 0


@pytest.mark.parametrize('width', [8, 16, 32])
@pytest.mark.parametrize('angle_deg', [15, 30, 60])
def test_two_planes_of_a_fold_are_not_bent(angle_deg, width):
    scene = view(fold(angle_deg))
    assert find_curved(*strips(scene, sigma=SIGMA, width=width)).size == 0


@pytest.mark.parametrize('angle_deg', [15, 30, 60])
@pytest.mark.parametrize('sigma', [0.0, 0.002, SIGMA])
def test_planes_that_meet_in_a_fold_stay(angle_deg, sigma):
    scene = view(fold(angle_deg))
    found = segment_planes(noisy(scene, sigma), VGA)
    assert best_iou(scene, found.labels).min() > 0.9


@pytest.mark.parametrize('dent_deg', [2, 4])
def test_a_floor_with_a_dent_stays(dent_deg):
    scene = view(fold(dent_deg))
    found = segment_planes(noisy(scene, 0.0005), VGA)
    assert (found.labels >= 0).mean() > 0.95


@pytest.mark.parametrize('thing', [column(0.4), column(1.0), ball(0.4), ball(1.0)], ids=str)
def test_curved_things_have_hardly_a_plane_under_noise(thing):
    """In most frames: where no pair of regions is clearly bent, all of them stay."""
    scene = view(ROOM, thing.curved_pieces(), angles_deg=(0, -15, 4))
    curved = (scene.labels < 0) & np.isfinite(scene.depth_m)
    large = np.bincount(scene.labels[scene.labels >= 0]) > 1500
    shares = []
    for seed in range(5):
        found = segment_planes(noisy(scene, SIGMA, seed), VGA)
        shares.append((found.labels[curved] < 0).mean())
        assert best_iou(scene, found.labels)[large].min() > 0.9
    assert np.median(shares) > 0.9
