# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Test whether a direction depends on one line of the image.

A pipe on the floor or the front of a chair shows several long segments, but they are one line:
they prove its own direction, not that of the room. So an answer must remain the best one without
any single line (a jackknife over lines).
"""

from __future__ import annotations

import numpy as np

from plane_detector.directions.line_segments import LineSegments

# Angle between the planes through the camera and two segments of one line, such as the two edges
# of a bar or the pieces of an interrupted edge. derived: about the accuracy of a short segment;
# 14 pixels in an image of 640.
SAME_LINE_DEG = 1.5
ROUNDING = 1e-6


def depends_on_one_line(segments: LineSegments, points: np.ndarray, is_same: np.ndarray) -> bool:
    """
    Return whether without one of the lines another direction is supported at least as well.

    Parameters
    ----------
    segments : LineSegments
    points : (N, C) float64
        Support of each of C directions by each segment.
    is_same : (C,) bool
        Directions that count as the same as the best one; not all.

    """
    own = points[:, is_same].max(1) > 0
    normals = segments.normals / np.linalg.norm(segments.normals, axis=1, keepdims=True)
    is_one_line = np.abs(normals[own] @ normals.T) > np.cos(np.radians(SAME_LINE_DEG))
    without = points.sum(0) - is_one_line.astype(float) @ points
    best = without[:, is_same].max(1)
    return bool((without[:, ~is_same].max(1) >= (1 - ROUNDING) * best).any())
