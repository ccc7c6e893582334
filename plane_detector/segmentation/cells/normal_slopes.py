# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Slopes of the disparity from the normals that a network gives in addition to depth.

With the ray (X, Y, 1) of a pixel, the plane n . p + d = 0 is 1/z = -(n_x X + n_y Y + n_z) / d: its
slopes are 1/z times n_x / (n . r) and n_y / (n . r).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.types import CameraIntrinsics, Prediction

# derived: the best published normals have a mean error of 10 degrees, most of which is common to
# neighbours; normals are not assumed more accurate than this, nor planes seen at a smaller angle.
# Exact surfaces that turn by less are planes: errors below the noise floor may be smooth.
# tuned: rooms at noise 0.0001 and curved scenes; 0.16 of the rooms loses its labels at 0.
MIN_ANGLE_DEG = 2.0


@dataclass(frozen=True)
class NormalMap:
    """
    Normals of an image.

    Attributes
    ----------
    normals_camera : (H, W, 3) float32
        Unit normals in the optical frame, pointing to the camera; NaN where invalid.
    confidence : (H, W) floating or None
        Weight of each; None: equal weights.
    intrinsics : CameraIntrinsics
        Of the image.

    """

    normals_camera: np.ndarray
    confidence: np.ndarray | None
    intrinsics: CameraIntrinsics

    @classmethod
    def of(cls, prediction: Prediction, intrinsics: CameraIntrinsics) -> NormalMap | None:
        """Return the normals of a prediction whose disparity has no unknown shift, if any."""
        if prediction.normals_camera is None or prediction.output == 'relative_disparity':
            return None
        return cls(prediction.normals_camera, prediction.normal_confidence, intrinsics)


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
    slope[~(cosine < -np.sin(np.radians(MIN_ANGLE_DEG)))] = np.nan
    return slope


def _cell_means(normals: NormalMap, grid: CellGrid) -> np.ndarray:
    """Return the weighted mean normal (R * C, 3) of each cell, NaN where none is valid."""
    weight = normals.confidence
    if weight is None:
        weight = np.ones(normals.normals_camera.shape[:2], np.float32)
    sums = _sum_up(np.ascontiguousarray(normals.normals_camera, np.float32),
                   np.ascontiguousarray(weight, np.float32), grid.size_px)
    with np.errstate(invalid='ignore'):
        return sums / np.linalg.norm(sums, axis=1, keepdims=True)


@kernel('float64[:, ::1](float32[:, :, ::1], float32[:, ::1], int64)')
def _sum_up(normals, weight, size):
    """Return the weighted sum (R * C, 3) of the valid normals of each cell."""
    height, width = weight.shape
    columns = -(-width // size)
    sums = np.zeros((-(-height // size) * columns, 3))
    for v in range(height):
        for u in range(width):
            x, y, z = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            if np.isfinite(x + y + z) and weight[v, u] > 0:
                cell = v // size * columns + u // size
                sums[cell, 0] += weight[v, u] * x
                sums[cell, 1] += weight[v, u] * y
                sums[cell, 2] += weight[v, u] * z
    return sums
