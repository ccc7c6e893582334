# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Checks that the output of a network can be depth.

Network files are easily confused: some output only zeros, some are called metric but output
relative disparity. A constant, empty or negative output is detected in any frame. Whether the
values rise or fall with depth is tested on an image of known depth: a corridor with a checkerboard
on all faces, so that only the perspective indicates distance.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.geometry.disparity import DEPTHS
from plane_detector.types import CameraIntrinsics, Prediction

# Share of negative depths tolerated, because resampling in a network may undershoot.
_MOST_NEGATIVE = 0.01
# chosen: fastdepth, the weakest network of the zoo, reaches 0.81 on the corridor; a network that
# depends only on the colour of a pixel reaches 0.01.
_MIN_OPPOSITE_CORRELATION = 0.4
# With less contrast an image shows nothing, and constant depth is not an error.
_MIN_CONTRAST = 2.0
_SAMPLED_SIDE = 96
# A network with valid values for a smaller share of the corridor is not judged by it.
_MIN_SEEN = 0.5

CORRIDOR_SIZE = (640, 480)
CORRIDOR_LENS = CameraIntrinsics(384.0, 384.0, 319.5, 239.5, *CORRIDOR_SIZE)
_FACES_M = {'floor': 1.2, 'ceiling': 1.4, 'left': 1.5, 'right': 1.5, 'end': 8.0}
_SQUARE_M = 0.5
_GREYS = (60, 110)


class ImplausibleDepthError(ValueError):
    """The output of a network cannot be the depth that was declared for its file."""


def corridor() -> tuple[np.ndarray, np.ndarray]:
    """
    Return an image (480, 640, 3) uint8 of a corridor, and its depth in metres, float32.

    A horizontal camera sees a checkerboard on every face, so that every row and every distance
    has the same mean grey level.
    """
    lens = CORRIDOR_LENS
    x, y = np.meshgrid((np.arange(lens.width) - lens.cx) / lens.fx,
                       (np.arange(lens.height) - lens.cy) / lens.fy)
    distances = np.stack([
        np.where(y > 0, _FACES_M['floor'] / y, np.inf),
        np.where(y < 0, -_FACES_M['ceiling'] / y, np.inf),
        np.where(x < 0, -_FACES_M['left'] / x, np.inf),
        np.where(x > 0, _FACES_M['right'] / x, np.inf), np.full(x.shape, _FACES_M['end'])])
    depth_m, face = distances.min(axis=0), distances.argmin(axis=0)
    across_m = np.where(np.isin(face, (2, 3)), y, x) * depth_m
    along_m = np.where(face == 4, y * depth_m, depth_m)
    is_dark = (np.floor(across_m / _SQUARE_M) + np.floor(along_m / _SQUARE_M)) % 2 > 0
    grey = np.where(is_dark, *_GREYS).astype(np.uint8)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), depth_m.astype(np.float32)


def check_values(values: np.ndarray, kind: str, rgb: np.ndarray) -> None:
    """
    Raise ImplausibleDepthError for an output (h, w) that cannot be depth of its stated kind.

    Constant values are an error unless the image (H, W, 3) shows nothing.
    """
    values = _sample(values)
    finite = values[np.isfinite(values)]
    if not finite.size:
        raise ImplausibleDepthError('its output is nowhere finite')
    low, high = float(finite.min()), float(finite.max())
    if high <= 0:
        what = 'zero everywhere' if low == high == 0 else 'nowhere positive'
        raise ImplausibleDepthError(f'its output is {what} ({low:g} to {high:g})')
    if high - low <= 1e-6 * high and _sample(rgb).std(axis=(0, 1)).max() > _MIN_CONTRAST:
        raise ImplausibleDepthError(f'its output is {high:g} everywhere')
    negative = np.mean(finite < 0)
    if kind in DEPTHS and negative > _MOST_NEGATIVE:
        raise ImplausibleDepthError(
            f'{negative:.0%} of its output is negative (down to {low:g}), but depth is not')


def check_kind(prediction: Prediction, depth_m: np.ndarray) -> None:
    """Raise ImplausibleDepthError if a prediction contradicts its kind on known depth (H, W)."""
    values, truth = _sample(prediction.values), _sample(depth_m)
    seen = np.isfinite(values)
    if seen.mean() < _MIN_SEEN:
        return
    sign = 1 if prediction.output in DEPTHS else -1
    correlation = sign * _rank_correlation(values[seen], truth[seen])
    if correlation < -_MIN_OPPOSITE_CORRELATION:
        rises, other = (('falls', 'disparity') if sign > 0 else ('rises', 'depth'))
        raise ImplausibleDepthError(
            f'it is declared as {prediction.output}, but its output {rises} with distance on an '
            f'image of a corridor (rank correlation {sign * correlation:.2f}): it seems to be '
            f'{other}. Set depth.output, or use another file')


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return the correlation of the ranks of two samples; ties share a rank. 0 if constant."""
    ranks = [np.unique(values, return_inverse=True)[1].astype(float) for values in (a, b)]
    if min(np.ptp(rank) for rank in ranks) == 0:
        return 0.0
    return float(np.corrcoef(*ranks)[0, 1])


def _sample(image: np.ndarray) -> np.ndarray:
    """Return every n-th row and column, about 96 of each."""
    steps = tuple(max(1, side // _SAMPLED_SIDE) for side in image.shape[:2])
    return image[::steps[0], ::steps[1]]
