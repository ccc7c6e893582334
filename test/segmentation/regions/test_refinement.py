# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Ragged borders between patches become smooth, and follow what the noise does not explain."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cell_helpers import EXACT, cells_and_noise, fold, hand_made, noisy, rectangle, view, wall

from plane_detector.segmentation.cells.noise_correlation import Correlation, residuals
from plane_detector.segmentation.regions import refinement
from plane_detector.segmentation.regions.refinement import refine_borders

SIGMA = 0.01
SCENES = {'box': view([wall(2.5), rectangle([-0.35, 2.2, -0.25], [0.8, 0, 0], [0, 0, 0.6])]),
          'corner': view(fold(120)), 'steps': view([wall(2, right_m=0), wall(2.3, 0)])}


def model_of(scene, seed=0, sigma=SIGMA):
    return cells_and_noise(noisy(scene, seed, sigma))


def true_labels(scene):
    return np.unique(scene.labels[4::8, 4::8], return_inverse=True)[1].reshape(60, 80)


def ragged(labels, seed, share=0.3):
    """Return labels of which so many of the cells along borders have that of the other side."""
    known = labels.astype(np.uint8)
    square = np.ones((3, 3), np.uint8)
    most, least = cv2.dilate(known, square), cv2.erode(known, square)
    chosen = np.random.default_rng(seed).random(labels.shape) < share
    return np.where(chosen, most + least - known, known).astype(int)


@pytest.mark.parametrize('name', SCENES)
@pytest.mark.parametrize('seed', range(4))
def test_a_ragged_border_becomes_straight(name, seed):
    model, noise = model_of(SCENES[name], seed)
    true = true_labels(SCENES[name])
    start = ragged(true, seed)
    patches = hand_made(model, start)
    refined = refine_borders(model, patches, noise)
    pixels = SCENES[name].labels.reshape(60, 8, 80, 8)
    whole = pixels.max(axis=(1, 3)) == pixels.min(axis=(1, 3))
    wrong, left = (np.count_nonzero((of != true) & whole) for of in (start, refined.labels))
    assert wrong > 20
    assert left <= 0.1 * wrong
    np.testing.assert_allclose(refined.planes, hand_made(model, refined.labels).planes)


def energy(model, planes, labels, correlation):
    reach = refinement.REACH_CELLS
    residual = residuals(model, planes, np.arange(4800), labels.ravel(), np.inf)
    residual = residual.reshape(labels.shape)
    pull = cv2.filter2D(residual, -1, correlation.precision(reach),
                        borderType=cv2.BORDER_REFLECT)
    unlike = sum(np.count_nonzero(labels[i] != labels[j]) for i, j in (
        (np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[1:, 1:], np.s_[:-1, :-1]), (np.s_[1:, :-1], np.s_[:-1, 1:])))
    return (residual * pull).sum() / 2 + 2 * refinement.AGREEMENT * unlike


def test_the_energy_goes_down():
    model, noise = model_of(SCENES['box'])
    patches = hand_made(model, ragged(true_labels(SCENES['box']), 0))
    correlation = Correlation.of(model, patches, noise)
    labels = refine_borders(model, patches, noise).labels
    before, after = (energy(model, patches.planes, of, correlation)
                     for of in (patches.labels, labels))
    assert after < before - 50


def test_cells_without_a_plane_stay_without():
    model, noise = model_of(SCENES['box'])
    labels = ragged(true_labels(SCENES['box']), 0)
    labels[25:35, :30] = -1
    refined = refine_borders(model, hand_made(model, labels), noise)
    np.testing.assert_array_equal(refined.labels < 0, labels < 0)


def test_a_patch_that_loses_all_its_cells_is_gone():
    model, noise = model_of(SCENES['steps'])
    labels = true_labels(SCENES['steps'])
    labels[10, 10] = 2
    patches = hand_made(model, labels)
    patches.planes[2] = patches.planes[0] + [0, 0, 0.1]
    refined = refine_borders(model, patches, noise)
    assert len(refined.planes) == 2
    np.testing.assert_array_equal(refined.labels, true_labels(SCENES['steps']))


@pytest.mark.parametrize('known', [True, False])
def test_nothing_moves_on_exact_depth_or_that_of_a_network(known):
    model, noise = model_of(SCENES['box'], sigma=SIGMA if known else 0)
    patches = hand_made(model, ragged(true_labels(SCENES['box']), 0))
    noise = replace(noise, known=0.005) if known else EXACT
    assert refine_borders(model, patches, noise) is patches
