# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Lines and directions of one image after another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.directions.line_segments import LineSegments, detect_line_segments
from plane_detector.directions.vanishing import SceneDirections, find_directions
from plane_detector.types import CameraIntrinsics


@dataclass(frozen=True)
class ImageDirections:
    """The lines of an image and what they say."""

    segments: LineSegments
    directions: SceneDirections


def find_in_image(rgb: np.ndarray, intrinsics: CameraIntrinsics, rng: np.random.Generator,
                  coarse_down: np.ndarray | None = None,
                  covered: np.ndarray | None = None) -> ImageDirections:
    """
    Find the lines of an image and the directions that they share.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
        Rectified.
    intrinsics : CameraIntrinsics
        Of that image.
    rng : numpy.random.Generator
    coarse_down : (3,) floating, optional
        Unit direction that gravity has roughly; default that of an upright camera.
    covered : (H, W) bool, optional
        Where the image shows something.

    """
    segments = detect_line_segments(rgb, intrinsics, covered)
    return ImageDirections(segments, find_directions(segments, rng, coarse_down))
