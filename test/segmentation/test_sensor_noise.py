# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of real sensors: it bends planes, and it is found in the image."""

import cv2
import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.evaluation.benchmark.samples import furnished, noisy_depth
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import VGA, single_wall
from plane_detector.evaluation.scenes.sensor_cases import SENSOR_CASES
from plane_detector.geometry.disparity import to_disparity
from plane_detector.pipeline import segment_planes
from plane_detector.segmentation.cells.noise_correlation import LEAST_ERROR_M
from plane_detector.segmentation.segment import metric_noise_floor, segment
from plane_detector.tools.demo.photographs import workshop

WALL = single_wall()


def noise_of(depth_m):
    disparity = to_disparity(depth_m.astype(np.float32))
    return segment(disparity, metric_noise_floor(Config()), Config()).noise


def random_walk(shape, rng):
    """Return a field whose differences grow with the distance, of deviation 1."""
    v, u = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing='ij')
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) / np.maximum(np.hypot(u, v), 1e-3)**1.5
    field = np.fft.irfft2(spectrum, shape)
    return (field - field.mean()) / field.std()


def test_systematic_errors_are_distinguished_from_smooth_ones():
    for seed in range(3):
        assert noise_of(noisy_depth(WALL, 0.002, seed)).bending < 1.3
    walk = random_walk(WALL.depth_m.shape, np.random.default_rng(3))
    bent = noise_of(1 / (1 / WALL.depth_m + 0.002 * walk))
    assert bent.bending > 1.6
    assert bent.systematic_sigma == pytest.approx(
        (bent.mean_sigma**2 - (bent.mean_sigma / bent.bending)**2)**0.5)


def test_smooth_errors_without_grain_are_those_of_filtered_depth():
    """Noise blurred over 24 px grows with the distance alike, but has the noise of the pixels."""
    for seed in range(3):
        for smooth_share, low, high in ((0.5, 1.0, 1.1), (1.0, 2.5, 3.0)):
            depth_m = with_disparity_noise(WALL.depth_m, 0.002, np.random.default_rng(seed),
                                           smooth_share, 24.0)
            assert low <= noise_of(depth_m).bending <= high


def test_a_bow_is_no_error_that_wanders():
    """Of smooth noise without grain about a bowed wall; the bow alone would grow as filtered."""
    x, y = np.linspace(-1, 1, 640), np.linspace(-1, 1, 480)[:, None]
    bowed_m = (1 / (1 / WALL.depth_m + 0.004 * (x * x + 0.5 * y * y))).astype(np.float32)
    for seed in range(2):
        assert noise_of(with_disparity_noise(bowed_m, 0.001, np.random.default_rng(seed), 1.0,
                                             10.0)).bending < 1.1


def test_exact_and_white_depth_have_no_systematic_errors():
    white = 1 / WALL.depth_m + np.random.default_rng(0).normal(0, 0.002, WALL.depth_m.shape)
    exact = noise_of(WALL.depth_m)
    assert exact.bending < 1.01 or exact.mean_sigma < 1e-6
    assert noise_of(1 / white).bending < 1.5


@pytest.mark.parametrize('sensor', ['structured light', 'filled, 8 bit'])
def test_a_wall_of_a_few_steps_of_disparity_is_a_plane(sensor):
    """Seen from the front, it takes eight values: in half of the draws it was in pieces."""
    wall = single_wall(yaw_deg=0.0)
    for seed in range(6):
        labels = segment_planes(noisy_depth(wall, sensor, seed), wall.intrinsics).labels
        assert (labels == 0).mean() > 0.9


@pytest.mark.parametrize('wandering, is_sensor', [(0.0, False), (0.001, True)])
def test_rough_noise_that_wanders_bends_planes_by_millimetres_at_least(wandering, is_sensor):
    """Differences that do not grow with the distance are structure: tops that lie aslant."""
    rng = np.random.default_rng(0)
    rough, slow = (cv2.GaussianBlur(rng.standard_normal(WALL.depth_m.shape), (0, 0), sigma_px)
                   for sigma_px in (2.0, 32.0))
    noise = noise_of(WALL.depth_m * (1 + 0.02 * rough + wandering * slow / slow.std()))
    typical = np.median(1 / WALL.depth_m)
    assert noise.systematic_sigma == pytest.approx(
        LEAST_ERROR_M * typical**2 if is_sensor else 0.0, rel=0.1)


def test_even_steps_of_depth_are_its_noise_floor():
    stepped = np.rint(WALL.depth_m * 50) / 50
    assert noise_of(stepped).depth_floor_m == pytest.approx(0.02 / 12**0.5, rel=1e-3)


def corner(lateral_px, seed=0):
    """Return a wall, a floor and a steep side wall seen by a sensor, 1/z, and their labels."""
    rng, (v, u) = np.random.default_rng(seed), np.mgrid[0:480, 0:640].astype(float)
    v += rng.normal(0, lateral_px, v.shape)
    u += rng.normal(0, lateral_px, u.shape)
    faces = 0.33 + np.stack([0 * u, 0.0012 * (v - 240), 0.003 * (u - 400)])
    return faces.max(axis=0) + rng.normal(0, 0.0008, v.shape), faces.argmax(axis=0)


@pytest.mark.parametrize('lateral_px', [0.4, 0.7])
def test_pixels_that_see_aside_are_found_by_steep_surfaces(lateral_px):
    found = [noise_of(1 / corner(lateral_px, seed)[0]).lateral_px for seed in range(3)]
    assert np.mean(found) == pytest.approx(lateral_px, rel=0.25)
    assert noise_of(1 / corner(0.0)[0]).lateral_px < 0.05


@pytest.mark.parametrize(('blur_px', 'low', 'high'), [(0.0, 0.0, 0.1), (2.0, 0.8, 1.0)])
def test_what_neighbours_share_of_the_lateral_noise(blur_px, low, high):
    """The mean of a cell averages the jitter of single pixels away, not that of a window."""
    rng, (v, u) = np.random.default_rng(0), np.mgrid[0:480, 0:640].astype(float)
    for at in (u, v):
        jitter = rng.standard_normal(at.shape)
        if blur_px > 0:
            jitter = cv2.GaussianBlur(jitter, (0, 0), blur_px)
        at += 0.6 * jitter / jitter.std()
    faces = 0.33 + np.stack([0 * u, 0.0012 * (v - 240), 0.003 * (u - 400)])
    noise = noise_of(1 / (faces.max(axis=0) + rng.normal(0, 0.0008, v.shape)))
    assert low <= noise.lateral_shared <= high


def test_a_steep_wall_is_a_plane_although_pixels_see_aside():
    disparity, truth = corner(0.7)
    labels = segment_planes((1 / disparity).astype(np.float32), VGA).labels
    assert np.bincount(labels[(truth == 2) & (labels >= 0)]).max() > 0.9 * (truth == 2).sum()


@pytest.mark.parametrize(('case', 'seed'), [
    ('low stereo', 504), ('filtered', 501), ('filtered', 304), ('filtered', 300),
    ('albedo', 501), ('albedo', 503), ('terraces', 500), ('bowed', 502)])
def test_the_largest_surface_of_a_sensor_stays_one_plane(case, seed):
    scene, depth_m = SENSOR_CASES[case](np.random.default_rng(seed))
    found = segment_planes(depth_m, scene.intrinsics)
    largest = np.bincount(scene.labels[scene.labels >= 0]).argmax()
    names = found.labels[(scene.labels == largest) & np.isfinite(depth_m)]
    assert np.bincount(names[names >= 0]).max() > 0.8 * len(names)


@pytest.mark.parametrize(('blur_px', 'times', 'own_share'), [
    (0.0, 12, 1.0), (0.8, 4, 0.42), (8.0, 40, 0.0)])
def test_noise_is_local_where_a_dark_carpet_has_more(blur_px, times, own_share):
    """Unless neighbours share it; the noise of the image is that of the other half."""
    rng, sigma_m = np.random.default_rng(0), np.full(WALL.depth_m.shape, 0.001)
    sigma_m[240:] *= times
    error = rng.standard_normal(sigma_m.shape)
    if blur_px:
        error = cv2.GaussianBlur(error, (0, 0), blur_px)
    error /= error.std()
    noisy_m = WALL.depth_m + sigma_m * error
    noise = noise_of(noisy_m)
    assert noise.own_share == pytest.approx(own_share, rel=0.1)  # 0: exactly
    assert noise_of(WALL.depth_m + times * 0.001 * error).own_share == 0.0
    if own_share:
        assert noise.pixel_sigma < 0.002 * np.median(1 / WALL.depth_m) ** 2
        labels = segment_planes(noisy_m.astype(np.float32), WALL.intrinsics).labels
        assert (labels[240:] == 0).mean() > 0.9


def test_a_door_that_is_not_yet_apart_is_no_noise():
    """A lived-in room whose largest plane holds more than one surface at first."""
    scene = furnished(203)
    found = segment_planes(noisy_depth(scene, 0.001, 203).astype(np.float32), scene.intrinsics)
    assert found.systematic_noise == 0  # .0036 with all regions at once


def test_what_is_not_yet_apart_is_no_noise():
    pytest.importorskip('skimage', reason='scikit-image holds the motorcycle')
    image = workshop()
    found = segment_planes(image.true_depth_m, image.intrinsics)
    assert found.systematic_noise == 0
    assert found.disparity_noise < 0.002  # .0032 joined tank, seat and shelves to what is behind
