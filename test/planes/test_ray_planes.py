# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes of the segmentation as functions of ray slopes, without a new fit."""

import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.evaluation.labelled_regions import labelled_regions
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.geometry.projection import pixel_rays
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.segmentation.segment import segment, unitless_noise_floor
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(262.5, 250.0, 149.5, 125.5, 320, 240)
SCALE, SHIFT = 0.4, -0.12


def test_the_plane_of_an_exact_wall():
    scene = rooms.single_wall(SMALL, yaw_deg=20.0)
    disparity = ((1 / scene.depth_m - SHIFT) / SCALE).astype(np.float32)
    planes = ray_planes(labelled_regions(disparity, scene.labels), SMALL)
    expected = -scene.planes[0, :3] / scene.planes[0, 3]
    np.testing.assert_allclose(planes.scaled(SCALE, SHIFT)[0], expected, atol=1e-6)
    rays = [ray.mean() for ray in pixel_rays(SMALL)]
    np.testing.assert_allclose(planes.centers[0], rays, atol=1e-6)
    assert planes.pixel_share == pytest.approx(1)


def test_coefficients_are_those_of_the_segmentation():
    scene = rooms.random_room(np.random.default_rng(3), SMALL)
    disparity = (1 / scene.depth_m).astype(np.float32)
    regions = segment(disparity, unitless_noise_floor(disparity), Config())
    planes = ray_planes(regions, SMALL)
    assert len(planes) > 3
    ray_x, ray_y = pixel_rays(SMALL)
    for k, (p, q, r) in zip(planes.labels, planes.coefficients, strict=True):
        a, b, c = regions.coefficients[k]
        v, u = np.argwhere(regions.labels == k)[0]
        own = a * (u - 159.5) / 320 + b * (v - 119.5) / 320 + c
        assert p * ray_x[u] + q * ray_y[v] + r == pytest.approx(own, abs=1e-7)


def test_the_information_covers_the_error_of_the_fit():
    scene = rooms.single_wall(SMALL, yaw_deg=20.0)
    true = -scene.planes[0, :3] / scene.planes[0, 3]
    misfits = []
    for seed in range(12):
        noisy_m = with_disparity_noise(scene.depth_m, 0.004, np.random.default_rng(seed),
                                       correlation_px=6.0)
        planes = ray_planes(labelled_regions(1 / noisy_m, scene.labels), SMALL)
        error = planes.coefficients[0] - true
        misfits.append(error @ planes.information[0] @ error)
    assert 1 < np.mean(misfits) < 9, 'chi-squared of three degrees of freedom, on the average 3'
