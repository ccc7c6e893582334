# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Directions of pixels are preserved when an image is reduced."""

import numpy as np
import pytest

from plane_detector.geometry.reduction import Reduction

MATRIX = np.array([[500.0, 0, 319.5], [0, 510.0, 239.5], [0, 0, 1]])


@pytest.mark.parametrize('size, side, expected', [
    ((640, 480), 0, (640, 480)), ((640, 480), 640, (640, 480)), ((640, 480), 320, (320, 240)),
    ((480, 640), 320, (240, 320)), ((3840, 2160), 1000, (1000, 562)), ((5000, 2), 100, (100, 1))])
def test_sizes(size, side, expected):
    assert Reduction.to_side(size, side).new_size == expected


def test_the_corners_of_the_image_keep_their_directions():
    reduction = Reduction.to_side((640, 480), 160)
    reduced = reduction.matrix(MATRIX)
    old_px = np.array([[-0.5, -0.5, 1], [639.5, 479.5, 1]])
    new_px = np.array([[-0.5, -0.5, 1], [159.5, 119.5, 1]])
    np.testing.assert_allclose(new_px @ np.linalg.inv(reduced).T,
                               old_px @ np.linalg.inv(MATRIX).T, atol=1e-12)
    assert MATRIX[0, 0] == 500.0, 'the input is not modified'


def test_a_pixel_is_the_mean_of_its_area():
    rgb = np.zeros((4, 8, 3), np.uint8)
    rgb[:2, :2] = [[[40], [0]], [[0], [0]]]
    reduced = Reduction.to_side((8, 4), 4).image(rgb)
    assert reduced.shape == (2, 4, 3)
    assert reduced[0, 0].tolist() == [10, 10, 10]
