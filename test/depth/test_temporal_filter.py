# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Temporal filter: averages while nothing moves, and has no effect as soon as anything does."""


import cv2
import numpy as np
import pytest

from plane_detector.depth.temporal_filter import filter_disparity

SHAPE = (240, 320)
TRUTH = np.tile(np.linspace(0.2, 0.6, SHAPE[1], dtype=np.float32), (SHAPE[0], 1))
NOISE = 0.01


def scenery(shape=SHAPE):
    """Return an image of many edges."""
    coarse = np.random.default_rng(0).integers(40, 220, (shape[0] // 20, shape[1] // 20, 3))
    return np.kron(coarse, np.ones((20, 20, 1))).astype(np.uint8)


def seen(image, rng):
    """Return an image with the noise of a sensor."""
    return np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)


def flickering(rng, truth=TRUTH):
    return truth + rng.normal(0, NOISE, truth.shape).astype(np.float32)


def moved(image, pixels):
    """Return the image of a camera that has turned by this many pixels."""
    matrix = np.float32([[1, 0, pixels], [0, 1, 0]])
    return cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REFLECT)


def damped(images, disparities, keep=0.8, same_scale=True):
    """Return the state after these."""
    state = None
    for rgb, disparity in zip(images, disparities, strict=True):
        state = filter_disparity(state, disparity, rgb, keep, same_scale=same_scale)
    return state


def still(count, rng=None):
    """Return images and disparities of a camera that stands still."""
    rng = rng or np.random.default_rng(1)
    return [seen(scenery(), rng) for _ in range(count)], [flickering(rng) for _ in range(count)]


def rms(state, truth=TRUTH):
    return float(np.sqrt(np.nanmean((state.disparity - truth) ** 2)))


def test_noise_falls_according_to_the_share():
    state = damped(*still(25), keep=0.8)
    assert rms(state) == pytest.approx(NOISE / 3, rel=0.05)  # sqrt((1 - k) / (1 + k))


def test_the_first_images_have_equal_weights():
    images, disparities = still(4)
    np.testing.assert_allclose(damped(images, disparities, keep=0.8).disparity,
                               np.mean(disparities, axis=0), atol=1e-6)


def turned(pixels):
    def change(images, disparities):
        images[-1] = seen(moved(scenery(), pixels), np.random.default_rng(2))
    return change


def brightened(images, disparities):
    images[-1][100:120, 100:120] = 255


def nearer(images, disparities):
    disparities[-1][100:150, 100:150] += 0.05


def farther_in_a_part_without_depth(images, disparities):
    for disparity in disparities:
        disparity[:100] = np.nan
    disparities[-1][100:150, 100:150] -= 0.05


@pytest.mark.parametrize('change', [turned(0.7), turned(1.5), turned(40), brightened, nearer,
                                    farther_in_a_part_without_depth])
def test_motion_or_new_depth_ends_the_average_of_the_whole_image(change):
    images, disparities = still(6)
    change(images, disparities)
    state = damped(images, disparities)
    assert state.image_count == 1
    np.testing.assert_array_equal(state.disparity, disparities[-1])


def test_a_change_below_a_tenth_of_the_range_is_flicker():
    images, disparities = still(6)
    disparities[-1][100:150, 100:150] += 0.02
    assert damped(images, disparities).image_count == 6


def test_slow_motion_adds_up_and_never_lags_by_a_pixel():
    rng = np.random.default_rng(1)
    starts = []
    state = None
    for index in range(40):
        rgb = seen(moved(scenery(), 0.1 * index), rng)
        state = filter_disparity(state, flickering(rng), rgb, 0.8, same_scale=True)
        starts.append(state.image_count == 1)
    assert not any(np.convolve(~np.array(starts), np.ones(10), 'valid') == 10)


def test_a_speck_is_not_motion_and_is_not_averaged():
    images, disparities = still(6)
    images[-1][110, 110] = 255
    state = damped(images, disparities)
    assert state.image_count == 6
    assert state.disparity[110, 112] == disparities[-1][110, 112]
    assert rms(state) < NOISE / 2


def test_relative_disparity_of_any_scale_and_shift():
    images, disparities = still(20)
    rng = np.random.default_rng(4)
    lines = [(rng.uniform(0.2, 5), rng.uniform(-0.5, 0.5)) for _ in disparities]
    told = [scale * one + shift for one, (scale, shift) in zip(disparities, lines, strict=True)]
    state = damped(images, [one.astype(np.float32) for one in told], same_scale=False)
    scale, shift = lines[-1]
    assert state.image_count == 20
    assert rms(state, scale * TRUTH + shift) < 0.45 * scale * NOISE


def test_a_wild_patch_does_not_change_the_scale():
    images, disparities = still(6)
    disparities[-1][100:108, 100:108] = 50.0
    state = damped(images, disparities, same_scale=False)
    assert state.image_count == 6
    state.disparity[100:108, 100:108] = np.nan
    assert rms(state) < 0.6 * NOISE


def test_invalid_pixels_stay_invalid_and_new_ones_stand_alone():
    images, disparities = still(4)
    for disparity in disparities[:-1]:
        disparity[:40] = np.nan
    disparities[-1][-40:] = np.inf
    state = damped(images, disparities)
    assert state.image_count == 4
    assert not np.isfinite(state.disparity[-40:]).any()
    np.testing.assert_array_equal(state.disparity[:40], disparities[-1][:40])
    assert np.isfinite(state.disparity[:-40]).all()


@pytest.mark.parametrize('height', [24, 240])
def test_bands_are_rows_of_the_blurred_image(height):
    state = filter_disparity(None, TRUTH[:height], scenery()[:height], 0.8, same_scale=True)
    rows = {row.tobytes() for row in np.round(state.grey, 3)}
    for k in range(4):
        assert len(state.band(k))
        assert all(row.tobytes() in rows for row in np.round(state.band(k), 3))


@pytest.mark.parametrize('top', range(0, 240, 20))
def test_a_change_of_the_second_image_is_seen_in_any_rows(top):
    images, disparities = still(2)
    images[-1][top:top + 20, 100:120] = 255
    assert damped(images, disparities).image_count == 1
