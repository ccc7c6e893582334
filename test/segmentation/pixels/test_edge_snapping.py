# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Borders of planes that a network blurred move to the edges of the image, others stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, SegmentationConfig
from plane_detector.depth.depth_function import DepthFunction
from plane_detector.evaluation.metrics import overlap, segmentation_covering
from plane_detector.segmentation.pixels.edge_snapping import GuideImage, snap_to_image_edges

COLOURS = np.array([[200, 60, 50], [60, 70, 190], [90, 180, 80], [30, 30, 30]], np.uint8)


def scene(shape=(120, 161), grain=6.0, seed=0):
    """Return true labels and an image: two halves, a square on the left one."""
    true = np.zeros(shape, np.int32)
    true[:, shape[1] // 2:] = 1
    true[30:80, 20:60] = 2
    rng = np.random.default_rng(seed)
    rgb = COLOURS[true] + rng.normal(0, grain, (*shape, 3))
    return true, np.clip(rgb, 0, 255).astype(np.uint8)


def shifted(labels, down, right):
    return np.roll(labels, (down, right), axis=(0, 1))


def covering(true, labels):
    return segmentation_covering(overlap(true, labels, np.ones(true.shape, bool)).counts)


@pytest.mark.parametrize(('down', 'right'), [(0, 6), (-5, 0), (4, -6)])
@pytest.mark.parametrize('shape', [(120, 161), (121, 160)])
def test_borders_beside_an_edge_move_onto_it(shape, down, right):
    true, rgb = scene(shape)
    wrong = shifted(true, down, right)
    inside = np.s_[8:-8, 8:-8]  # what was rolled in at the rim has no edge
    before = covering(true[inside], wrong[inside])
    after = covering(true[inside], snap_to_image_edges(wrong, GuideImage(rgb, 10.0))[inside])
    assert before < 0.955
    assert after > max(0.955, before + 0.01)


def test_pixels_beyond_the_reach_keep_their_label():
    true, rgb = scene()
    wrong = shifted(true, 0, 30)
    snapped = snap_to_image_edges(wrong, GuideImage(rgb, 8.0))
    changed = snapped != wrong
    columns = np.flatnonzero(changed[100])
    border = np.flatnonzero(np.diff(wrong[100]))
    assert changed.any()
    assert np.abs(columns[:, None] - border).min(axis=1).max() <= 8 + 2


def test_no_plane_has_borders_too():
    true, rgb = scene()
    true[true == 2] = -1
    snapped = snap_to_image_edges(shifted(true, 5, 5), GuideImage(rgb, 10.0))
    inside = np.s_[8:-8, 8:-8]
    assert (snapped[inside] == true[inside]).mean() > 0.98


def test_a_plane_narrower_than_the_reach_is_not_lost():
    true, rgb = scene()
    true[100:104, 10:150] = 3
    snapped = snap_to_image_edges(true, GuideImage(rgb, 12.0))
    assert (snapped[true == 3] == 3).all()


@pytest.mark.parametrize('reach_px', [0.0, 0.9])
def test_without_reach_nothing_moves(reach_px):
    true, rgb = scene()
    wrong = shifted(true, 0, 5)
    np.testing.assert_array_equal(snap_to_image_edges(wrong, GuideImage(rgb, reach_px)), wrong)


@pytest.mark.parametrize('shape', [(1, 1), (2, 2), (3, 400), (5, 5)])
def test_small_images_are_taken(shape):
    labels = np.arange(np.prod(shape), dtype=np.int32).reshape(shape) % 3 - 1
    rgb = np.zeros((*shape, 3), np.uint8)
    snapped = snap_to_image_edges(labels, GuideImage(rgb, 10.0))
    assert set(np.unique(snapped)) <= set(np.unique(labels))


def test_input_is_not_modified():
    true, rgb = scene()
    labels, image = true.copy(), rgb.copy()
    snap_to_image_edges(labels, GuideImage(image, 10.0))
    np.testing.assert_array_equal(labels, true)
    np.testing.assert_array_equal(image, rgb)


def blurred_depth(rgb):
    """Return two walls in depth, with the step 6 pixels beside the edge of the image."""
    depth_m = np.full(rgb.shape[:2], 2.0, np.float32)
    depth_m[:, rgb.shape[1] // 2 + 6:] = 4.0
    return depth_m


def blurred_network(output):
    def values(rgb):
        return blurred_depth(rgb) if output == 'metric_depth' else 1 / blurred_depth(rgb)
    return DepthFunction(values, output, noise_share=0.03, blur_px=10.5)


def border_column(detector, **given):
    rgb = np.full((120, 160, 3), 60, np.uint8)
    rgb[:, 80:] = 190
    intrinsics = CameraIntrinsics(130.0, 130.0, 79.5, 59.5, 160, 120)
    labels = detector.detect(rgb, intrinsics, **given).labels
    return np.median(np.argmax(labels != labels[:, :1], axis=1))


@pytest.mark.parametrize(('snap', 'column'), [(True, 80), (False, 86)])
@pytest.mark.parametrize('output', ['metric_depth', 'disparity', 'relative_disparity'])
def test_the_pipeline_snaps_what_a_network_says(output, snap, column):
    config = Config(segmentation=SegmentationConfig(snap_to_picture=snap))
    detector = PlaneDetector(config, blurred_network(output))
    assert border_column(detector) == pytest.approx(column, abs=1)


def test_the_pipeline_leaves_measured_depth_alone():
    config = replace(Config(), depth=DepthConfig(source='topic'))
    depth_m = blurred_depth(np.zeros((120, 160, 3)))
    assert border_column(PlaneDetector(config), depth_m=depth_m) == pytest.approx(86, abs=1)
