# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Placement of an image in the input of a network, and of the output maps on the image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.types import CameraIntrinsics


@dataclass(frozen=True)
class Framing:
    """
    Position of an image in the input of a network.

    Attributes
    ----------
    image_size, input_size : (int, int)
        Width and height of the image and of the network's input.
    left, top, width, height : int
        Part of the input that the image covers, in pixels of the input.

    """

    image_size: tuple[int, int]
    input_size: tuple[int, int]
    left: int
    top: int
    width: int
    height: int

    @classmethod
    def stretched(cls, image_size: tuple[int, int], input_size: tuple[int, int]) -> Framing:
        """Return the framing of an image that is stretched to the whole input."""
        return cls(image_size, input_size, 0, 0, *input_size)

    @classmethod
    def letterboxed(cls, image_size: tuple[int, int], input_size: tuple[int, int]) -> Framing:
        """
        Return the framing of an image centred in the input with its aspect ratio.

        If the number of border pixels is odd, right and bottom get one more, as in Metric3D.
        """
        factor = min(input_size[0] / image_size[0], input_size[1] / image_size[1])
        width, height = (max(1, min(int(side * factor), most))
                         for side, most in zip(image_size, input_size, strict=True))
        return cls(image_size, input_size, (input_size[0] - width) // 2,
                   (input_size[1] - height) // 2, width, height)

    @property
    def is_whole(self) -> bool:
        """Whether the image covers the whole input."""
        return (self.width, self.height) == self.input_size

    def crop(self, array: np.ndarray) -> np.ndarray:
        """
        Return the part of a map (h, w, ...) that shows the image.

        The size of the map may be that of the input divided by an integer.
        """
        if self.is_whole:
            return array
        across, down = (array.shape[1] / self.input_size[0], array.shape[0] / self.input_size[1])
        rows = slice(round(self.top * down), round((self.top + self.height) * down))
        columns = slice(round(self.left * across), round((self.left + self.width) * across))
        return array[rows, columns]

    def focal_px(self, intrinsics: CameraIntrinsics) -> float:
        """Return the horizontal focal length of the image in pixels of the input."""
        return intrinsics.fx * self.width / self.image_size[0]

    def resized(self, array: np.ndarray) -> np.ndarray:
        """Return a cropped map (h, w) or (h, w, n) float32, resized linearly to the image."""
        if self.image_size == (array.shape[1], array.shape[0]):
            return array
        return cv2.resize(array, self.image_size, interpolation=cv2.INTER_LINEAR)


def rays(intrinsics: CameraIntrinsics, shape: tuple[int, int]) -> np.ndarray:
    """
    Return x / z and y / z of each pixel of a map that shows the whole image, (h, w, 2) float32.

    The size of the map may differ from that of the image; pixels have half-pixel centres.
    """
    height, width = shape
    u = (np.arange(width) + 0.5) * (intrinsics.width / width) - 0.5
    v = (np.arange(height) + 0.5) * (intrinsics.height / height) - 0.5
    x, y = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    return np.stack(np.broadcast_arrays(x[None], y[:, None]), axis=-1).astype(np.float32)
