# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth images whose resolution differs from that of their image."""

from __future__ import annotations

import cv2
import numpy as np

_SAME_SURFACE = 0.02


def resize_depth(depth_m: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """
    Resize a depth image without creating depths between foreground and background.

    Between pixels of one surface 1/depth is interpolated, in which planes are linear. Where the
    result differs from the depth of the nearest pixel by more than 2 %, there is an edge, and the
    depth of the nearest pixel is used.

    Parameters
    ----------
    depth_m : (h, w) float32
        Metres, NaN invalid, with the field of view of the image.
    size : (int, int)
        Width and height of the result.

    Returns
    -------
    (H, W) float32
        Metres, NaN invalid.

    """
    if size == (depth_m.shape[1], depth_m.shape[0]):
        return depth_m
    nearest_m = cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT)
    smooth_m = 1 / cv2.resize(1 / depth_m, size, interpolation=cv2.INTER_LINEAR)
    is_surface = np.abs(smooth_m - nearest_m) <= _SAME_SURFACE * nearest_m
    return np.where(is_surface, smooth_m, nearest_m)
