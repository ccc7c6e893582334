# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels to planes in metres: normal, offset, extent, covariance and confidence.

With X = (u - cx) / fx and Y = (v - cy) / fy a plane is 1/z = A X + B Y + C. Its normal is
-(A, B, C) / |(A, B, C)|, and its distance from the camera is 1 / |(A, B, C)|.
"""

from __future__ import annotations

import numpy as np

from plane_detector.planes.pixel_sums import sum_over_pixels
from plane_detector.segmentation.cells.grid import XX, XY, YY, CellGrid, D, N, X, Y
from plane_detector.segmentation.cells.labels import relabel_sequential
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.cells.plane_fit import pseudo_inverse
from plane_detector.types import CameraIntrinsics, Plane

# Number of neighbouring cells with the same smooth noise.
CORRELATED_CELLS = 9.0
# Structure throughout the image resembles noise. Above this share of the typical disparity it is
# not noise, and regions with such residuals are rejected.
MAX_NOISE_SHARE = 0.125
# Normals with a smaller standard deviation count as exact.
MIN_TILT_RAD = 1e-4
CONFIDENCE_WEIGHTS = (1.47, 0.56, -0.48)
# Smaller eigenvalues, relative to the largest, are rounding errors.
MIN_EIGENVALUE = 1e-15


def measure_planes(regions: PixelRegions, intrinsics: CameraIntrinsics,
                   min_pixels: float = 1.0) -> tuple[tuple[Plane, ...], np.ndarray]:
    """
    Measure planes, largest first.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in 1/metres; in another unit, the planes are in its inverse.
    intrinsics : CameraIntrinsics
    min_pixels : float
        Planes with fewer pixels, or without pixels, are dropped.

    Returns
    -------
    planes : tuple of Plane
    labels : (H, W) int32
        Index into these, -1 none.

    """
    noise, typical = regions.noise, regions.grid.typical_disparity
    sums = sum_over_pixels(regions)
    is_kept = sums[:, N] >= max(min_pixels, 1)
    if noise.mean_sigma > max(noise.source_sigma, MAX_NOISE_SHARE * typical):
        is_kept[:] = False
    kept = np.argsort(-sums[:, N], kind='stable')
    kept = kept[is_kept[kept]]
    labels = relabel_sequential(regions.labels, kept, len(sums))
    return _measure(regions, sums[kept], regions.coefficients[kept], intrinsics), labels


def _measure(regions: PixelRegions, sums: np.ndarray, planes: np.ndarray,
             intrinsics: CameraIntrinsics) -> tuple[Plane, ...]:
    """Measure planes (K, 3) from the sums (K, 15) over their pixels."""
    jacobian = ray_plane_jacobian(intrinsics)
    ray_planes = planes @ jacobian.T
    length = np.linalg.norm(ray_planes, axis=1)
    normals, offsets_m = -ray_planes / length[:, None], 1 / length
    pixels, (depth_x, depth_y, depth_m, cubed_m3, square) = sums[:, N], sums[:, 10:].T
    # x is (u - middle) / width, the ray's X is (u - cx) / fx.
    width, height = intrinsics.width, intrinsics.height
    centroids_m = np.stack([
        (width * depth_x + ((width - 1) / 2 - intrinsics.cx) * depth_m) / intrinsics.fx,
        (width * depth_y + ((height - 1) / 2 - intrinsics.cy) * depth_m) / intrinsics.fy,
        depth_m], axis=1) / pixels[:, None]
    centroids_m -= ((normals * centroids_m).sum(axis=1) + offsets_m)[:, None] * normals
    areas_m2 = cubed_m3 / (intrinsics.fx * intrinsics.fy * offsets_m)
    rms_m = offsets_m * np.sqrt(square / pixels)
    covariances = _covariances(regions.grid, sums.T, regions.noise, ray_planes, jacobian)
    sure = confidence(pixels / (width * height), covariances)
    return tuple(
        Plane(normals[k], float(offsets_m[k]), centroids_m[k], int(round(pixels[k])),
              float(rms_m[k]), float(areas_m2[k]), covariances[k], float(sure[k]))
        for k in range(len(planes)))


def confidence(share: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """
    Return the probability (K,) that each plane exists in the scene.

    Logistic in the logarithms of its share of the image and of the standard deviation of its
    normal, fitted to whether planes of rendered rooms match a true plane:
    ``python3 -m plane_detector.evaluation.benchmark confidence`` fits and checks it.

    Parameters
    ----------
    share : (K,) float64
        Of the image's pixels.
    covariance : (K, 4, 4) float64
        Of (normal, offset).

    """
    features = confidence_features(share, covariance)
    return 1 / (1 + np.exp(-features @ np.array(CONFIDENCE_WEIGHTS)))


def confidence_features(share: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return 1 and the logarithms of share and of the normal's deviation in radians, (K, 3)."""
    deviation_rad = np.sqrt(np.einsum('kii->k', covariance[:, :3, :3]))
    return np.stack([np.ones(len(share)), np.log(np.maximum(share, 1e-9)),
                     np.log(np.maximum(deviation_rad, MIN_TILT_RAD))], axis=1)


def ray_plane_jacobian(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the matrix (3, 3) that maps (a, b, c) to (A, B, C)."""
    width, height = intrinsics.width, intrinsics.height
    return np.array([
        [intrinsics.fx / width, 0, 0], [0, intrinsics.fy / width, 0],
        [(intrinsics.cx - (width - 1) / 2) / width, (intrinsics.cy - (height - 1) / 2) / width,
         1]])


def normal_matrices(m: np.ndarray) -> np.ndarray:
    """Return the sums of the products of x, y and 1, (K, 3, 3), of moments m (10, K)."""
    return np.array([[m[XX], m[XY], m[X]], [m[XY], m[YY], m[Y]],
                     [m[X], m[Y], m[N]]]).transpose(2, 0, 1)


def _covariances(grid: CellGrid, m: np.ndarray, noise: Noise, ray_planes: np.ndarray,
                 jacobian: np.ndarray) -> np.ndarray:
    """Propagate the noise of fits with moments m to (normal, offset), (K, 4, 4)."""
    variance = (noise.pixel_sigma**2 + noise.variance_floor(m[D] / m[N])
                + CORRELATED_CELLS * grid.size_px**2 * noise.mean_sigma**2)
    fit = variance[:, None, None] * pseudo_inverse(normal_matrices(m), MIN_EIGENVALUE)
    length = np.linalg.norm(ray_planes, axis=1)[:, None, None]
    unit = ray_planes[:, :, None] / length
    to_normal = (unit * unit.transpose(0, 2, 1) - np.eye(3)) / length
    to_offset = -unit.transpose(0, 2, 1) / length**2
    chain = np.concatenate([to_normal, to_offset], axis=1) @ jacobian
    return chain @ fit @ chain.transpose(0, 2, 1)
