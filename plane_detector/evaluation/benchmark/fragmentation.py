# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Cause of fragmentation of large planes: the plane stage, or the depth of the network.

For each large plane in the sensor's depth: the share of its pixels in one predicted plane, and the
share that the best single plane could contain. The best plane is fitted to the depth of the
network in the pixels of the sensor's plane.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plane_detector.types import CameraIntrinsics

# The floor and the large walls.
LARGE_PLANE_SHARE = 0.06
# A pixel is near a plane within this many standard deviations of the network's noise.
NEAR_DEVIATIONS = 3.0
_SAMPLES = 4000
_HYPOTHESES = 500


def held_and_holdable(sensor_labels: np.ndarray, labels: np.ndarray, depth_m: np.ndarray,
                      intrinsics: CameraIntrinsics, noise: float,
                      rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    """
    Yield, for each large plane of the sensor, the share in one plane and the best possible share.

    Parameters
    ----------
    sensor_labels, labels : (H, W) int
        Planes of the sensor's depth, and predicted planes; -1 for none.
    depth_m : (H, W) floating
        The depth in which the predicted planes were found.
    intrinsics : CameraIntrinsics
    noise : float
        Standard deviation of 1/depth, 1/m.
    rng : numpy.random.Generator
        For the hypotheses.

    Yields
    ------
    held, holdable : float
        Shares of the plane's pixels that have depth.

    """
    usable = (sensor_labels >= 0) & np.isfinite(depth_m) & (depth_m > 0)
    pixels = np.bincount(sensor_labels[usable])
    for k in np.flatnonzero(pixels > LARGE_PLANE_SHARE * labels.size):
        there = usable & (sensor_labels == k)
        most = np.bincount(labels[there] + 1, minlength=2)[1:].max()
        v, u = np.nonzero(there)
        rays = np.stack([(u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy,
                         np.ones(len(u))], axis=1)
        near = NEAR_DEVIATIONS * noise
        yield most / pixels[k], _best_share(rays, 1 / depth_m[there].astype(float), near, rng)


def _best_share(rays: np.ndarray, disparity: np.ndarray, near: float,
                rng: np.random.Generator) -> float:
    """Return the largest share of pixels (n,) within ``near`` of one plane."""
    sample = rng.choice(len(rays), min(len(rays), _SAMPLES), replace=False)
    rays, disparity = rays[sample], disparity[sample]
    triples = rng.integers(len(rays), size=(_HYPOTHESES, 3))
    # Three collinear points define no plane; the pseudo-inverse gives a harmless one.
    planes = (np.linalg.pinv(rays[triples]) @ disparity[triples][..., None])[..., 0]
    support = (np.abs(rays @ planes.T - disparity[:, None]) <= near).mean(axis=0)
    inliers = np.abs(rays @ planes[support.argmax()] - disparity) <= near
    refitted = np.linalg.lstsq(rays[inliers], disparity[inliers], rcond=None)[0]
    return float(max(support.max(), (np.abs(rays @ refitted - disparity) <= near).mean()))
