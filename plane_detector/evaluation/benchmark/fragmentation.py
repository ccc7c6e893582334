# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Does a floor break into pieces because of the plane stage, or because of the network's depth?

For each large plane that the sensor measured: the share of its pixels in one predicted plane, and
the share that the best possible single plane would hold. The best plane is fitted to the network's
depth within the sensor's label.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plane_detector.types import CameraIntrinsics

# The floor and the large walls.
LARGE_PLANE_SHARE = 0.06
# A pixel is near a plane within so many deviations of the network's noise.
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
        Planes of the sensor's depth and predicted planes, -1 none.
    depth_m : (H, W) floating
        The depth in which the predicted planes were found.
    intrinsics : CameraIntrinsics
    noise : float
        Of 1/depth, per metre.
    rng : numpy.random.Generator
        Draws the hypotheses.

    Yields
    ------
    held, holdable : float
        Shares of the plane's pixels that have a depth.

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
    """Return the share of some pixels (n,) within ``near`` of the plane that most are near."""
    sample = rng.choice(len(rays), min(len(rays), _SAMPLES), replace=False)
    rays, disparity = rays[sample], disparity[sample]
    triples = rng.integers(len(rays), size=(_HYPOTHESES, 3))
    # Triples in one line have no plane: the pseudo-inverse gives a harmless one.
    planes = (np.linalg.pinv(rays[triples]) @ disparity[triples][..., None])[..., 0]
    support = (np.abs(rays @ planes.T - disparity[:, None]) <= near).mean(axis=0)
    inliers = np.abs(rays @ planes[support.argmax()] - disparity) <= near
    refitted = np.linalg.lstsq(rays[inliers], disparity[inliers], rcond=None)[0]
    return float(max(support.max(), (np.abs(rays @ refitted - disparity) <= near).mean()))
