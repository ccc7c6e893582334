# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of drawings of planes and depth."""

import numpy as np
import pytest

from plane_detector.drawing import (
    PALETTE,
    colour_depth,
    colours_by_label,
    figure,
    label_colours,
    overlay,
    plane_colours,
    tint,
)
from plane_detector.types import PlaneClass

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


LABELS = np.arange(1, 40)


def of_class(kind):
    return plane_colours(LABELS, np.full(len(LABELS), kind)).astype(int)


def test_floors_are_green_walls_blue_level_surfaces_yellow_and_others_violet():
    for kind, most in ((PlaneClass.FLOOR, 1), (PlaneClass.RAMP, 1), (PlaneClass.WALL, 2)):
        assert (of_class(kind).argmax(axis=1) == most).all()
    for kind, order in ((PlaneClass.OTHER_HORIZONTAL, (0, 1, 2)), (PlaneClass.STEP, (0, 1, 2)),
                        (PlaneClass.OTHER, (2, 0, 1))):
        assert (np.diff(of_class(kind)[:, order], axis=1) < 0).all()


@pytest.mark.parametrize('kind', [kind for kind in PlaneClass if kind != PlaneClass.UNKNOWN])
def test_neighbouring_labels_of_a_class_differ_in_lightness(kind):
    lightness = of_class(kind).mean(axis=1)
    assert np.abs(np.diff(lightness)).min() > 20


def test_planes_of_unknown_class_are_neither_green_nor_blue_and_neighbours_differ():
    colours = of_class(PlaneClass.UNKNOWN)
    assert (colours.argmax(axis=1) == 0).all()
    assert np.linalg.norm(np.diff(colours, axis=0), axis=1).min() > 50


def test_shapes_have_the_colours_of_the_palette():
    table = colours_by_label(np.array([2]), np.array([PlaneClass.WALL]), 9)
    np.testing.assert_array_equal(table[[3, 9]], label_colours(np.array([3, 9])))
    np.testing.assert_array_equal(table[2], plane_colours(np.array([2]), [PlaneClass.WALL])[0])


@pytest.mark.parametrize('colours', [
    np.zeros((1, 3), np.uint8), np.zeros((0, 3), np.uint8), np.zeros((4, 4), np.uint8),
    np.zeros((4, 3)), np.zeros(3, np.uint8)])
def test_colours_that_are_none_of_labels_are_refused(colours):
    labels = np.ones((4, 6), int)
    with pytest.raises(ValueError, match=r'\(N, 3\) uint8'):
        tint(np.zeros((4, 6, 3), np.uint8), labels, colours)


def test_colours_may_be_part_of_a_larger_array():
    colours = np.arange(24, dtype=np.uint8).reshape(4, 6)[:, ::2]
    drawn = tint(np.zeros((4, 6, 3), np.uint8), np.full((4, 6), 2), colours, 1.0)
    np.testing.assert_array_equal(drawn[0, 0], colours[2])
