# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels to planes in metres: normal, offset, extent, covariance and confidence.

With X = (u - cx) / fx and Y = (v - cy) / fy a plane is 1/z = A X + B Y + C. Its normal is
-(A, B, C) / |(A, B, C)|, and its distance from the camera is 1 / |(A, B, C)|.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.planes.pixel_sums import SQUARE, XZ, YZ, ZZZ, Z, sum_over_pixels
from plane_detector.segmentation.cells.columns import XX, XY, YY, D, N, X, Y
from plane_detector.segmentation.cells.labels import relabel_sequential
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.cells.plane_fit import MIN_EIGENVALUE
from plane_detector.types import CameraIntrinsics, Plane

# derived: the columns of measurements: normal (3), centroid (3), offset, rms, area, confidence and
# the covariance (4 x 4) of normal and offset.
CENTROID, OFFSET, RMS, AREA, CONFIDENCE, COVARIANCE = 3, 6, 7, 8, 9, 10
# Number of neighbouring cells with the same smooth noise.
CORRELATED_CELLS = 9.0
# Structure throughout the image resembles noise. Above this share of the typical disparity it is
# not noise, and regions with such residuals are rejected.
MAX_NOISE_SHARE = 0.125
# Normals with a smaller standard deviation count as exact.
MIN_TILT_RAD = 1e-4
# tuned: python3 -m plane_detector.evaluation.benchmark confidence, which fits and checks them.
CONFIDENCE_WEIGHTS = (1.47, 0.56, -0.48)


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
    planes = planes_from_sums(regions, sums[kept], regions.coefficients[kept], intrinsics)
    return planes, labels


def planes_from_sums(regions: PixelRegions, sums: np.ndarray, planes: np.ndarray,
                     intrinsics: CameraIntrinsics) -> tuple[Plane, ...]:
    """Measure planes (K, 3) from the sums (K, 15) over their pixels."""
    noise, camera = regions.noise, intrinsics
    smooth = CORRELATED_CELLS * (regions.grid.size_px * noise.mean_sigma) ** 2
    table = _measured(
        sums, planes, ray_plane_jacobian(camera),
        (noise.pixel_sigma**2 + noise.disparity_floor**2 + smooth, noise.depth_floor_m**2),
        (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height))
    return tuple(
        Plane(normal, offset_m, centroid_m, round(pixels), rms_m, area_m2, covariance, sure)
        for normal, centroid_m, covariance, (offset_m, rms_m, area_m2, sure), pixels in zip(
            table[:, :CENTROID], table[:, CENTROID:OFFSET],
            table[:, COVARIANCE:].reshape(-1, 4, 4), table[:, OFFSET:COVARIANCE].tolist(),
            sums[:, N].tolist(), strict=True))


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, ::1], '
        'UniTuple(float64, 2), UniTuple(float64, 6))', is_short=True)
def _measured(sums, planes, jacobian, variance, camera):
    """
    Return the measurements (K, 26) of planes, in the columns of this module.

    The variance of a pixel is the sum of a constant and a multiple of the fourth power of 1/z.
    """
    fx, fy, cx, cy, width, height = camera
    table, chain, fit = np.zeros((len(sums), 26)), np.empty((4, 3)), np.empty((3, 3))
    for k in range(len(sums)):
        row, pixels, length2 = table[k], sums[k, N], 0.0
        for i in range(3):
            for j in range(3):
                row[i] -= jacobian[i, j] * planes[k, j]
            length2 += row[i] ** 2
        row[OFFSET] = offset_m = 1 / np.sqrt(length2)
        # x is (u - middle) / width, the ray's X is (u - cx) / fx.
        x_z = width * sums[k, XZ] + ((width - 1) / 2 - cx) * sums[k, Z]
        y_z = width * sums[k, YZ] + ((height - 1) / 2 - cy) * sums[k, Z]
        row[CENTROID], row[CENTROID + 1] = x_z / (fx * pixels), y_z / (fy * pixels)
        row[CENTROID + 2], off_plane = sums[k, Z] / pixels, offset_m
        for i in range(3):
            row[i] *= offset_m
            off_plane += row[i] * row[CENTROID + i]
        for i in range(3):
            row[CENTROID + i] -= off_plane * row[i]
        row[RMS] = offset_m * np.sqrt(sums[k, SQUARE] / pixels)
        row[AREA] = sums[k, ZZZ] / (fx * fy * offset_m)
        _invert(sums[k], variance[0] + variance[1] * (sums[k, D] / pixels) ** 4, fit)
        _differentiate(row, jacobian, chain)
        for i in range(16):
            for j in range(9):
                row[COVARIANCE + i] += (chain[i // 4, j // 3] * fit[j // 3, j % 3]
                                        * chain[i % 4, j % 3])
        of_normal = row[COVARIANCE] + row[COVARIANCE + 5] + row[COVARIANCE + 10]
        row[CONFIDENCE] = confidence(pixels / (width * height), np.sqrt(of_normal))
    return table


@kernel('void(float64[::1], float64, float64[:, ::1])')
def _invert(m, variance, fit):
    """Write the covariance (3, 3) of the plane fitted to pixels of moments m and a variance."""
    x, y = m[X] / m[N], m[Y] / m[N]
    xx, xy, yy = m[XX] - m[N] * x * x, m[XY] - m[N] * x * y, m[YY] - m[N] * y * y
    scale = variance / max(xx * yy - xy * xy, MIN_EIGENVALUE * (xx + yy) ** 2)
    fit[0, 0], fit[1, 1] = scale * yy, scale * xx
    fit[0, 1] = fit[1, 0] = -scale * xy
    for i in range(2):
        fit[i, 2] = fit[2, i] = -(fit[i, 0] * x + fit[i, 1] * y)
    fit[2, 2] = variance / m[N] - fit[0, 2] * x - fit[1, 2] * y


@kernel('void(float64[::1], float64[:, ::1], float64[:, ::1])')
def _differentiate(plane, jacobian, chain):
    """Write the derivatives (4, 3) of (normal, offset) by (a, b, c)."""
    offset_m = plane[OFFSET]
    for i in range(4):
        for j in range(3):
            chain[i, j] = 0
            for k in range(3):
                by_ray = (offset_m * plane[k] if i == 3
                          else plane[i] * plane[k] - (1.0 if i == k else 0.0))
                chain[i, j] += offset_m * by_ray * jacobian[k, j]


@kernel('float64(float64, float64)')
def confidence(share, deviation_rad):
    """
    Return the probability that a plane exists in the scene.

    Logistic in the logarithms of its share of the image and of the standard deviation of its
    normal, fitted to whether planes of rendered rooms match a true plane.
    """
    logit = (CONFIDENCE_WEIGHTS[0] + CONFIDENCE_WEIGHTS[1] * np.log(share)
             + CONFIDENCE_WEIGHTS[2] * np.log(max(deviation_rad, MIN_TILT_RAD)))
    return 1 / (1 + np.exp(-logit))


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
