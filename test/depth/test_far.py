# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth beyond the range of a network, and clear sky, are not surfaces."""

import cv2
import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.depth.far import find_sky, has_usable_distance
from plane_detector.depth.observation import DepthFunction, ModelDepth
from plane_detector.types import CameraIntrinsics

HEIGHT, WIDTH = 240, 320
HORIZON = 110
CAMERA = CameraIntrinsics(300.0, 300.0, 159.5, 119.5, WIDTH, HEIGHT)


def landscape(top=(160, 195, 245), horizon=(225, 235, 245)):
    """Return an image of a sky, whiter downwards, over textured ground, and a disparity of it."""
    rgb = np.random.default_rng(0).integers(30, 120, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    weight = np.linspace(0, 1, HORIZON)[:, None, None]
    rgb[:HORIZON] = np.rint((1 - weight) * top + weight * horizon)
    disparity = np.full((HEIGHT, WIDTH), 0.3, np.float32)  # as by a network of rooms
    disparity[HORIZON:] = np.linspace(0.31, 0.8, HEIGHT - HORIZON)[:, None]
    return rgb, disparity


@pytest.mark.parametrize('white_rows', [0, 30])
def test_a_clear_sky_is_found_up_to_its_border_and_the_white_above_the_horizon(white_rows):
    rgb, disparity = landscape()
    rgb[HORIZON - white_rows:HORIZON] = (236, 236, 237)
    rgb.flags.writeable = disparity.flags.writeable = False
    sky = find_sky(rgb, disparity)
    assert sky[:HORIZON].all()
    assert not sky[HORIZON + 9:].any()
    assert sky[HORIZON:].mean() < 0.02, 'some bluish pixels of the ground beside it'


@pytest.mark.parametrize('colours', [
    {'top': (190, 200, 215), 'horizon': (160, 168, 181)},  # a bluish wall, darker downwards
    {'top': (200, 210, 225), 'horizon': (200, 210, 225)},  # an even one
    {'top': (225, 215, 200), 'horizon': (235, 230, 220)},  # a yellowish one
    {'top': (200, 200, 200), 'horizon': (240, 240, 240)},  # white, as overcast sky
    {'top': (20, 40, 90), 'horizon': (70, 80, 100)},       # dark
    {'top': (180, 200, 182), 'horizon': (225, 232, 204)},  # greenish, less blue downwards
    {'top': (200, 180, 230), 'horizon': (206, 236, 237)}])  # violet, greener downwards
def test_a_wall_is_not_sky(colours):
    assert find_sky(*landscape(**colours)) is None


def test_a_textured_wall_is_not_sky():
    rgb, disparity = landscape()
    rgb[:HORIZON] -= 20 * (np.indices((HORIZON, WIDTH)).sum(axis=0) // 6 % 2).astype(
        np.uint8)[..., None]
    assert find_sky(rgb, disparity) is None


@pytest.mark.parametrize('share', [0.95, 1.0])
def test_a_white_wall_is_not_sky(share):
    rgb, disparity = landscape(top=(255, 255, 255), horizon=(255, 255, 255))
    behind = share * np.median(disparity[HORIZON:])
    assert find_sky(rgb, np.where(np.arange(len(rgb))[:, None] < HORIZON, behind,
                                  disparity)) is None
    assert find_sky(np.full_like(rgb, 255), np.full_like(disparity, 0.5)) is None


@pytest.mark.parametrize(('colour', 'is_sky'), [((255, 255, 255), True), ((255, 255, 0), False)])
def test_an_overexposed_sky_is_white_and_far(colour, is_sky):
    rgb, disparity = landscape(top=colour, horizon=colour)
    disparity[:HORIZON] = 0.1
    sky = find_sky(rgb, disparity)
    assert (sky[:HORIZON].all() and not sky[HORIZON + 9:].any()) if is_sky else sky is None


def test_the_reduced_image_of_a_narrow_one_is_not_large(monkeypatch):
    """Else 3 x 4000 pixels would become 34 million."""
    sizes, resize = [], cv2.resize
    monkeypatch.setattr(cv2, 'resize', lambda image, size, **how: (
        sizes.append(size), resize(image, size, **how))[1])
    assert find_sky(np.full((4000, 3, 3), 90, np.uint8), np.ones((4000, 3), np.float32)) is None
    assert max(width * height for width, height in sizes) < 500_000
    find_sky(*landscape())
    assert (160, 160 * HEIGHT // WIDTH) in sizes


def test_a_disparity_within_its_noise_of_zero_determines_no_distance():
    rgb = np.zeros((1, 4, 3), np.uint8)
    disparity = np.array([[0.029, 0.031, 0.5, np.nan]], np.float32)
    usable, _ = has_usable_distance(disparity, 0.01, rgb)
    np.testing.assert_array_equal(usable, [[False, True, True, True]])
    assert has_usable_distance(disparity, 0.0, rgb)[0].all()
    assert has_usable_distance(disparity, 0.01, rgb, has_shift=True)[0].all(), (
        'the shift is not known')
    assert has_usable_distance(disparity - 0.1, 0.01, rgb, has_shift=True)[0].all()


@pytest.mark.parametrize('output', ['metric_depth', 'disparity', 'relative_disparity'])
def test_models_give_no_depth_there(output):
    rgb, disparity = landscape()
    disparity[HORIZON:HORIZON + 4] = 0.02  # farther than 3 * 0.0175 * 0.5 allows
    values = 1 / disparity if output == 'metric_depth' else disparity
    source = ModelDepth(DepthFunction(lambda rgb: values, output, noise_share=0.0175))
    seen = source.observe(rgb, CAMERA, None, Config())
    assert np.isnan(seen.prediction.values[:HORIZON + 4]).all()
    np.testing.assert_array_equal(seen.prediction.values[HORIZON + 4:], values[HORIZON + 4:])


def cloudy(height=HORIZON):
    """Return an image of grey clouds over dark ground, and a network's relative disparity."""
    rng = np.random.default_rng(1)
    rgb = rng.integers(30, 120, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    clouds = cv2.GaussianBlur(rng.normal(0, 1, (height, WIDTH)).astype(np.float32), (0, 0), 9)
    rgb[:height] = np.clip(190 + 25 * clouds / clouds.std(), 150, 240)[..., None]
    disparity = np.full((HEIGHT, WIDTH), 0.12, np.float32)
    disparity[height:] = np.linspace(0.13, 1.0, HEIGHT - height)[:, None]
    return rgb, disparity + rng.normal(0, 0.001, disparity.shape).astype(np.float32)


def test_a_cloudy_sky_is_the_flat_bright_region_of_least_disparity():
    rgb, disparity = cloudy()
    sky = find_sky(rgb, disparity, True)
    assert sky[:HORIZON].mean() > 0.9 and sky[HORIZON + 9:].mean() < 0.01


def test_a_bright_wall_is_no_sky():
    rgb, disparity = cloudy()
    assert find_sky(rgb, disparity) is None, 'a metric network sees a wall'
    wall = disparity + np.float32(0.06) * np.linspace(0, 1, WIDTH, dtype=np.float32)
    assert find_sky(rgb, wall, True) is None, 'it recedes'
    reddish = (rgb * [1, 0.95, 0.9]).astype(np.uint8)
    assert find_sky(reddish, disparity, True) is None
    dark = rgb.copy()
    dark[HORIZON:] = np.clip(dark[HORIZON:].astype(int) + 110, 0, 255)
    assert find_sky(dark, disparity, True) is None, 'the rest is as bright'
    assert find_sky((0.6 * rgb).astype(np.uint8), disparity, True) is None, 'it is too dark'
    near = disparity.copy()
    near[-80:] = 0.05
    assert find_sky(rgb, near, True) is None, 'something is farther'
