# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of drawings of planes and depth."""

from __future__ import annotations

import numpy as np
import pytest

from plane_detector.directions.drawing import draw_directions
from plane_detector.drawing import (
    PALETTE,
    colour_depth,
    depth_range,
    figure,
    label_colours,
    overlay,
    tint,
)
from plane_detector.types import CameraIntrinsics

GREY = np.full((120, 160, 3), 128, np.uint8)


def two_planes(dtype=np.uint32) -> np.ndarray:
    labels = np.zeros((120, 160), dtype)
    labels[:, :60], labels[:, 100:] = 1, 2
    return labels


def test_colours_of_a_palette_are_far_apart():
    distance = np.linalg.norm(PALETTE[:, None].astype(float) - PALETTE[None], axis=-1)
    distance[np.diag_indices(len(PALETTE))] = np.inf
    assert distance.min() > 50


def test_label_colours_repeat_after_the_last():
    colours = label_colours(np.array([1, 2, len(PALETTE), len(PALETTE) + 1], np.uint32))
    assert colours.dtype == np.uint8
    np.testing.assert_array_equal(colours, PALETTE[[0, 1, -1, 0]])


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.uint32, np.int32])
def test_tint_colours_only_planes(dtype):
    labels = two_planes(dtype)
    tinted = tint(GREY, labels)
    np.testing.assert_array_equal(tinted[labels == 0], GREY[labels == 0])
    for label in (1, 2):
        np.testing.assert_allclose(tinted[labels == label],
                                   np.broadcast_to(0.45 * 128 + 0.55 * PALETTE[label - 1],
                                                   (np.sum(labels == label), 3)), atol=1)


def test_tint_takes_a_label_far_beyond_the_palette():
    labels = np.where(two_planes() == 2, 65535, 0).astype(np.uint16)
    expected = 0.45 * 128 + 0.55 * label_colours(np.array([65535]))[0]
    np.testing.assert_allclose(tint(GREY, labels)[labels > 0][0], expected, atol=1)


def test_overlay_draws_white_borders_and_does_not_change_its_input():
    rgb, labels = GREY.copy(), two_planes()
    drawn = overlay(rgb, labels)
    assert (drawn[:40, 59] == 255).all()  # the number is in the middle
    assert (drawn[:40, 99] == 255).all()
    np.testing.assert_array_equal(rgb, GREY)
    np.testing.assert_array_equal(labels, two_planes())


@pytest.mark.parametrize(('height', 'thickness'), [(480, 1), (960, 2), (1440, 3)])
def test_borders_are_thicker_in_larger_images(height, thickness):
    labels = np.ones((height, 600), np.uint32)
    labels[:, 300:] = 2
    white = (overlay(np.zeros((height, 600, 3), np.uint8), labels) == 255).all(axis=-1)[50]
    first = 299 - (thickness - 1) // 2
    assert np.flatnonzero(white).tolist() == list(range(first, first + thickness))


def test_overlay_writes_a_number_inside_each_plane():
    drawn, labels = overlay(GREY, two_planes()), two_planes()
    for label in (1, 2):
        assert (drawn[labels == label] == 0).all(axis=-1).any()  # the black box
    assert not (drawn[labels == 0] == 0).all(axis=-1).any()


def test_overlay_omits_the_number_of_a_thin_plane():
    labels = np.zeros((480, 640), np.uint32)
    labels[100:103] = 1
    assert (overlay(np.full((480, 640, 3), 128, np.uint8), labels) > 0).all()


def test_overlay_without_a_plane_is_the_image():
    np.testing.assert_array_equal(overlay(GREY, np.zeros((120, 160), np.uint32)), GREY)


@pytest.mark.parametrize('shape', [(1, 1), (2, 3), (7, 500)])
def test_overlay_of_tiny_images(shape):
    drawn = overlay(np.zeros((*shape, 3), np.uint8), np.ones(shape, np.uint32))
    assert drawn.shape == (*shape, 3)


def test_overlay_refuses_labels_of_another_size():
    with pytest.raises(ValueError, match='labels'):
        overlay(GREY, np.zeros((60, 80), np.uint32))


def test_depth_is_red_near_blue_far_and_black_where_invalid():
    depth_m = np.linspace(1, 10, 120 * 160, dtype=np.float32).reshape(120, 160)
    depth_m[0, 0], depth_m[0, 1], depth_m[0, 2], depth_m[0, 3] = np.nan, np.inf, 0, -1
    coloured = colour_depth(depth_m).astype(int)
    assert (coloured[0, :4] == 0).all()
    near, far = coloured[1, 0], coloured[-10, 0]
    assert near[0] > 2 * near[2]
    assert far[2] > 2 * far[0]
    assert far.max() > 100


@pytest.mark.parametrize('value', [np.nan, 0.0, np.inf])
def test_missing_depth_is_black(value):
    depth_m = np.full((4, 5), value, np.float32)
    assert not colour_depth(depth_m).any()
    assert np.isnan(depth_range(depth_m)).all()


def test_constant_depth_is_one_colour():
    assert len(np.unique(colour_depth(np.full((4, 5), 2, np.float32)).reshape(-1, 3), axis=0)) == 1


def test_depth_range_ignores_outliers():
    depth_m = np.full(1000, 2.0, np.float32)
    depth_m[:5], depth_m[5:10] = 0.01, 79.0
    assert depth_range(depth_m) == (2.0, 2.0)


def test_figure_sets_panels_in_rows_and_fills_the_last():
    panels = [(f'panel {k}', np.full((60, 80, 3), 10 * k, np.uint8)) for k in range(1, 4)]
    drawn = figure(panels)
    height, width = drawn.shape[0] // 2, drawn.shape[1] // 2
    assert width >= 80
    assert height > 60
    for k, (row, column) in enumerate([(0, 0), (0, 1), (1, 0)], start=1):
        panel = drawn[row * height:(row + 1) * height, column * width:(column + 1) * width]
        assert (panel == 10 * k).all(axis=-1).sum() >= 60 * 80
    assert (drawn[height:, width:] == 255).all()


def test_figure_cuts_a_long_title_to_the_width():
    drawn = figure([('a title that is much longer than its image is wide ' * 2, GREY)], 1)
    bar = drawn[:20]
    assert (bar[:, -5:] == 255).all()
    assert (bar < 100).any()


CAMERA = CameraIntrinsics(120.0, 120.0, 79.5, 59.5, 160, 120)
LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def yellow_rows(drawn):
    return np.nonzero(np.abs(drawn.astype(int) - (255, 230, 0)).max(-1) < 40)[0]


@pytest.mark.parametrize(('pitch_deg', 'row'), [(0, 59.5), (10, 59.5 - 120 * np.tan(0.1745))])
def test_the_horizon_is_where_rays_are_level(pitch_deg, row):
    """Looking down by the pitch the horizon rises by f tan pitch."""
    pitch = np.radians(pitch_deg)
    drawn = draw_directions(GREY, CAMERA, np.array([0, np.cos(pitch), np.sin(pitch)]),
                            np.zeros((0, 3)))
    assert yellow_rows(drawn).mean() == pytest.approx(row, abs=1.0)
    assert (GREY == 128).all()


def test_strokes_of_each_direction_have_their_colour():
    drawn = draw_directions(GREY, CAMERA, np.array([0.0, 1.0, 0.0]), LEVEL)
    for colour in ((40, 90, 255), (255, 50, 50), (40, 200, 60)):
        assert np.abs(drawn.astype(int) - colour).max(-1).min() < 70


def test_unknown_gravity_draws_nothing():
    assert np.array_equal(draw_directions(GREY, CAMERA, None, np.zeros((0, 3))), GREY)


@pytest.mark.parametrize('down', [(0, 0, 1.0), (0, 1e-9, 1.0), (1.0, 0, 0)])
def test_a_horizon_outside_the_image_is_not_an_error(down):
    assert draw_directions(GREY, CAMERA, np.array(down), LEVEL).shape == GREY.shape
