# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Evidence of a photograph on which of its sides is down.

Floors are below, and light comes from above. So four statistics differ between upright and turned
photographs: colours differ more between top and bottom than between left and right; level edges
are stronger than upright ones, and brighter above, as what faces upwards receives more light; and
lines that are neither level nor upright, those that lead into the distance, are mostly in the
lower half. Each of them is weak, and what misleads in one image of a room misleads in all.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.line_segments import LineSegments

# Weights of the four statistics. tuned: multinomial regression of the side that is down, ridge 3,
# on 244 real images of 44 scenes (docs/results.md), each scene with the same weight. The weights
# without any one of the scenes are within a fifth of these.
WEIGHTS = np.array([2.7, 6.6, 10.8, 6.4])
# Share of the photographs whose statistics show nothing. tuned: the mean log probability of the
# scenes left out is flat up to 0.05, and falls from 0.1 on.
UNUSUAL = 0.05
# An image whose mean gradient (grey levels per pixel) is this has half of the full weight, one of
# a third of it a tenth: where there is little to be seen, a few edges decide. tuned: real scenes,
# all above 2.1, are flat from 0 to 3, at 4 a twentieth of their evidence is lost; corridors
# rendered without light and things, of 1.2 to 2.6, are misled a quarter as far as at 0.
HALF_GRADIENT = 3.0
# Size of the image whose colours are compared, and what is added to their spread (of 255). tuned:
# flat from 30 to 120, and from 3 to 20.
COLOUR_PX, LEAST_COLOUR = 30, 10.0
# A pixel is on a level or upright edge if its gradient is within 27 degrees of the vertical or
# horizontal of the image and at least this strong (grey levels per pixel); so are lines.
ALONG, STRONG = 2.0, 8.0
# Added to the mean gradient, to that of strong edges (grey levels per pixel), and to the length of
# all lines (sides of the square), so that a few of them prove little. tuned: flat from 0 to 1,
# from 0 to 1, and from 0 to 8.
LEAST_GRADIENT, LEAST_EDGES, LEAST_LINES = 1.0, 0.6, 4.0
# derived: thirds and gradients need some pixels.
LEAST_SIDE_PX = 16
# Bottom, right, top and left of the image, as directions in it.
SIDES = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])
NO_SCORE = np.zeros(4)


def log_likelihood(score: np.ndarray) -> np.ndarray:
    """Return the log likelihoods (4,), at most 0, of each side of the image being down."""
    shares = np.exp(score - score.max())
    shares = (1 - UNUSUAL) * shares / shares.sum() + UNUSUAL / 4
    return np.log(shares / shares.max())


def score_of_sides(rgb: np.ndarray, grey: np.ndarray, segments: LineSegments) -> np.ndarray:
    """
    Return the score (4,) of each side of an image being down, for :func:`log_likelihood`.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    grey : (h, w) uint8
        The same as of :func:`reduced_grey`.
    segments : LineSegments
        Of that image.

    """
    return statistics_of_sides(rgb, grey, segments) @ WEIGHTS


def statistics_of_sides(rgb: np.ndarray, grey: np.ndarray, segments: LineSegments) -> np.ndarray:
    """Return the four statistics (4, 4) for each side of the image, as :func:`score_of_sides`."""
    if min(grey.shape) < LEAST_SIDE_PX:
        return np.zeros((len(SIDES), len(WEIGHTS)))
    totals, edges, signed = _gradients(np.ascontiguousarray(_square(grey)))
    level = np.log((totals + LEAST_GRADIENT) / (totals[::-1] + LEAST_GRADIENT))
    light = -signed / (edges + LEAST_EDGES)
    is_upright = np.abs(SIDES)
    statistics = np.column_stack([
        is_upright @ _colour_steps(rgb), is_upright @ level, SIDES @ light,
        SIDES @ _place_of_slanted(segments, rgb.shape[:2])])
    square = totals.mean() ** 2
    return statistics * (square / (square + HALF_GRADIENT**2))


def _square(image: np.ndarray) -> np.ndarray:
    """Return the square in the middle: its sides are alike."""
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    return image[top:top + side, left:left + side]


def _colour_steps(rgb: np.ndarray) -> np.ndarray:
    """Return the differences (2,) of colour from left to right and from top to bottom."""
    small = cv2.resize(_square(rgb), (COLOUR_PX, COLOUR_PX), interpolation=cv2.INTER_LINEAR)
    colours = cv2.cvtColor(small, cv2.COLOR_RGB2LAB).astype(np.float32)
    colours /= colours.std(axis=(0, 1)) + LEAST_COLOUR
    third = COLOUR_PX // 3
    return np.array([np.abs((along[:third] - along[-third:]).mean(axis=0)).sum()
                     for along in (colours.mean(axis=0), colours.mean(axis=1))])


@kernel('UniTuple(float64[::1], 3)(uint8[:, ::1])')
def _gradients(grey):
    """
    Return means over pixels, each of x and y, in grey levels per pixel.

    Of the size of all gradients; of the size of the gradients of strong edges across x and y; and
    of these gradients with their sign.
    """
    totals, edges, signed = np.zeros(2), np.zeros(2), np.zeros(2)
    height, width = grey.shape
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            a, b, c = (np.int32(grey[i - 1, j - 1]), np.int32(grey[i - 1, j]),
                       np.int32(grey[i - 1, j + 1]))
            d, e = np.int32(grey[i, j - 1]), np.int32(grey[i, j + 1])
            f, g, h = (np.int32(grey[i + 1, j - 1]), np.int32(grey[i + 1, j]),
                       np.int32(grey[i + 1, j + 1]))
            x, y = (c + 2 * e + h - a - 2 * d - f) / 8, (f + 2 * g + h - a - 2 * b - c) / 8
            totals[0] += abs(x)
            totals[1] += abs(y)
            if x * x + y * y < STRONG * STRONG:
                continue
            if abs(x) > ALONG * abs(y):
                edges[0] += abs(x)
                signed[0] += x
            elif abs(y) > ALONG * abs(x):
                edges[1] += abs(y)
                signed[1] += y
    count = (height - 2) * (width - 2)
    return totals / count, edges / count, signed / count


def _place_of_slanted(segments: LineSegments, shape: tuple[int, int]) -> np.ndarray:
    """Return how far slanted lines are from the middle of the square (2,), of all lines."""
    height, width = shape
    ends = (segments.ends_px - [(width - 1) / 2, (height - 1) / 2]) / min(height, width)
    ends = ends[(np.abs(ends) < 0.5).all(axis=(1, 2))]
    x, y = np.abs(ends[:, 1] - ends[:, 0]).T
    lengths = np.hypot(x, y)
    slanted = np.where((x < ALONG * y) & (y < ALONG * x), lengths, 0)
    return 8 * slanted @ ends.mean(axis=1) / (lengths.sum() + LEAST_LINES)
