# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Normals of the depth, as evidence for the axes of the scene."""

from __future__ import annotations

import numpy as np

from plane_detector.types import CameraIntrinsics

# derived: a cell of 16 pixels in an image of 640, about a cell of the segmentation.
CELLS_PER_ROW = 40


def surface_normals(disparity: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Return unit normals (N, 3) of the surface on a grid over the image, away from the camera.

    Parameters
    ----------
    disparity : (H, W) floating
        1/z, not finite or not positive where invalid; these cells have the normal 0.
    intrinsics : CameraIntrinsics

    """
    step = max(1, intrinsics.width // CELLS_PER_ROW)
    inverse = disparity[::step, ::step].astype(float)
    inverse = np.where(inverse > 0, inverse, np.nan)
    x = (np.arange(0, intrinsics.width, step)[1:-1] - intrinsics.cx) / intrinsics.fx
    y = (np.arange(0, intrinsics.height, step)[1:-1] - intrinsics.cy) / intrinsics.fy
    # 1/z = p x + q y + r on a plane with a normal along (p, q, r).
    p = (inverse[1:-1, 2:] - inverse[1:-1, :-2]) * intrinsics.fx / (2 * step)
    q = (inverse[2:, 1:-1] - inverse[:-2, 1:-1]) * intrinsics.fy / (2 * step)
    r = inverse[1:-1, 1:-1] - p * x - q * y[:, None]
    normals = np.stack([p, q, r], axis=-1).reshape(-1, 3)
    return np.nan_to_num(normals / np.linalg.norm(normals, axis=1, keepdims=True))
