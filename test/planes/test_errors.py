# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The published errors are those that planes have, for every noise and every lens."""

from functools import lru_cache

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, segment_planes
from plane_detector.evaluation.metrics import overlap
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Rectangle,
    camera_rotation,
    render,
)
from plane_detector.evaluation.scenes.rooms import random_room, single_wall

WIDE, TELE = (CameraIntrinsics(share * 640, share * 640, 319.5, 239.5, 640, 480)
              for share in (0.3, 2.0))
ODD = CameraIntrinsics(420.0, 610.0, 250.0, 300.0, 640, 480)
CAMERAS = VGA, ODD, WIDE, TELE
SIGMA = 0.004
# Of smaller planes a few pixels of their neighbours outweigh the noise.
MIN_PIXELS = 10000


def wall(rng, camera):
    return single_wall(camera, rng.uniform(-35, 35), rng.uniform(2, 4))


def floor(rng, camera):
    side = 1000.0
    ground = Rectangle(np.array([-side / 2, -side / 2, 0]), np.array([side, 0, 0]),
                       np.array([0, side, 0]))
    rotation = camera_rotation(0, rng.uniform(-50, -35), rng.uniform(-5, 5))
    return render([ground], rotation, np.array([0, 0, rng.uniform(1, 2)]), camera, rng)


@lru_cache(maxsize=40)
def scene(make, seed):
    return make(np.random.default_rng(seed), CAMERAS[seed % len(CAMERAS)])


def z_scores(make, seeds, blur_px, sigma=SIGMA, **stated):
    """Return errors (n, 3) of normals, offsets and distances at the centroid, in deviations."""
    scores = []
    for seed in seeds:
        truth, rng = scene(make, seed), np.random.default_rng(seed)
        depth_m = with_disparity_noise(truth.depth_m, sigma, rng, 0.5 if blur_px else 0.0,
                                       max(blur_px, 1))
        found = segment_planes(depth_m, truth.intrinsics, **stated)
        iou = overlap(truth.labels, found.labels, np.isfinite(truth.depth_m)).iou
        for plane, shared in zip(found.planes, iou.T, strict=True):
            if shared.max() > 0.8 and plane.inlier_count > MIN_PIXELS:
                off = truth.planes[shared.argmax()] - [*plane.normal, plane.offset_m]
                centre = np.append(plane.centroid_m, 1.0)
                scores.append((np.sqrt(off[:3] @ off[:3] / np.trace(plane.covariance[:3, :3])),
                               off[3] / np.sqrt(plane.covariance[3, 3]),
                               off @ centre / np.sqrt(centre @ plane.covariance @ centre)))
    return np.array(scores)


@pytest.mark.parametrize('blur_px', [0, 12])
@pytest.mark.parametrize(('make', 'seeds'), [(wall, 24), (floor, 24), (random_room, 12)])
def test_errors_are_those_published(make, seeds, blur_px):
    scores = z_scores(make, range(seeds), blur_px)
    assert len(scores) >= 24
    rms = np.sqrt(np.mean(scores**2, axis=0))
    assert ((rms[:2] > 0.7) & (rms[:2] < 1.4)).all(), rms
    # Normal and offset depend on each other: at the centroid most of both cancels.
    assert 0.5 < rms[2] < 1.8, rms


def test_errors_are_not_below_the_noise_stated_for_a_network():
    """A field with the deviation stated, as smooth as the segmentation takes a network's to be."""
    errors = []
    for seed in range(16):
        truth, rng = scene(wall, seed), np.random.default_rng(seed)
        depth_m = with_disparity_noise(truth.depth_m, SIGMA, rng, 1.0, 640 / 8 / 2**0.5)
        plane = segment_planes(depth_m, truth.intrinsics, disparity_noise=SIGMA).planes[0]
        off = truth.planes[0] - [*plane.normal, plane.offset_m]
        errors.append((off[:3] @ off[:3] / np.trace(plane.covariance[:3, :3]),
                       off[3] ** 2 / plane.covariance[3, 3]))
    rms = np.sqrt(np.mean(errors, axis=0))
    assert ((rms > 0.5) & (rms < 1.4)).all(), rms
