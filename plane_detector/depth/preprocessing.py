# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of images to network inputs, and of outputs back to the size of the image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.depth.framing import Framing

_SHRINKING = {'cubic': cv2.INTER_CUBIC, 'area': cv2.INTER_AREA, 'linear': cv2.INTER_LINEAR}
_GROWING = {'cubic': cv2.INTER_CUBIC, 'area': cv2.INTER_CUBIC, 'linear': cv2.INTER_LINEAR}
_LONGEST_ASPECT = 10
FIRST_REDUCED = 4
"""Images so many times larger than the input are first reduced by their mean to twice its size:
bytes are faster than floats, and cubic interpolation would use one pixel of sixteen."""


@dataclass(frozen=True)
class InputRecipe:
    """
    Conversion of an image to the network's input: resizing, scaling, normalisation.

    Attributes
    ----------
    scale : float
        Factor applied to the pixel values first.
    mean, std : (3,) floats
        Applied to the scaled RGB.
    resize : str
        Interpolation: ``cubic``; ``area``, which avoids aliasing when shrinking and is cubic when
        enlarging; or ``linear``.
    border_rgb : (3,) floats, optional
        The image keeps its aspect ratio and gets a border of this colour, 0 to 255; empty: the
        image is stretched to the whole input.

    """

    scale: float
    mean: tuple[float, ...]
    std: tuple[float, ...]
    resize: str = 'cubic'
    border_rgb: tuple[float, ...] = ()

    def framing(self, image_size: tuple[int, int], input_size: tuple[int, int]) -> Framing:
        """Return the position of an image (width, height) in an input (width, height)."""
        kind = Framing.letterboxed if self.border_rgb else Framing.stretched
        return kind(image_size, input_size)


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
    """
    Convert an image to a network's input.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
        The image.
    size : (int, int)
        Width and height of the input.
    recipe : InputRecipe
        The preprocessing that the network was trained with.

    Returns
    -------
    (3, height, width) float32
        Normalised R, G and B channels.

    """
    framing = recipe.framing((rgb.shape[1], rgb.shape[0]), size)
    inner = (framing.width, framing.height)
    if rgb.shape[1] >= FIRST_REDUCED * inner[0] and rgb.shape[0] >= FIRST_REDUCED * inner[1]:
        rgb = cv2.resize(np.ascontiguousarray(rgb), (2 * inner[0], 2 * inner[1]),
                         interpolation=cv2.INTER_AREA)
    image = rgb.astype(np.float32, order='C')  # OpenCV does not take reversed or transposed views
    if inner != image.shape[1::-1]:
        shrinks = inner[0] * inner[1] < rgb.shape[0] * rgb.shape[1]
        kind = (_SHRINKING if shrinks else _GROWING)[recipe.resize]
        image = cv2.resize(image, inner, interpolation=kind)
    if not framing.is_whole:
        image = _bordered(image, framing, recipe.border_rgb)
    planes = np.empty((3, size[1], size[0]), np.float32)
    for channel, (mean, std) in enumerate(zip(recipe.mean, recipe.std, strict=True)):
        np.multiply(image[..., channel], np.float32(recipe.scale / std), out=planes[channel])
        planes[channel] -= np.float32(mean / std)
    return planes


def _bordered(image: np.ndarray, framing: Framing, border_rgb: tuple[float, ...]) -> np.ndarray:
    """Return an image with its border, (height, width, 3) float32, of the size of the input."""
    width, height = framing.input_size
    whole = np.empty((height, width, 3), np.float32)
    whole[:] = border_rgb
    framing.crop(whole)[:] = image
    return whole


def finish_output(raw: np.ndarray, size: tuple[int, int], output: str) -> np.ndarray:
    """
    Resize a network's output to the size of the image and set invalid pixels to NaN.

    Depth is interpolated as disparity, in which planes are linear; otherwise they would bend.

    Parameters
    ----------
    raw : (h, w) floating
        Output of the network.
    size : (int, int)
        Width and height of the image.
    output : str
        ``metric_depth``, ``disparity`` or ``relative_disparity``.

    Returns
    -------
    (H, W) float32
        Of the same kind as ``raw``; NaN where it is not finite or not positive.

    """
    values = np.array(raw, np.float32)
    values[~((values > 0) & (values < np.inf))] = np.nan
    disparity = 1 / values if output == 'metric_depth' else values
    if size != (disparity.shape[1], disparity.shape[0]):
        disparity = cv2.resize(disparity, size, interpolation=cv2.INTER_LINEAR)
    return 1 / disparity if output == 'metric_depth' else disparity
