# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The planes of an image as affine functions of a disparity of unknown scale and shift.

With the ray (x, y, 1) of a pixel, a plane is D = p x + q y + r in any disparity that is affine
in 1/z. If 1/z = scale * (D + tau), its normal is proportional to (p, q, r + tau): the angles
between planes depend only on tau, the shift in units of D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.geometry.projection import pixel_rays
from plane_detector.types import CameraIntrinsics

# More pixels than these only cost time: the noise of disparity is smooth over the image.
MAX_SAMPLES = 80_000
MIN_SAMPLES = 30
# Errors of a depth map are uncorrelated beyond this share of the image width.
CORRELATION_SHARE = 1.0 / 20.0
REJECTION_SIGMAS = 2.5


@dataclass(frozen=True)
class DisparityPlanes:
    """
    The planes fitted to the pixels of each label.

    Attributes
    ----------
    coefficients : (N, 3) float64
        p, q, r of D = p x + q y + r with x, y the slopes of the pixel's ray.
    information : (N, 3, 3) float64
        Inverse covariance of the coefficients.
    centers : (N, 2) float64
        Mean ray slopes x, y of the pixels.
    pixel_share : (N,) float64
        Share of the pixels of all these planes.
    labels : (N,) int64
        Label of each plane.

    """

    coefficients: np.ndarray
    information: np.ndarray
    centers: np.ndarray
    pixel_share: np.ndarray
    labels: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the coefficients, (N, 3, 3)."""
        return np.linalg.inv(self.information)

    def scaled(self, scale: float, shift: float) -> np.ndarray:
        """
        Return the coefficients (N, 3) of 1/z = scale * D + shift.

        The plane n . p + d = 0 has the coefficients -n / d.
        """
        return scale * self.coefficients + [0.0, 0.0, shift]

    def take(self, index: np.ndarray) -> DisparityPlanes:
        """Return the chosen planes, in the order of the index."""
        return DisparityPlanes(self.coefficients[index], self.information[index],
                               self.centers[index], self.pixel_share[index], self.labels[index])


def fit_disparity_planes(disparity: np.ndarray, labels: np.ndarray,
                         intrinsics: CameraIntrinsics) -> DisparityPlanes:
    """
    Fit the pixels of each label by least squares, then twice more without outliers.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/z, in any unit; not finite where invalid.
    labels : (H, W) int
        -1 for no plane.
    intrinsics : CameraIntrinsics

    Returns
    -------
    DisparityPlanes
        Without the labels that have too few pixels, or pixels on one line only.

    """
    step = int(np.ceil(np.sqrt(disparity.size / MAX_SAMPLES)))
    ray_x, ray_y = pixel_rays(intrinsics)
    grid_x, grid_y = np.meshgrid(ray_x[::step], ray_y[::step])
    disparity, labels = disparity[::step, ::step], labels[::step, ::step]
    used = (labels >= 0) & np.isfinite(disparity)
    rays = np.stack([grid_x[used], grid_y[used], np.ones(used.sum())], axis=1, dtype=np.float64)
    values, label = disparity[used].astype(np.float64), labels[used].astype(np.int64)
    keep = np.ones(len(label), bool)
    for _ in range(3):
        moments, coefficients, variance = _least_squares(rays[keep], values[keep], label[keep])
        residual = np.abs(values - (rays * coefficients[label]).sum(1))
        keep = residual <= REJECTION_SIGMAS * np.sqrt(variance[label]) + 1e-12
    return _usable_planes(moments, coefficients, variance,
                          (CORRELATION_SHARE * intrinsics.width / step) ** 2)


def _least_squares(rays: np.ndarray, values: np.ndarray, label: np.ndarray):
    """Return the moments (L, 3, 3), coefficients (L, 3) and residual variance (L,) per label."""
    count = int(label.max(initial=-1)) + 1
    moments, projections = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for i in range(3):
        projections[:, i] = np.bincount(label, rays[:, i] * values, count)
        for j in range(i, 3):
            moments[:, i, j] = moments[:, j, i] = np.bincount(
                label, rays[:, i] * rays[:, j], count)
    ridge = 1e-12 * np.eye(3) * (1.0 + moments[:, 2, 2])[:, None, None]
    coefficients = np.linalg.solve(moments + ridge, projections[..., None])[..., 0]
    squares = np.bincount(label, (values - (rays * coefficients[label]).sum(1)) ** 2, count)
    return moments, coefficients, squares / np.maximum(moments[:, 2, 2] - 3.0, 1.0)


def _usable_planes(moments: np.ndarray, coefficients: np.ndarray, variance: np.ndarray,
                   correlated_samples: float) -> DisparityPlanes:
    count = moments[:, 2, 2]
    flat = np.linalg.eigvalsh(moments)[:, 0] > 1e-6 * count if len(count) else count > 0
    kept = np.flatnonzero((count >= MIN_SAMPLES) & flat)
    count, moments = count[kept], moments[kept]
    noise = np.maximum(variance[kept], 1e-12 * (coefficients[kept] ** 2).sum(1) + 1e-30)
    information = moments / (noise * max(correlated_samples, 1.0))[:, None, None]
    return DisparityPlanes(coefficients[kept], information, moments[:, :2, 2] / count[:, None],
                           count / max(count.sum(), 1.0), kept)
