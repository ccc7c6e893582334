# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Slopes of the disparity from the normals that a network gives in addition to depth.

With the ray (X, Y, 1) of a pixel, the plane n . p + d = 0 is 1/z = -(n_x X + n_y Y + n_z) / d: its
slopes are 1/z times n_x / (n . r) and n_y / (n . r). Regions whose slopes by their normals differ
are not merged. The search uses the slopes of the depth alone: averaged with those of real normals
it found worse planes more often than better ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.types import CameraIntrinsics, Prediction

# chosen: the best published normals have a mean error of 10 degrees, most of which is common to
# neighbours. Normals are not assumed more accurate than this. A plane seen at a smaller angle may
# as well face away, so that its normal says nothing.
MIN_NORMAL_ERROR_DEG = 2.0


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
