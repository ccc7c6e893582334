# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How far planes are from measured depth of the same picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import LinearRegression, RANSACRegressor

from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

_REFITS = 3
_FEWEST_PIXELS = 100


@dataclass(frozen=True)
class PlaneError:
    """
    One plane against the measured points of its pixels.

    Attributes
    ----------
    label : int
        Of the plane.
    pixels : int
        With measured depth.
    distance_m : float
        Median distance of the measured points from the plane.
    normal_deg, offset_m : float
        Against the best plane through the measured points.
    purity : float
        Share of the measured points within max(3 cm, 1.5 % of z) of that best plane: 1 where
        the pixels really are one plane.

    """

    label: int
    pixels: int
    distance_m: float
    normal_deg: float
    offset_m: float
    purity: float


def plane_errors(planes: np.ndarray, labels: np.ndarray, true_depth_m: np.ndarray,
                 intrinsics: CameraIntrinsics) -> list[PlaneError]:
    """
    Compare planes with measured depth.

    Parameters
    ----------
    planes : (N,) structured
        Fields of ``~/planes``: label, normal_x, normal_y, normal_z, d.
    labels : (H, W) integer
        Label of each pixel.
    true_depth_m : (H, W) floating
        NaN where it is not known.
    intrinsics : CameraIntrinsics

    Returns
    -------
    list of PlaneError
        Planes with fewer than 100 measured pixels are left out.

    """
    points_m = depth_to_points(true_depth_m, intrinsics)
    measured = np.isfinite(points_m[..., 2])
    errors = []
    for plane in planes:
        members_m = points_m[measured & (labels == plane['label'])].astype(np.float64)
        if len(members_m) >= _FEWEST_PIXELS:
            errors.append(_plane_error(plane, members_m))
    return errors


def depth_error(depth_m: np.ndarray, true_depth_m: np.ndarray) -> tuple[float, float]:
    """Return the mean relative error of the depth (AbsRel) and the median ratio to the truth."""
    both = (depth_m > 0) & (true_depth_m > 0)
    if not both.any():
        return np.nan, np.nan
    ratio = depth_m[both] / true_depth_m[both]
    return float(np.abs(ratio - 1).mean()), float(np.median(ratio))


def _plane_error(plane: np.void, points_m: np.ndarray) -> PlaneError:
    normal = np.array([plane['normal_x'], plane['normal_y'], plane['normal_z']], np.float64)
    offset_m = float(plane['d'])
    best_normal, best_offset_m, near = _best_plane(points_m)
    return PlaneError(
        int(plane['label']), len(points_m),
        float(np.median(np.abs(points_m @ normal + offset_m))),
        float(np.degrees(np.arccos(np.clip(normal @ best_normal, -1, 1)))),
        abs(offset_m - best_offset_m), float(near.mean()))


def _best_plane(points_m: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Return normal, offset and which points are near: RANSAC, then least squares."""
    limit_m = np.maximum(0.03, 0.015 * points_m[:, 2])
    near = _ransac_inliers(points_m, limit_m)
    for _ in range(_REFITS):
        centre_m = points_m[near].mean(axis=0)
        normal = np.linalg.eigh(np.cov((points_m[near] - centre_m).T))[1][:, 0]
        normal = -normal if normal @ centre_m > 0 else normal
        near = np.abs((points_m - centre_m) @ normal) <= limit_m
    return normal, float(-normal @ centre_m), near


def _ransac_inliers(points_m: np.ndarray, limit_m: np.ndarray) -> np.ndarray:
    """
    Return which points are within their limit of the plane that has the most of them.

    In disparity, where a plane is linear however it lies: 1/z = a x/z + b y/z + c; the rows are
    weighed so that the limit along the ray is 1 for all.
    """
    z_m = points_m[:, 2:]
    weight = z_m**2 / limit_m[:, None]
    rays = points_m / z_m
    ransac = RANSACRegressor(LinearRegression(fit_intercept=False), min_samples=3,
                             residual_threshold=1.0, random_state=0)
    return ransac.fit(weight * rays, (weight / z_m)[:, 0]).inlier_mask_
