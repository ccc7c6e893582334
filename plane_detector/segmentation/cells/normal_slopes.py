# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Slopes of the disparity from the normals that a network gives in addition to depth.

With the ray (X, Y, 1) of a pixel, the plane n . p + d = 0 is 1/z = -(n_x X + n_y Y + n_z) / d: its
slopes are 1/z times n_x / (n . r) and n_y / (n . r). Each cell has two slopes, that of its depth
and that of its normals. Their noise is estimated from the differences between neighbouring cells,
and the two are averaged, weighted by their variances. Errors common to neighbours do not show in
these differences: the remaining difference between the two, in most of the image, is attributed
to the normals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import MIN_VARIANCE
from plane_detector.types import CameraIntrinsics, Prediction

# derived: the best published normals have a mean error of 10 degrees, most of which is common to
# neighbours. Normals are not assumed more accurate than this. A plane seen at a smaller angle may
# as well face away, so that its normal says nothing.
MIN_NORMAL_ERROR_DEG = 2.0
# Lower bound of the noise of the depth's slopes, per image width and unit of source noise.
# tuned: rooms of seeds 302, 303, 309, 310, normals with smooth errors of 5 and 10 degrees: mean SC
# as without normals at 2, up to .1 less at 8.
DEPTH_SLOPE_PER_NOISE = 2.0


@dataclass(frozen=True)
class NormalMap:
    """Normals of an image."""

    # (H, W, 3) float32: unit normals in the optical frame, pointing to the camera; NaN where
    # invalid
    normals_camera: np.ndarray
    confidence: np.ndarray | None  # (H, W) floating or None: weight of each; None: equal weights
    intrinsics: CameraIntrinsics  # of the image

    @classmethod
    def of(cls, prediction: Prediction, intrinsics: CameraIntrinsics) -> NormalMap | None:
        """Return the normals of a prediction whose disparity has no unknown shift, if any."""
        if prediction.normals_camera is None or prediction.output == 'relative_disparity':
            return None
        return cls(prediction.normals_camera, prediction.normal_confidence, intrinsics)


def with_normals(grid: CellGrid, normals: NormalMap, source_sigma: float) -> CellGrid:
    """
    Return the grid with slopes averaged with those of the normals.

    Parameters
    ----------
    grid : CellGrid
        Of 1/z in any unit, without a shift.
    normals : NormalMap
        Of the same image.
    source_sigma : float
        Noise stated for the source of the depth, in the unit of the disparity.

    Returns
    -------
    CellGrid
        With a new ``slope``, and with ``normal_slope``.

    """
    slope = slopes_of(grid, normals)
    is_usable = grid.usable & np.isfinite(slope).all(axis=1)
    measured = _neighbour_variance(grid, grid.slope, grid.usable)
    of_depth = max(measured, (DEPTH_SLOPE_PER_NOISE * source_sigma) ** 2)
    min_slope = (np.radians(MIN_NORMAL_ERROR_DEG) * grid.mean[:, 2] * grid.width_px
                 / normals.intrinsics.fx)
    of_normals = np.maximum(_neighbour_variance(grid, slope, is_usable) + min_slope**2,
                            _variance((slope - grid.slope)[is_usable]) - measured)
    share = np.where(is_usable, of_depth / np.maximum(of_depth + of_normals, MIN_VARIANCE), 0)
    fused = (1 - share)[:, None] * grid.slope + share[:, None] * np.nan_to_num(slope)
    return replace(grid, slope=fused, normal_slope=slope)


def slopes_of(grid: CellGrid, normals: NormalMap) -> np.ndarray:
    """Return dd/dx and dd/dy (R * C, 2) of each cell by its mean normal, NaN where unknown."""
    camera, width = normals.intrinsics, grid.width_px
    normal = _cell_means(normals, grid)
    height = normals.normals_camera.shape[0]
    ray_x = (grid.mean[:, 0] * width + (width - 1) / 2 - camera.cx) / camera.fx
    ray_y = (grid.mean[:, 1] * width + (height - 1) / 2 - camera.cy) / camera.fy
    cosine = normal[:, 0] * ray_x + normal[:, 1] * ray_y + normal[:, 2]
    with np.errstate(invalid='ignore', divide='ignore'):
        slope = (grid.mean[:, 2:] * width / cosine[:, None]
                 * normal[:, :2] / [camera.fx, camera.fy])
    slope[~(cosine < -np.sin(np.radians(MIN_NORMAL_ERROR_DEG)))] = np.nan
    return slope


def _cell_means(normals: NormalMap, grid: CellGrid) -> np.ndarray:
    """Return the weighted mean normal (R * C, 3) of each cell, NaN where none is valid."""
    weight = 1.0 if normals.confidence is None else np.maximum(normals.confidence, 0)[..., None]
    sums = np.nan_to_num(weight * normals.normals_camera)
    for axis in (0, 1):
        sums = np.add.reduceat(sums, range(0, sums.shape[axis], grid.size_px), axis)
    sums = sums.reshape(-1, 3)
    with np.errstate(invalid='ignore'):
        return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def _neighbour_variance(grid: CellGrid, slope: np.ndarray, is_usable: np.ndarray) -> float:
    """Return the variance of each component of slopes by the differences of neighbours."""
    slope, is_usable = slope.reshape(*grid.shape, 2), is_usable.reshape(grid.shape)
    return _variance(np.concatenate([
        (slope[far] - slope[near])[is_usable[near] & is_usable[far]]
        for near, far in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]))])) / 2


def _variance(vectors: np.ndarray) -> float:
    """Return the variance of each component of vectors (n, 2) by the median square; 0 if none."""
    if not len(vectors):
        return 0.0
    # The median of chi-squared with 2 degrees of freedom is 2 log 2.
    return float(np.median((vectors**2).sum(axis=1)) / (2 * np.log(2)))
