# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Network inputs according to the published recipe, and conversion of outputs."""

import cv2
import numpy as np
import pytest

from plane_detector.depth.networks import IMAGENET_MEAN, IMAGENET_STD
from plane_detector.depth.preprocessing import (
    InputRecipe,
    finish_output,
    lower_bound_size,
    prepare_input,
)

IMAGENET = InputRecipe(1 / 255, IMAGENET_MEAN, IMAGENET_STD)


# The published recipe of Depth Anything V2 (image2tensor), said again in float64: RGB / 255,
# resize keeping the aspect to a lower bound of 518 in multiples of 14 by INTER_CUBIC, normalise,
# channels first.

def recipe_side(side, factor):
    nearest = int(np.round(side * factor / 14) * 14)
    return nearest if nearest >= 518 else int(np.ceil(side * factor / 14) * 14)


def published_recipe(rgb):
    height, width = rgb.shape[:2]
    factor = max(518 / width, 518 / height)
    resized = cv2.resize(rgb / 255.0, (recipe_side(width, factor), recipe_side(height, factor)),
                         interpolation=cv2.INTER_CUBIC)
    return ((resized - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]).transpose(2, 0, 1)


@pytest.mark.parametrize('size', [(640, 480), (480, 640), (1280, 720), (518, 518), (333, 250),
                                  (1242, 375)])
def test_input_is_that_of_the_published_recipe(size):
    width, height = size
    rgb = np.random.default_rng(width).integers(0, 256, (height, width, 3), dtype=np.uint8)
    expected = published_recipe(rgb)
    planes = prepare_input(rgb, lower_bound_size(width, height, 518, 14), IMAGENET)
    assert planes.shape == expected.shape
    assert planes.dtype == np.float32
    np.testing.assert_allclose(planes, expected, rtol=0, atol=1e-3)


def test_depth_of_a_plane_stays_a_plane_when_it_is_enlarged():
    # 1/z = 0.2 + 0.01 u at pixel centres; enlarged 4 times, away from the repeated border.
    small_u = np.arange(16) * 4 + 1.5
    small = np.tile(1 / (0.2 + 0.01 * small_u), (12, 1)).astype(np.float32)
    large = finish_output(small, (64, 48), 'metric_depth')
    expected = np.tile(1 / (0.2 + 0.01 * np.arange(64)), (48, 1))
    np.testing.assert_allclose(large[:, 2:-2], expected[:, 2:-2], rtol=1e-5)


@pytest.mark.parametrize('output', ['metric_depth', 'disparity', 'relative_disparity'])
def test_values_not_finite_or_positive_become_nan(output):
    raw = np.array([[1.0, 1e-3, 500.0, 0.0, -1.0, np.nan, np.inf]], np.float32)
    finished = finish_output(raw, (7, 1), output)
    assert finished.dtype == np.float32
    np.testing.assert_array_equal(np.isfinite(finished[0]), [1, 1, 1, 0, 0, 0, 0])
    np.testing.assert_allclose(finished[0, :3], raw[0, :3], rtol=1e-6)


def test_an_invalid_pixel_is_not_blended_into_its_neighbours():
    raw = np.full((4, 4), 2.0, np.float32)
    raw[1, 1] = 0.0
    large = finish_output(raw, (16, 16), 'metric_depth')
    assert np.isnan(large[5, 5])
    np.testing.assert_allclose(large[np.isfinite(large)], 2.0, rtol=1e-6)
    assert np.isfinite(large[:, 10:]).all()


def test_a_large_image_is_reduced_without_aliasing():
    stripes = np.zeros((960, 1280, 3), np.uint8)
    stripes[:, ::2] = 200
    given = prepare_input(stripes, (160, 120), InputRecipe(1.0, (0.0,) * 3, (1.0,) * 3))
    np.testing.assert_allclose(given, 100, atol=1)


@pytest.mark.parametrize('size, input_size', [
    ((640, 480), (224, 224)), ((641, 363), (224, 224)), ((1280, 720), (416, 224)),
    ((320, 240), (320, 224)), ((224, 224), (224, 224)), ((3, 500), (2, 7))])
def test_an_area_of_the_image_becomes_its_mean(size, input_size):
    """The mean of what a pixel of the input covers, parts of pixels by their share."""
    rng, (width, height) = np.random.default_rng(size[0]), input_size
    rgb = rng.integers(0, 256, (*size[::-1], 3), dtype=np.uint8)

    def shares(many, few):
        ends = np.arange(few + 1) * many / few
        covered = np.minimum(ends[1:, None], np.arange(many) + 1) - np.maximum(
            ends[:-1, None], np.arange(many))
        return covered.clip(0) * few / many

    means = np.einsum('yv,xu,vuc->cyx', shares(size[1], height), shares(size[0], width),
                      rgb.astype(float), optimize=True)
    expected = (means / 255 - np.reshape(IMAGENET_MEAN, (3, 1, 1))) / np.reshape(
        IMAGENET_STD, (3, 1, 1))
    recipe = InputRecipe(1 / 255, IMAGENET_MEAN, IMAGENET_STD, 'area')
    np.testing.assert_allclose(prepare_input(rgb, input_size, recipe), expected, atol=2e-5)
    np.testing.assert_array_equal(prepare_input(rgb[:, ::-1], input_size, recipe),
                                  prepare_input(rgb[:, ::-1].copy(), input_size, recipe))
