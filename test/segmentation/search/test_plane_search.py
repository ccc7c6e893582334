# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The noise that the search starts from and settles at, and which way it takes to the planes."""

from itertools import product

import numpy as np
import pytest
from cell_helpers import EXACT, best_iou, disparity_image, noisy, view, wall

from plane_detector import CameraIntrinsics, segment_planes
from plane_detector.config import Config
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.model import Frame
from plane_detector.segmentation.cells.noise import DepthKind
from plane_detector.segmentation.search.plane_search import search_planes

ROOMS = (3, 7, 11)
SMALL = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
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


@pytest.mark.parametrize('sigma', [0.001, 0.01])
def test_a_wall_under_smooth_noise_is_one_plane(sigma):
    """Its first planes are pieces, in whose residuals the smooth part of the noise is missing."""
    scene = single_wall(SMALL, yaw_deg=0, distance_m=2.0)
    assert np.mean([segment_planes(noisy(scene, seed, sigma), SMALL).labels == 0
                    for seed in range(6)]) > 0.97


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
