# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Borders of planes that a network blurred move to the edges of the image, others stay."""

import cv2
import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.evaluation.metrics import overlap, segmentation_covering
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.pixels.edge_snapping import (
    GuideImage,
    blurs_steps,
    snap_to_image_edges,
)
from plane_detector.segmentation.segment import segment

COLOURS = np.array([[200, 60, 50], [60, 70, 190], [90, 180, 80], [30, 30, 30]], np.uint8)


def scene(shape=(120, 161)):
    """Return true labels and an image: two halves, a square on the left one."""
    true = np.zeros(shape, np.int32)
    true[:, shape[1] // 2:] = 1
    true[30:80, 20:60] = 2
    rgb = COLOURS[true] + np.random.default_rng(0).normal(0, 6.0, (*shape, 3))
    return true, np.clip(rgb, 0, 255).astype(np.uint8)


def snapped_labels(labels, guide):
    """Snap with a depth that is on all planes, and so contradicts none."""
    planes = np.zeros((labels.max(initial=0) + 1, 3))
    return snap_to_image_edges(labels, guide, np.zeros(labels.shape, np.float32), planes,
                               Noise(0.001), is_blurred=False)


def covering(true, labels):
    return segmentation_covering(overlap(true, labels, np.ones(true.shape, bool)).counts)


@pytest.mark.parametrize(('down', 'right'), [(0, 6), (-5, 0), (4, -6)])
@pytest.mark.parametrize('shape', [(120, 161), (121, 160)])
def test_borders_beside_an_edge_move_onto_it(shape, down, right):
    true, rgb = scene(shape)
    wrong = np.roll(true, (down, right), axis=(0, 1))
    inside = np.s_[8:-8, 8:-8]  # what was rolled in at the rim has no edge
    before = covering(true[inside], wrong[inside])
    after = covering(true[inside], snapped_labels(wrong, GuideImage(rgb, 10.0))[inside])
    assert before < 0.955
    assert after > max(0.955, before + 0.01)


def test_pixels_beyond_the_reach_keep_their_label():
    true, rgb = scene()
    wrong = np.roll(true, 30, axis=1)
    snapped = snapped_labels(wrong, GuideImage(rgb, 8.0))
    changed = snapped != wrong
    columns = np.flatnonzero(changed[100])
    border = np.flatnonzero(np.diff(wrong[100]))
    assert changed.any()
    assert np.abs(columns[:, None] - border).min(axis=1).max() <= 8 + 2


def test_a_plane_narrower_than_the_reach_is_not_lost():
    true, rgb = scene()
    true[100:104, 10:150] = 3
    snapped = snapped_labels(true, GuideImage(rgb, 12.0))
    assert (snapped[true == 3] == 3).all()


def near_and_far(edge, blur_px):
    """Return an image of two halves, and labels, planes and disparity with this edge."""
    rgb = np.full((120, 160, 3), 60, np.uint8)
    rgb[:, 80:] = 190
    disparity = np.full((120, 160), 0.5, np.float32)
    disparity[:, edge:] = 0.25
    labels = (disparity < 0.4).astype(np.int32)
    if blur_px:
        disparity = cv2.GaussianBlur(disparity, (0, 0), blur_px)
    return rgb, labels, np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.25]]), disparity


@pytest.mark.parametrize(('blur_px', 'column'), [(4.0, 80), (0.0, 86)])
@pytest.mark.parametrize('sigma', [0.0, 0.005])
def test_depth_is_contradicted_only_where_its_edges_are_blurred(blur_px, column, sigma):
    rgb, labels, planes, disparity = near_and_far(86, blur_px)
    disparity += np.random.default_rng(0).normal(0, sigma, disparity.shape).astype(np.float32)
    seen = (GuideImage(rgb, 10.5), disparity, planes,
            Noise(1e-3, pixel_sigma=sigma, mean_sigma=sigma))
    snapped = snap_to_image_edges(labels, *seen, blurs_steps(labels, *seen))
    assert np.median(snapped.argmax(axis=1)) == pytest.approx(column, abs=1)


@pytest.mark.parametrize(('sigma', 'column'), [(0.0003, 80), (0.002, 75)])
def test_a_crease_moves_only_where_the_noise_hides_it(sigma, column):
    """Planes that meet at column 80 differ by .004 at the edge of the image, at column 76."""
    rgb = np.full((120, 161, 3), 60, np.uint8)
    rgb[:, 76:] = 190
    off_px = np.broadcast_to(np.arange(161) - 80.0, (120, 161))
    disparity = (0.5 + 0.001 * np.maximum(off_px, 0)).astype(np.float32)
    labels = (off_px >= 0).astype(np.int32)
    disparity += np.random.default_rng(0).normal(0, sigma, disparity.shape).astype(np.float32)
    planes = np.array([[0.0, 0.0, 0.5], [0.001, 0.0, 0.42]])
    snapped = snap_to_image_edges(labels, GuideImage(rgb, 6.0), disparity, planes,
                                  Noise(1e-5, pixel_sigma=sigma, mean_sigma=3 * sigma),
                                  is_blurred=False)
    assert np.median(snapped.argmax(axis=1)) == pytest.approx(column, abs=1)


@pytest.mark.parametrize('blur_px', [4.0, 0.0])
def test_colours_make_patches_only_where_depth_edges_are_blurred(monkeypatch, blur_px):
    """A dark square on the left half, which the depth does not show, is a patch of its own."""
    rgb, labels, planes, disparity = near_and_far(80, blur_px)
    rgb[40:80, 20:60] = 130
    for stages in ('_exact', '_measured'):
        monkeypatch.setattr(f'plane_detector.segmentation.segment.{stages}', lambda *_: (
            labels, np.arange(len(planes)), planes, np.empty(0, np.int64)))
    patches = segment(disparity, Noise(1e-3), Config(), guide=GuideImage(rgb, 10.5)).patches
    assert patches.shape == ((30, 40) if blur_px else (0, 0))
    if blur_px:
        left, square, right = patches[:8, :18], patches[12:18, 7:13], patches[:, 22:]
        assert all((part == part[0, 0]).all() for part in (left, square, right))
        assert len({left[0, 0], square[0, 0], right[0, 0]}) == 3
        assert patches.min() > 0
