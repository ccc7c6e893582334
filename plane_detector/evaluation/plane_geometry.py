# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion from planes to depth, and from labelled depth to planes."""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

MIN_POINTS = 3


def plane_depth(labels: np.ndarray, planes: np.ndarray,
                intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the depth (H, W) at which each pixel's ray meets its plane, NaN without a plane."""
    if not len(planes):
        return np.full(labels.shape, np.nan)
    x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height)[:, None] - intrinsics.cy) / intrinsics.fy
    a, b, c, d = np.moveaxis(planes[labels], -1, 0)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(labels >= 0, -d / (a * x + b * y + c), np.nan)


def fit_planes(labels: np.ndarray, depth_m: np.ndarray,
               intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Fit a plane to the points of each label by total least squares.

    Parameters
    ----------
    labels : (H, W) int
        0..K-1, or -1 for none.
    depth_m : (H, W) floating
        NaN where invalid.
    intrinsics : CameraIntrinsics

    Returns
    -------
    (K, 4) float64
        Unit normal pointing to the camera and offset in metres; NaN for labels with fewer than
        MIN_POINTS valid points.

    """
    points_m = depth_to_points(depth_m, intrinsics)
    seen = np.isfinite(points_m[..., 2])
    planes = np.full((int(labels.max(initial=-1)) + 1, 4), np.nan)
    for k in range(len(planes)):
        on_plane_m = points_m[seen & (labels == k)].astype(float)
        if len(on_plane_m) >= MIN_POINTS:
            centroid_m = on_plane_m.mean(axis=0)
            centred_m = on_plane_m - centroid_m
            normal = np.linalg.eigh(centred_m.T @ centred_m)[1][:, 0]
            plane = np.append(normal, -normal @ centroid_m)
            planes[k] = plane if plane[3] >= 0 else -plane
    return planes
