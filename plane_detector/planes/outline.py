# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The outline of a plane's pixels, laid onto the plane."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.types import CameraIntrinsics, Plane

_TOLERANCE_PX = 2.0


def plane_outline(mask: np.ndarray, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                  plane: Plane) -> np.ndarray:
    """
    Return the outline of the largest connected patch, its holes filled.

    The border is followed in the picture and simplified there to 2 pixels (Douglas and Peucker);
    then the points of its corners are brought onto the plane along the normal. Unlike a convex
    hull it keeps an L-shaped floor L-shaped.

    Parameters
    ----------
    mask : (H, W) bool
        The plane's pixels, at least one; their depth is valid.
    depth_m : (H, W) float32
        Depth.
    intrinsics : CameraIntrinsics
        Of the picture.
    plane : Plane
        Where the outline is laid.

    Returns
    -------
    (N, 3) float64
        Corners in order, metres, on the plane; the first one is not repeated.

    """
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL,
                                   cv2.CHAIN_APPROX_SIMPLE)
    largest = max(outlines, key=lambda outline: (cv2.contourArea(outline), len(outline)))
    column, row = cv2.approxPolyDP(largest, _TOLERANCE_PX, True).reshape(-1, 2).T
    z_m = depth_m[row, column].astype(float)
    points_m = np.stack([(column - intrinsics.cx) / intrinsics.fx * z_m,
                         (row - intrinsics.cy) / intrinsics.fy * z_m, z_m], axis=-1)
    return points_m - np.outer(points_m @ plane.normal + plane.offset_m, plane.normal)
