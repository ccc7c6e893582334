# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The longest straight line segments of an image, as rays and tangents."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from plane_detector.directions.lsd import find_segments
from plane_detector.types import CameraIntrinsics

# chosen: half of VGA takes a quarter of the time and keeps all useful lines; the line of a
# segment is accurate to a fraction of a pixel of the reduced image.
DETECTION_WIDTH_PX = 320
# Of the reduced image. tuned: python -m plane_detector.evaluation.benchmark orientation, flat from
# 13 to 20; the direction of shorter segments is too inaccurate, whatever the size of the image.
MIN_LENGTH_PX = 16.0
MAX_SEGMENTS = 120
# chosen: the irregular border due to rectification or registration is within a few percent.
BORDER_SHARE = 0.03


@dataclass(frozen=True)
class LineSegments:
    """Segments in the image plane at unit focal length."""

    midpoints: np.ndarray  # (N, 3) float64: rays (x, y, 1) of the midpoints
    tangents: np.ndarray  # (N, 2) float64: unit vectors along the segments
    lengths: np.ndarray  # (N,) float64: in units of the focal length, in descending order
    ends_px: np.ndarray  # (N, 2, 2) float64: start and end as column and row

    def __len__(self) -> int:
        return len(self.lengths)

    @cached_property
    def normals(self) -> np.ndarray:
        """
        Return the normals (N, 3) of the planes through the camera and each segment.

        Their length is such that ``normals @ d`` is the cross product of the tangent with the
        image of the direction d at the midpoint.
        """
        x, y = self.tangents.T
        return np.stack([-y, x, y * self.midpoints[:, 0] - x * self.midpoints[:, 1]], axis=1)

    @cached_property
    def unit_normals(self) -> np.ndarray:
        """Return these normals (N, 3) with length 1."""
        return self.normals / np.linalg.norm(self.normals, axis=1, keepdims=True)


def reduced_grey(rgb: np.ndarray) -> np.ndarray:
    """Return an image (H, W, 3) uint8 as grey (h, w) uint8, at most DETECTION_WIDTH_PX wide."""
    height, width = rgb.shape[:2]
    reduction = max(1.0, width / DETECTION_WIDTH_PX)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    if reduction > 1.0:
        size = round(width / reduction), max(round(height / reduction), 1)
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return grey


def detect_line_segments(grey: np.ndarray, intrinsics: CameraIntrinsics,
                         covered: np.ndarray | None = None) -> LineSegments:
    """
    Find the longest straight segments.

    Parameters
    ----------
    grey : (h, w) uint8
        As of :func:`reduced_grey`, of a rectified image.
    intrinsics : CameraIntrinsics
        Of that image.
    covered : (H, W) bool, optional
        Pixels that the image covers after rectification; segments along their border are dropped.

    Returns
    -------
    LineSegments
        At most 120, none shorter than a twentieth of the width or 16 pixels, none along the
        border of the image.

    """
    width, height = intrinsics.width, intrinsics.height
    reduction = max(1.0, width / DETECTION_WIDTH_PX)
    ends_px = find_segments(grey).reshape(-1, 2, 2)
    # Pixel centres: the middle of pixel 0 of the reduced image is at (reduction - 1) / 2.
    ends_px = (ends_px + 0.5) * [width / grey.shape[1], height / grey.shape[0]] - 0.5
    lengths_px = np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=1)
    kept = (lengths_px >= MIN_LENGTH_PX * reduction) & ~_along_border(ends_px, width, height)
    if covered is not None:
        kept &= _inside(ends_px, covered)
    order = np.flatnonzero(kept)[np.argsort(-lengths_px[kept], kind='stable')][:MAX_SEGMENTS]
    return segments_from_pixels(ends_px[order], intrinsics)


def segments_from_pixels(ends_px: np.ndarray, intrinsics: CameraIntrinsics) -> LineSegments:
    """Return segments from their ends (N, 2, 2), start and end as column and row in pixels."""
    ends = (ends_px - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    along = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    midpoints = np.column_stack([ends.mean(1), np.ones(len(ends))])
    return LineSegments(midpoints, along / lengths[:, None], lengths, ends_px)


def _along_border(ends_px: np.ndarray, width: int, height: int) -> np.ndarray:
    margin = BORDER_SHARE * width
    near = np.concatenate([ends_px < margin, ends_px > [width - 1 - margin, height - 1 - margin]],
                          axis=2)
    return near.all(1).any(1)


def _inside(ends_px: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return the segments with covered pixels around one end or the midpoint, (N,) bool."""
    margin = 2 * round(BORDER_SHARE * covered.shape[1]) + 1
    inner = cv2.erode(covered.astype(np.uint8), np.ones((margin, margin), np.uint8)) > 0
    points = np.concatenate([ends_px, ends_px.mean(1, keepdims=True)], axis=1)
    column, row = np.rint(points).astype(int).transpose(2, 0, 1)
    return inner[row.clip(0, covered.shape[0] - 1), column.clip(0, covered.shape[1] - 1)].any(1)
