# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Rectification of images of a real lens to those of a pinhole camera, and reduction.

The models are those of sensor_msgs/CameraInfo as OpenCV implements them: plumb_bob (Brown, 5
coefficients), rational_polynomial (8; 12 and 14 with OpenCV's thin prism and tilted sensor) and
equidistant (Kannala and Brandt, 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.types import CameraIntrinsics

# chosen: a rotation rounded to two digits is accepted.
_MOST_OFF_ROTATION = 0.05
_COEFFICIENTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8, 12, 14), 'equidistant': (4,)}


@dataclass(frozen=True)
class Rectification:
    """Maps from a rectified image to the original one; ValueError if they share no pixel."""

    map_x: np.ndarray  # (H, W) float32, column in the original image, in pixels
    map_y: np.ndarray  # the row
    # (H, W) float32, depth along the rectified optical axis divided by that along the original
    # one; (1, 1), 1, if the camera is not rotated.
    depth_factor: np.ndarray

    def __post_init__(self) -> None:
        if not self.inside().any():  # also if a number of the calibration is not finite
            raise ValueError('the rectified image would be empty: K, D, R and P of the CameraInfo '
                             'do not fit together')

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """Rectify an image (H, W, 3) uint8; black outside the original."""
        self._check(rgb)
        return cv2.remap(rgb, self.map_x, self.map_y, cv2.INTER_LINEAR,
                         borderMode=cv2.BORDER_CONSTANT)

    def depth(self, depth_m: np.ndarray) -> np.ndarray:
        """Rectify a depth image (H, W) float32 by nearest pixels; NaN outside the original."""
        self._check(depth_m)
        nearest = cv2.remap(depth_m, self.map_x, self.map_y, cv2.INTER_NEAREST,
                            borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
        return nearest * self.depth_factor

    def inside(self) -> np.ndarray:
        """Return the pixels (H, W), bool, that the original image covers."""
        height, width = self.map_x.shape
        return ((self.map_x >= 0) & (self.map_x <= width - 1)
                & (self.map_y >= 0) & (self.map_y <= height - 1))

    def _check(self, image: np.ndarray) -> None:
        (height, width), (map_height, map_width) = image.shape[:2], self.map_x.shape
        if (height, width) != (map_height, map_width):
            raise ValueError(f'the image is {width} x {height}, its calibration is for '
                             f'{map_width} x {map_height}')


def make_rectification(model: str, distortion: np.ndarray, camera_matrix: np.ndarray,
                       rotation: np.ndarray, rectified_matrix: np.ndarray,
                       size: tuple[int, int]) -> Rectification:
    """
    Compute the maps of a calibration.

    Parameters
    ----------
    model : str
        plumb_bob, rational_polynomial or equidistant.
    distortion : (N,) float64
        Its coefficients.
    camera_matrix : (3, 3) float64
        Of the original image (K).
    rotation : (3, 3) float64
        From the frame of the camera to the rectified one (R); all zeros: no rotation.
    rectified_matrix : (3, 3) float64
        Of the rectified image (the left part of P).
    size : (int, int)
        Width and height of both images.

    Raises
    ------
    ValueError
        The model is unknown, the number of its coefficients is wrong, R is not a rotation, or no
        pixel is left.

    """
    if model not in _COEFFICIENTS:
        raise ValueError(f'distortion model {model!r} is not known: '
                         f'{", ".join(_COEFFICIENTS)} are; rectify the image before this node')
    if len(distortion) not in _COEFFICIENTS[model]:
        counts = ' or '.join(str(count) for count in _COEFFICIENTS[model])
        raise ValueError(f'{model} has {counts} coefficients, not {len(distortion)}')
    rotation = np.asarray(rotation, float) if np.any(rotation) else np.eye(3)
    with np.errstate(all='ignore'):
        if not (abs(rotation @ rotation.T - np.eye(3)) < _MOST_OFF_ROTATION).all():  # nor NaN
            raise ValueError('R of the CameraInfo is not a rotation')
    lens = cv2.fisheye if model == 'equidistant' else cv2
    map_x, map_y = lens.initUndistortRectifyMap(
        np.asarray(camera_matrix, float), np.asarray(distortion, float), rotation,
        np.asarray(rectified_matrix, float), size, cv2.CV_32FC1)
    return Rectification(map_x, map_y, _depth_factor(rotation, rectified_matrix, size))


def _depth_factor(rotation: np.ndarray, rectified_matrix: np.ndarray,
                  size: tuple[int, int]) -> np.ndarray:
    """Return 1 over the third component of R^T (x, y, 1), with the rectified ray (x, y, 1)."""
    of_column, of_row, constant = np.linalg.inv(rectified_matrix).T @ rotation[:, 2]
    if of_column == of_row == 0:
        return np.full((1, 1), 1 / constant, np.float32)
    # In single precision: an image of 8000 x 6000 would take 2 GB more.
    rows = (of_row * np.arange(size[1]) + constant).astype(np.float32)
    original_depth = np.add.outer(rows, (of_column * np.arange(size[0])).astype(np.float32))
    return np.divide(1, original_depth, out=original_depth)


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

    def camera(self, full: CameraIntrinsics) -> CameraIntrinsics:
        """Return the camera of images of the new size."""
        by_x, by_y = (new / old for old, new in zip(self.old_size, self.new_size, strict=True))
        # The left edge of the image is at -0.5 in both sizes.
        return CameraIntrinsics(full.fx * by_x, full.fy * by_y, full.cx * by_x + 0.5 * (by_x - 1),
                                full.cy * by_y + 0.5 * (by_y - 1), *self.new_size,
                                full.is_guessed)
