# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The floor in a depth image as evidence for a vertical that the lines of the image give.

Where only vertical lines are seen, a leaning ladder or fence gives the same lines as a wall. The
floor of a depth network is independent of them.
"""

from __future__ import annotations

import numpy as np

from plane_detector.types import CameraIntrinsics

# derived: a cell of 16 pixels in an image of 640, about a cell of the segmentation.
CELLS_PER_ROW = 40
# Share of the image whose surface is perpendicular to the vertical within this angle.
# tuned: fastdepth on frames of a Kinect, NYU and a living room: 0.07 to 0.19 in the 8 frames in
# which the network sees the floor, at most 0.04 for directions 15 and 25 degrees off.
MIN_FLOOR_SHARE, FLOOR_DEG = 0.06, 8.0


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


def shows_floor(normals: np.ndarray, down: np.ndarray) -> bool:
    """Return whether enough of the surface with normals (N, 3) is horizontal, seen from above."""
    return bool(np.mean(normals @ down > np.cos(np.radians(FLOOR_DEG))) >= MIN_FLOOR_SHARE)
