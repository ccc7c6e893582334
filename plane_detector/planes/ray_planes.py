# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes of the segmentation as functions of ray slopes, as needed for the scale.

With (x, y) the coordinates of the cells and (X, Y, 1) the ray of a pixel, D = a x + b y + c equals
D = p X + q Y + r, where (p, q, r) = J (a, b, c) and (x, y, 1) = J^T (X, Y, 1). There is no new
fit: coefficients, moments and noise are those of the segmentation.
"""

from __future__ import annotations

import numpy as np

from plane_detector.planes.measurement import normal_matrices, ray_plane_jacobian
from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.segmentation.cells.grid import D, N, X, Y, squared_error
from plane_detector.segmentation.cells.model import PixelRegions, add_up, count_labels
from plane_detector.types import CameraIntrinsics

# derived: fewer than two cells of 8 x 8 pixels; one cell does not determine angles.
MIN_PIXELS = 100
# Smallest variance of the ray slopes of a plane across its extent; below it the pixels form a
# line.
# derived: two pixels of a camera with a focal length of 600 pixels.
MIN_RAY_VARIANCE = 1e-6
# Distance, as a share of the image width, beyond which errors of a depth map are uncorrelated.
# tuned: `benchmark scale` of a0cf012 on seeds from 1000; the range was not swept.
CORRELATION_SHARE = 1.0 / 20.0


def ray_planes(regions: PixelRegions, intrinsics: CameraIntrinsics) -> DisparityPlanes:
    """
    Return the planes of regions, in any unit, as functions of ray slopes.

    Regions that have too few pixels, or whose pixels are on a line, are left out.
    """
    pixels, moments = _whole_cells(regions)
    jacobian = ray_plane_jacobian(intrinsics)
    to_rays = np.linalg.inv(jacobian).T
    products = to_rays @ normal_matrices(moments.T) @ to_rays.T
    count = np.maximum(moments[:, N], 1)
    width = np.linalg.eigvalsh(products)[:, 0] / count
    kept = np.flatnonzero((pixels >= MIN_PIXELS) & (width > MIN_RAY_VARIANCE))
    correlated_px = max((CORRELATION_SHARE * regions.grid.width_px) ** 2, 1.0)
    variances = _variances(regions, moments)[kept]
    # Border pixels outside whole cells carry the same information per pixel.
    weights = (pixels / count)[kept] / (correlated_px * variances)
    information = products[kept] * weights[:, None, None]
    middle = moments[:, [X, Y, N]] / count[:, None] @ to_rays.T
    return DisparityPlanes(regions.coefficients[kept] @ jacobian.T, information,
                           middle[kept, :2], pixels[kept] / max(pixels[kept].sum(), 1.0), kept)


def _whole_cells(regions: PixelRegions) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (K,) of each region, and the moments (K, 10) of its whole cells."""
    grid, count = regions.grid, len(regions.coefficients)
    if not count:
        return np.zeros(0), np.zeros((0, 10))
    counts = count_labels(grid, regions.labels, count)
    most = counts.argmax(axis=1)
    is_whole = (counts[np.arange(len(most)), most] == grid.moments[:, N]) & grid.usable
    moments = add_up(grid.moments, most.astype(np.int32), is_whole, count)
    return counts.sum(axis=0), moments


def _variances(regions: PixelRegions, moments: np.ndarray) -> np.ndarray:
    """Return the variance (K,) of the pixels about their planes, at least that of the noise."""
    noise, count = regions.noise, np.maximum(moments[:, N], 1)
    floor = (noise.pixel_sigma**2 + noise.mean_sigma**2
             + noise.variance_floor(moments[:, D] / count))
    squares = [squared_error(*plane, own)
               for plane, own in zip(regions.coefficients, moments, strict=True)]
    return np.maximum(squares / count, floor)
