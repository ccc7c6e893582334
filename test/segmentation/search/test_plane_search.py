# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The noise that the search starts from and settles at; clusters of labels."""

from itertools import product

import numpy as np
import pytest
from cell_helpers import EXACT, best_iou, disparity_image, noisy, view, wall
from sklearn.cluster import DBSCAN

from plane_detector.config import Config, DbscanConfig
from plane_detector.evaluation.datasets import labelled_frames
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.model import Frame
from plane_detector.segmentation.cells.noise import DepthKind
from plane_detector.segmentation.search.plane_search import search_planes
from plane_detector.segmentation.search.ransac import (
    WIDEST_WINDOW_CELLS,
    cell_places,
    draw_planes,
    label_clusters,
)

ROOMS = (3, 7, 11)
# Of the variance of the noise, half is smooth over the image and half is grain.
PART = np.sqrt(0.5)


def found(depth_m):
    """Return model, regions and noise of a depth image."""
    image = disparity_image(depth_m)
    frame, regions = search_planes(Frame(image, build_cell_grid(image), EXACT, 600, Config(),
                                         np.random.default_rng(0)))
    return frame.cells, regions, frame.noise


@pytest.mark.parametrize('seed', ROOMS)
def test_exact_depth_has_no_noise(room, seed):
    scene = room(seed)
    model, regions, noise = found(scene.depth_m)
    assert noise.mean_sigma < 1e-5
    assert noise.pixel_sigma < 1e-5
    assert noise.kind(model.grid.typical_disparity) is DepthKind.EXACT
    large = np.bincount(scene.labels[scene.labels >= 0]) > 20000
    assert (best_iou(scene, np.kron(regions.labels, np.ones((8, 8), int)))[large] > 0.7).all()


@pytest.mark.parametrize(('seed', 'sigma'), [
    (ROOMS[0], 0.0001), (ROOMS[0], 0.001), *product(ROOMS, (0.004, 0.01))])
def test_noise_is_estimated_within_half_as_much_again(room, seed, sigma):
    """Between exact and noisy there is no gap: all parts of the noise are known at any level."""
    model, regions, noise = found(noisy(room(seed), seed, sigma))
    assert sigma * PART / 1.5 < noise.mean_sigma < sigma * PART * 1.5
    assert noise.pixel_sigma == pytest.approx(sigma * PART, rel=0.1)
    assert sigma < 0.004 or noise.kind(model.grid.typical_disparity) is DepthKind.MEASURED
    assert len(regions.coefficients) >= 5


def test_few_cells_beside_a_plane_that_fills_the_image_are_not_its():
    """One cell in fifty, each in the middle of the plane, is half a metre behind it."""
    scene = view([wall(2)], angles_deg=(20, 0, 0))
    depth_m = noisy(scene, 0, 0.001).copy()
    behind = np.zeros((60, 80), bool)
    behind[4::7, 4::7] = True
    depth_m[np.kron(behind, np.ones((8, 8), bool))] += 0.5
    _, regions, _ = found(depth_m)
    assert (regions.labels[behind] == -1).all()
    assert (regions.labels[~behind] == 0).mean() > 0.9


@pytest.mark.parametrize(('flat_share', 'is_exact'), [(0.7, True), (0.1, False)])
def test_most_of_the_image_must_be_flat_for_exact_depth(flat_share, is_exact):
    """What is left of the image is far too noisy for a plane."""
    scene = view([wall(2)], angles_deg=(20, 0, 0))
    noisy_m = noisy(scene, 0, 0.02).copy()
    edge = round(flat_share * noisy_m.shape[1])
    noisy_m[:, :edge] = scene.depth_m[:, :edge]
    _, regions, noise = found(noisy_m)
    assert (noise.pixel_sigma < 1e-5) == is_exact
    assert len(regions.coefficients) >= 1


SHAPE = (23, 31)


def random_labels(rng, share):
    """Return labels in blotches, so that clusters have insides, with cells without label."""
    coarse = rng.integers(0, 4, (8, 11)).repeat(3, axis=0).repeat(3, axis=1)
    labels = coarse[:SHAPE[0], :SHAPE[1]]
    return np.where(rng.random(SHAPE) < share, labels, -1).astype(np.int32)


def numbered(labels):
    """Return labels numbered by where they come first, so that equal partitions are equal."""
    kinds, first, index = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.where(kinds < 0, -1, first))
    rank = np.empty(len(kinds), int)
    rank[order] = np.arange(len(kinds))
    return rank[index].reshape(labels.shape)


@pytest.mark.parametrize('eps', [1.0, 1.5, 2.5])
@pytest.mark.parametrize('min_samples', [1, 3, 7])
@pytest.mark.parametrize('share', [0.5, 0.75, 1.0])
def test_every_label_is_clustered_as_scikit_learn_does(eps, min_samples, share):
    labels = random_labels(np.random.default_rng(int(100 * share)), share)
    clusters, cells, starts = label_clusters(labels, DbscanConfig(eps, min_samples))
    assert clusters.shape == labels.shape
    np.testing.assert_array_equal(
        clusters.ravel()[cells], np.repeat(np.arange(clusters.max() + 1), np.diff(starts)))
    assert (clusters[labels < 0] == -1).all()
    used = []
    for label in range(4):
        points = np.argwhere(labels == label)
        found, expected = clusters[labels == label], DBSCAN(
            eps=eps, min_samples=min_samples).fit(points)
        core = expected.core_sample_indices_
        np.testing.assert_array_equal(found == -1, expected.labels_ == -1)
        np.testing.assert_array_equal(numbered(found[core]), numbered(expected.labels_[core]))
        for index in np.setdiff1d(np.flatnonzero(found >= 0), core):
            near = np.linalg.norm(points[core] - points[index], axis=1) <= eps
            assert found[index] in found[core[near]], 'a border cell joins one that it touches'
        used += np.unique(found[found >= 0]).tolist()
    assert sorted(used) == list(range(clusters.max() + 1)), 'numbered from 0, none of two labels'


def test_planes_are_drawn_at_the_same_places_whichever_cells_are_free(room):
    """In a video noise changes which cells are planar: all places moved with them."""
    cells, _, _ = found(noisy(room(3), 3, 0.001))
    places = cell_places(cells.grid.shape, WIDEST_WINDOW_CELLS)
    fewer = places.copy()
    fewer[:len(places) // 3].flat[::7] = -1  # clutter above

    def draw(free, share):
        return draw_planes(free.ravel(), places.shape[1], (cells.table, cells.grid.moments), 60,
                           share, np.empty((0, 4)))

    drawn, share = draw(places, 0.3)
    again, later = draw(fewer, 0.3)[0], draw(places, share)[0]
    same, repeated = (sum((plane == drawn).all(axis=1).any() for plane in one)
                      for one in (again, later))
    assert len(again) > 60 and same > 0.5 * len(again)
    assert repeated < 0.2 * len(later) and share != draw(places, 0.7)[1], 'the sequence goes on'


def test_one_image_has_one_noise(data_folder):
    """Terraces of a tray: from the same noise at the start, it settled between .0026 and .005."""
    frame = next((one for one in labelled_frames(data_folder) if one.name == 'tt'), None)
    if frame is None:
        pytest.skip('no frame tt')
    sigmas = []
    for seed in range(6):
        noise = 5e-4 * np.random.default_rng(seed).standard_normal(frame.depth_m.shape)
        _, _, noise = found((frame.depth_m * (1 + noise)).astype(np.float32))
        sigmas.append(noise.mean_sigma / noise.bending)
    assert max(sigmas) < 1.2 * min(sigmas)
