# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A room seen by a relative network, and what is known of its scale."""

import numpy as np
from labelled_regions import labelled_regions

from plane_detector.config import ScaleConfig
from plane_detector.evaluation.scenes import rooms as scenes
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.scale.methods import ScaleEvidence, estimate_scale
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
SCALE, SHIFT = 0.4, -0.12  # 1/z = SCALE * D + SHIFT


def relative_disparity(depth_m, noise=0.0, seed=0):
    if noise:
        depth_m = with_disparity_noise(depth_m, noise, np.random.default_rng(seed),
                                       correlation_px=6.0)
    return ((1.0 / depth_m - SHIFT) / SCALE).astype(np.float32)


def room(seed=3):
    """Return a furnished room with a visible floor."""
    return scenes.random_room(np.random.default_rng(seed), SMALL)


def evidence(scene, disparity, **known):
    regions = labelled_regions(disparity, scene.labels)
    return ScaleEvidence(disparity, lambda: ray_planes(regions, scene.intrinsics), **known)


def estimate(scene, noise=0.0, known=None, **settings):
    """Return the scale by the true labels and what else is known, as of ScaleEvidence."""
    disparity = relative_disparity(scene.depth_m, noise)
    return estimate_scale(evidence(scene, disparity, **(known or {})), ScaleConfig(**settings))


def sparse(depth_m, count, wrong_share=0.0, seed=1):
    rng = np.random.default_rng(seed)
    index = rng.choice(np.flatnonzero(np.isfinite(depth_m)), count, replace=False)
    points_m = np.full(depth_m.shape, np.nan, np.float32)
    points_m.flat[index] = depth_m.flat[index]
    points_m.flat[index[:int(wrong_share * count)]] = 0.7
    return points_m
