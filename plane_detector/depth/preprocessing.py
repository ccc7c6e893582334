# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of images to network inputs, and of outputs back to the size of the image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.disparity import DEPTHS
from plane_detector.types import CameraIntrinsics

_SHRINKING = {'cubic': cv2.INTER_CUBIC, 'area': cv2.INTER_AREA, 'linear': cv2.INTER_LINEAR}
_GROWING = {'cubic': cv2.INTER_CUBIC, 'area': cv2.INTER_CUBIC, 'linear': cv2.INTER_LINEAR}
_LONGEST_ASPECT = 10
# Images this many times larger than the input are first averaged down to twice its size: bytes are
# faster than floats, and cubic interpolation would use one pixel of sixteen.
_FIRST_REDUCED = 4


@dataclass(frozen=True)
class Framing:
    """Position of an image in the input of a network; sizes are (width, height)."""

    image_size: tuple[int, int]
    input_size: tuple[int, int]
    left: int  # of the part of the input that the image covers, in pixels of the input
    top: int
    width: int
    height: int

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


@dataclass(frozen=True)
class InputRecipe:
    """Conversion of an image to the network's input: resizing, scaling, normalisation."""

    scale: float  # factor applied to the pixel values first
    mean: tuple[float, ...]  # of the scaled RGB
    std: tuple[float, ...]
    # Interpolation: ``cubic``; ``area``, which avoids aliasing when shrinking and is cubic when
    # enlarging; or ``linear``.
    resize: str = 'cubic'
    # The image keeps its aspect ratio and gets a border of this colour, 0 to 255; empty: the image
    # is stretched to the whole input.
    border_rgb: tuple[float, ...] = ()

    def framing(self, image_size: tuple[int, int], input_size: tuple[int, int]) -> Framing:
        """
        Return the position of an image (width, height) in an input (width, height).

        If the number of border pixels is odd, right and bottom get one more, as in Metric3D.
        """
        if not self.border_rgb:
            return Framing(image_size, input_size, 0, 0, *input_size)
        factor = min(input_size[0] / image_size[0], input_size[1] / image_size[1])
        width, height = (max(1, min(int(side * factor), most))
                         for side, most in zip(image_size, input_size, strict=True))
        return Framing(image_size, input_size, (input_size[0] - width) // 2,
                       (input_size[1] - height) // 2, width, height)


def lower_bound_size(width: int, height: int, short_side: int, multiple: int) -> tuple[int, int]:
    """
    Return (width, height) of a network input with the aspect ratio of the image.

    The short side becomes ``short_side`` and the other follows; both are rounded to multiples of
    ``multiple``, at least the short side. The method of MiDaS and Depth Anything (Resize,
    lower_bound).

    Raises
    ------
    ValueError
        The image is so elongated that the input would need gigabytes.

    """
    if max(width, height) > _LONGEST_ASPECT * min(width, height):
        raise ValueError(f'an image of {width} x {height} is too elongated for a network with any '
                         f'input size, one side may be {_LONGEST_ASPECT} times the other')
    factor = max(short_side / width, short_side / height)

    def rounded(side: int) -> int:
        nearest = round(side * factor / multiple) * multiple
        return nearest if nearest >= short_side else nearest + multiple

    return rounded(width), rounded(height)


def prepare_input(rgb: np.ndarray, size: tuple[int, int], recipe: InputRecipe) -> np.ndarray:
    """Return the input (3, height, width) float32 of a network for an image (H, W, 3) uint8."""
    framing = recipe.framing((rgb.shape[1], rgb.shape[0]), size)
    inner = (framing.width, framing.height)
    if rgb.shape[1] >= _FIRST_REDUCED * inner[0] and rgb.shape[0] >= _FIRST_REDUCED * inner[1]:
        rgb = cv2.resize(np.ascontiguousarray(rgb), (2 * inner[0], 2 * inner[1]),
                         interpolation=cv2.INTER_AREA)
    planes = np.empty((3, size[1], size[0]), np.float32)
    scales, offsets = ([np.float32(value / std) for value, std in zip(
        values, recipe.std, strict=True)] for values in ((recipe.scale,) * 3, recipe.mean))
    if recipe.resize == 'area' and framing.is_whole and np.all(inner <= np.array(
            rgb.shape[1::-1])):
        rows = np.require(rgb, np.uint8, 'C').reshape(len(rgb), -1)
        _shrink(rows, planes, np.array(scales), np.array(offsets))
        return planes
    image = rgb.astype(np.float32, order='C')  # OpenCV does not take reversed or transposed views
    if inner != image.shape[1::-1]:
        shrinks = inner[0] * inner[1] < rgb.shape[0] * rgb.shape[1]
        kind = (_SHRINKING if shrinks else _GROWING)[recipe.resize]
        image = cv2.resize(image, inner, interpolation=kind)
    if not framing.is_whole:
        whole = np.empty((size[1], size[0], 3), np.float32)
        whole[:] = recipe.border_rgb
        framing.crop(whole)[:] = image
        image = whole
    cv2.split(image, list(planes))  # half the time of reading channels with a stride
    for plane, scale, offset in zip(planes, scales, offsets, strict=True):
        plane *= scale
        plane -= offset
    return planes


@kernel("void(Array(uint8, 2, 'C', readonly=True), float32[:, :, ::1], float32[::1], "
        "float32[::1])", subject='network')
def _shrink(rows, planes, scales, offsets):
    """Fill planes (3, h, w) with the means of areas of an image (H, 3 W), scaled, less offsets."""
    height, width = planes.shape[1:]
    down, across = len(rows) / height, rows.shape[1] / 3 / width
    area, sums = down * across, np.empty(rows.shape[1], np.float32)
    most = min(int(across) + 2, rows.shape[1] // 3)  # pixels of a row in one of the result
    first, weights = np.empty(width, np.int64), np.zeros((width, most), np.float32)
    for u in range(width):
        left, right = u * across, min((u + 1) * across, rows.shape[1] / 3)
        first[u] = min(int(left), rows.shape[1] // 3 - most)
        for i in range(int(left), math.ceil(right - 1e-6)):
            weights[u, i - first[u]] = min(i + 1, right) - max(i, left)
    for v in range(height):
        top, bottom = v * down, min((v + 1) * down, len(rows))
        for k in range(len(sums)):
            sums[k] = 0
        for i in range(int(top), math.ceil(bottom - 1e-6)):
            weight = np.float32((min(i + 1, bottom) - max(i, top)) / area)
            for k in range(len(sums)):
                sums[k] += weight * rows[i, k]
        for u in range(width):
            red = green = blue = np.float32(0)
            for i in range(most):
                weight, k = weights[u, i], 3 * (first[u] + i)
                red += weight * sums[k]
                green += weight * sums[k + 1]
                blue += weight * sums[k + 2]
            planes[0, v, u] = red * scales[0] - offsets[0]
            planes[1, v, u] = green * scales[1] - offsets[1]
            planes[2, v, u] = blue * scales[2] - offsets[2]


def finish_output(raw: np.ndarray, size: tuple[int, int], output: str) -> np.ndarray:
    """
    Return a network's output (h, w) resized to an image of ``size``, width and height, float32.

    It is NaN where the output is not finite or not positive. Depth is interpolated as disparity,
    because planes are linear in it; otherwise they would bend.
    """
    values = np.array(raw, np.float32)
    values[~((values > 0) & (values < np.inf))] = np.nan
    disparity = 1 / values if output in DEPTHS else values
    if size != (disparity.shape[1], disparity.shape[0]):
        disparity = cv2.resize(disparity, size, interpolation=cv2.INTER_LINEAR)
    return 1 / disparity if output in DEPTHS else disparity
