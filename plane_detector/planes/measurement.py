# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels to planes in metres: normal, offset, extent, and how sure they are.

With X = (u - cx) / fx and Y = (v - cy) / fy a plane is 1/z = A X + B Y + C, so its normal is
-(A, B, C) / |(A, B, C)| and its distance from the camera 1 / |(A, B, C)|.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.labels import (
    TINY_DISPARITY,
    count_labels,
    relabel_sequential,
    relative_squares,
)
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.cells.plane_fit import pseudo_inverse
from plane_detector.types import CameraIntrinsics, Plane

# Smooth noise is shared by about this many neighbouring cells.
CORRELATED_CELLS = 9.0
# Structure all over the image looks like noise. Above this share of the typical disparity it is
# not noise, and regions that fit so loosely are rejected.
MAX_NOISE_SHARE = 0.125
# Below this the normal counts as exact.
LEAST_TILT_RAD = 1e-4
CONFIDENCE_WEIGHTS = (1.47, 0.56, -0.48)
# Eigenvalues below this share of the largest are rounding errors.
LEAST_EIGENVALUE = 1e-15


@dataclass(frozen=True)
class _PixelShares:
    """
    Sparse counts of the pixels of each plane in each cell.

    Attributes
    ----------
    counts : (R * C, K) float64
        Number in the whole image.
    cell, plane : (n,) int
        Cells and planes with pixels.
    count : (n,) float64
        Number of pixels in each.

    """

    counts: np.ndarray
    cell: np.ndarray
    plane: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, counts: np.ndarray) -> _PixelShares:
        """Find the cells that contain pixels of planes."""
        where = np.flatnonzero(counts > 0)
        return cls(counts, *np.divmod(where, max(counts.shape[1], 1)), counts.ravel()[where])

    def total(self, values: np.ndarray | float) -> np.ndarray:
        """Add up values (n,) over the pixels of each plane, (K,)."""
        return np.bincount(self.plane, self.count * values, self.counts.shape[1])


def measure_planes(regions: PixelRegions, intrinsics: CameraIntrinsics,
                   min_pixels: float = 1.0) -> tuple[tuple[Plane, ...], np.ndarray]:
    """
    Measure planes, largest first.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z: in 1/metres, or the planes are in the unit whose inverse the disparity has.
    intrinsics : CameraIntrinsics
    min_pixels : float
        Planes with fewer pixels, or without pixels, are dropped.

    Returns
    -------
    planes : tuple of Plane
    labels : (H, W) int32
        Index into these, -1 none.

    """
    grid, noise = regions.grid, regions.noise
    counts = count_labels(grid, regions.labels, len(regions.coefficients))
    total = np.ones(len(counts)) @ counts
    kept = total >= max(min_pixels, 1)
    if noise.mean_sigma > max(noise.source_sigma, MAX_NOISE_SHARE * grid.typical_disparity):
        kept[:] = False
    order = np.argsort(-total, kind='stable')
    order = order[kept[order]]
    labels = relabel_sequential(regions.labels, order, len(regions.coefficients))
    planes, parts = regions.coefficients[order], _PixelShares.of(counts[:, order])
    square = relative_squares(grid, regions.disparity, labels, planes)
    rms = np.sqrt(square / np.maximum(parts.total(1.0), 1))
    return _measure(grid, parts, planes, rms, noise, intrinsics), labels


def _measure(grid: CellGrid, parts: _PixelShares, planes: np.ndarray, relative_rms: np.ndarray,
             noise: Noise, intrinsics: CameraIntrinsics) -> tuple[Plane, ...]:
    """Measure planes (K, 3) from the number of their pixels in each cell."""
    jacobian = ray_plane_jacobian(intrinsics)
    ray_planes = planes @ jacobian.T
    length = np.linalg.norm(ray_planes, axis=1)
    normals, offsets_m = -ray_planes / length[:, None], 1 / length
    ray_x, ray_y = (ray[parts.cell] for ray in _cell_rays(grid, intrinsics))
    a, b, c = ray_planes.T.take(parts.plane, axis=1)
    depth_m = 1 / np.maximum(a * ray_x + b * ray_y + c, TINY_DISPARITY)
    pixels = parts.total(1.0)
    centroids_m = np.stack([parts.total(depth_m * ray_x), parts.total(depth_m * ray_y),
                            parts.total(depth_m)], axis=1) / pixels[:, None]
    centroids_m -= ((normals * centroids_m).sum(axis=1) + offsets_m)[:, None] * normals
    areas_m2 = parts.total(depth_m**3) / (intrinsics.fx * intrinsics.fy * offsets_m)
    rms_m = offsets_m * relative_rms
    covariances = _covariances(grid, parts.counts, noise, ray_planes, jacobian)
    sure = confidence(pixels / (intrinsics.width * intrinsics.height), covariances)
    return tuple(
        Plane(normals[k], float(offsets_m[k]), centroids_m[k], int(pixels[k]), float(rms_m[k]),
              float(areas_m2[k]), covariances[k], float(sure[k]))
        for k in range(len(planes)))


def confidence(share: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """
    Return the probability (K,) that each plane is one of the scene.

    Logistic in the logarithms of its share of the image and of the standard deviation of its
    normal, fitted to whether planes of rendered rooms, of boxes and lived in, match a true one:
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
                     np.log(np.maximum(deviation_rad, LEAST_TILT_RAD))], axis=1)


def ray_plane_jacobian(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the matrix (3, 3) that takes (a, b, c) to (A, B, C)."""
    width, height = intrinsics.width, intrinsics.height
    return np.array([
        [intrinsics.fx / width, 0, 0], [0, intrinsics.fy / width, 0],
        [(intrinsics.cx - (width - 1) / 2) / width, (intrinsics.cy - (height - 1) / 2) / width,
         1]])


def _cell_rays(grid: CellGrid, intrinsics: CameraIntrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Return X and Y at the mean of each cell's valid pixels, (R * C,) each."""
    u_px = grid.mean[:, 0] * intrinsics.width + (intrinsics.width - 1) / 2
    v_px = grid.mean[:, 1] * intrinsics.width + (intrinsics.height - 1) / 2
    return ((u_px - intrinsics.cx) / intrinsics.fx, (v_px - intrinsics.cy) / intrinsics.fy)


def _covariances(grid: CellGrid, counts: np.ndarray, noise: Noise, ray_planes: np.ndarray,
                 jacobian: np.ndarray) -> np.ndarray:
    """Propagate the noise through the fits to (normal, offset), (K, 4, 4)."""
    share = counts / np.maximum(grid.moments[:, cells.N:cells.N + 1], 1)
    m = (share.T @ grid.moments).T
    normal_matrix = np.array([[m[cells.XX], m[cells.XY], m[cells.X]],
                              [m[cells.XY], m[cells.YY], m[cells.Y]],
                              [m[cells.X], m[cells.Y], m[cells.N]]]).transpose(2, 0, 1)
    variance = (noise.pixel_sigma**2 + noise.variance_floor(m[cells.D] / m[cells.N])
                + CORRELATED_CELLS * grid.size_px**2 * noise.mean_sigma**2)
    fit = variance[:, None, None] * pseudo_inverse(normal_matrix, LEAST_EIGENVALUE)
    length = np.linalg.norm(ray_planes, axis=1)[:, None, None]
    unit = ray_planes[:, :, None] / length
    to_normal = (unit * unit.transpose(0, 2, 1) - np.eye(3)) / length
    to_offset = -unit.transpose(0, 2, 1) / length**2
    chain = np.concatenate([to_normal, to_offset], axis=1) @ jacobian
    return chain @ fit @ chain.transpose(0, 2, 1)
