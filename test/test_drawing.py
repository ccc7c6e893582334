# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of drawings of planes and depth."""

import numpy as np
import pytest

from plane_detector.drawing import PALETTE, colour_depth, figure, overlay, tint
from plane_detector.tools.demo.directions import draw_directions
from plane_detector.types import CameraIntrinsics

GREY = np.full((120, 160, 3), 128, np.uint8)
GREY.flags.writeable = False


def two_planes(dtype=np.uint32) -> np.ndarray:
    labels = np.zeros((120, 160), dtype)
    labels[:, :60], labels[:, 100:] = 1, 2
    labels.flags.writeable = False
    return labels


def test_colours_of_a_palette_are_far_apart():
    distance = np.linalg.norm(PALETTE[:, None].astype(float) - PALETTE[None], axis=-1)
    distance[np.diag_indices(len(PALETTE))] = np.inf
    assert distance.min() > 50


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.uint32, np.int32])
def test_tint_colours_only_planes(dtype):
    labels = two_planes(dtype)
    tinted = tint(GREY, labels)
    np.testing.assert_array_equal(tinted[labels == 0], GREY[labels == 0])
    for label in (1, 2):
        np.testing.assert_allclose(tinted[labels == label],
                                   np.broadcast_to(0.45 * 128 + 0.55 * PALETTE[label - 1],
                                                   (np.sum(labels == label), 3)), atol=1)


def test_overlay_draws_white_borders_and_a_number_inside_each_plane():
    drawn, labels = overlay(GREY, two_planes()), two_planes()
    assert (drawn[:40, [59, 99]] == 255).all()  # the number is in the middle
    for label in (1, 2):
        assert (drawn[labels == label] == 0).all(axis=-1).any()  # the black box
    assert not (drawn[labels == 0] == 0).all(axis=-1).any()


def test_depth_is_red_near_blue_far_and_black_where_invalid():
    depth_m = np.linspace(1, 10, 120 * 160, dtype=np.float32).reshape(120, 160)
    depth_m[0, :4] = np.nan, np.inf, 0, -1
    coloured = colour_depth(depth_m).astype(int)
    assert (coloured[0, :4] == 0).all()
    near, far = coloured[1, 0], coloured[-10, 0]
    assert near[0] > 2 * near[2] and far[2] > 2 * far[0] and far.max() > 100


def test_figure_sets_panels_in_rows_and_fills_the_last():
    panels = [(f'panel {k}', np.full((60, 80, 3), 10 * k, np.uint8)) for k in range(1, 4)]
    drawn = figure(panels)
    height, width = drawn.shape[0] // 2, drawn.shape[1] // 2
    assert width >= 80 and height > 60
    for k, (row, column) in enumerate([(0, 0), (0, 1), (1, 0)], start=1):
        panel = drawn[row * height:(row + 1) * height, column * width:(column + 1) * width]
        assert (panel == 10 * k).all(axis=-1).sum() >= 60 * 80
    assert (drawn[height:, width:] == 255).all()


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
