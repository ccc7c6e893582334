# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Drawing of the directions of a scene into its image."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.types import CameraIntrinsics

# Gravity blue, the horizontal axes red and green, the horizon yellow.
_AXIS_COLOURS, _HORIZON = ((40, 90, 255), (255, 50, 50), (40, 200, 60)), (255, 230, 0)
_STROKES_PER_ROW = 12


def draw_directions(rgb: np.ndarray, intrinsics: CameraIntrinsics,
                    gravity_camera: np.ndarray | None, horizontal_axes: np.ndarray) -> np.ndarray:
    """
    Return the image with the horizon and with strokes towards the vanishing points of the axes.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
        The image; it is not changed.
    intrinsics : CameraIntrinsics
        Of the image.
    gravity_camera : (3,) float64 or None
        Unit direction of gravity in the optical frame: blue strokes, and the yellow horizon,
        which is the image of all horizontal directions. None: nothing is drawn.
    horizontal_axes : (A, 3) float64
        Horizontal axes: red and green strokes.

    """
    drawn = rgb.copy()
    if gravity_camera is None:
        return drawn
    thickness_px = max(1, round(rgb.shape[0] / 300))
    ends = _horizon(intrinsics, gravity_camera)
    if ends is not None:
        cv2.line(drawn, *ends, _HORIZON, thickness_px + 1, cv2.LINE_AA)
    for direction, colour in zip((gravity_camera, *horizontal_axes), _AXIS_COLOURS, strict=False):
        for start, end in _strokes(intrinsics, direction):
            cv2.line(drawn, start, end, colour, thickness_px, cv2.LINE_AA)
    return drawn


def _horizon(intrinsics: CameraIntrinsics,
             down: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Return two points of the horizon outside the image, in pixels; None if it is too far."""
    # The rays (u, v) of down . ((u - cx) / fx, (v - cy) / fy, 1) = 0 in pixels.
    a, b = down[0] / intrinsics.fx, down[1] / intrinsics.fy
    if np.hypot(a, b) * intrinsics.width < 1e-6:
        return None
    c = down[2] - a * intrinsics.cx - b * intrinsics.cy
    nearest = -c * np.array([a, b]) / (a * a + b * b)
    along = 2 * (intrinsics.width + intrinsics.height) * np.array([-b, a]) / np.hypot(a, b)
    if np.abs(nearest).max() > 1e6:
        return None
    start, end = np.rint([nearest - along, nearest + along]).astype(int).tolist()
    return tuple(start), tuple(end)


def _strokes(intrinsics: CameraIntrinsics, direction: np.ndarray):
    """Yield start and end, in pixels, of strokes on a grid, directed at the vanishing point."""
    spacing = intrinsics.width / _STROKES_PER_ROW
    length = 0.4 * spacing
    for v in np.arange(spacing / 2, intrinsics.height, spacing):
        for u in np.arange(spacing / 2, intrinsics.width, spacing):
            x, y = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
            along = np.array([intrinsics.fx * (direction[0] - x * direction[2]),
                              intrinsics.fy * (direction[1] - y * direction[2])])
            size = np.linalg.norm(along)
            if size > 1e-6 * intrinsics.fx:
                half = along / size * length / 2
                yield tuple(np.rint([u - half[0], v - half[1]]).astype(int).tolist()), tuple(
                    np.rint([u + half[0], v + half[1]]).astype(int).tolist())
