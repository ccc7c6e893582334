# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Reduction of images for speed, and the matching camera matrices."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Reduction:
    """
    Reduction of images from one size to a smaller one; sizes are width and height, pixels.

    Examples
    --------
    >>> Reduction.to_side((1920, 1080), 640).new_size
    (640, 360)
    >>> Reduction.to_side((320, 240), 640).new_size
    (320, 240)

    """

    old_size: tuple[int, int]
    new_size: tuple[int, int]

    @classmethod
    def to_side(cls, size: tuple[int, int], max_side: int) -> Reduction:
        """Return the reduction that makes the longer side at most ``max_side``; 0: none."""
        factor = min(1.0, max_side / max(size)) if max_side else 1.0
        return cls(size, (max(round(size[0] * factor), 1), max(round(size[1] * factor), 1)))

    @property
    def is_none(self) -> bool:
        """Whether the size does not change."""
        return self.old_size == self.new_size

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """Return an image (H, W, 3) uint8 in the new size; each pixel is the mean of its area."""
        if self.is_none:
            return rgb
        return cv2.resize(rgb, self.new_size, interpolation=cv2.INTER_AREA)

    def matrix(self, camera_matrix: np.ndarray) -> np.ndarray:
        """Return the camera matrix (3, 3) for the new size; pixel centres have integer values."""
        reduced = camera_matrix.astype(float)
        for row, (old, new) in enumerate(zip(self.old_size, self.new_size, strict=True)):
            # The left edge of the image is at -0.5 in both sizes.
            reduced[row] *= new / old
            reduced[row, 2] += 0.5 * (new / old - 1)
        return reduced
