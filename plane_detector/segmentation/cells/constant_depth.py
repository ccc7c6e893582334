# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Depth that repeats exactly over a region is no measurement.

Drivers and robots write constants: over the robot's own body, beyond the range, as a mark for
invalid. Such a region has no noise, fills as a plane, and sets the noise of the image to 0. It is
known by its border, where it stands apart from what surrounds it, or by its frequency, far above
that of any other value. A wall that a simulator sees exactly from the front looks the same: what
is constant stays if the rest of the image has no noise either. So does what is near: the noise of
1/z is far below a millimetre of depth there, and all pixels of a front are rounded to one value.
What is removed may still be the front of an obstacle: `ground.obstacles` tells it by what is seen
behind it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.disparity import to_disparity, zero_filled
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise, estimate_noise

# A constant fills at least this share of the image; a single value of noisy depth in millimetres
# has up to .001 of the pixels.
# chosen: field cases have .24 and .43; half the smallest plane.
MIN_SHARE = 0.01
# Depth around a constant differs by more than this. Steps of quantised depth are smaller: those
# of a Kinect are .03 at 8 m. chosen: above that.
MIN_JUMP = 0.05
# chosen: a mask may have the depth of the floor at a few places of its border; the front of a box
# that stands on the floor has it along a fifth.
MAX_ATTACHED_SHARE = 0.15
# A constant is so many times as frequent as any other value, or stands apart. The values of a
# quantised wall are about equally frequent.
# chosen: between 2 and the 100 of a limit.
MIN_FREQUENCY_RATIO = 8
# chosen: above the rounding of float32 at 10 m, below what sensors and files resolve.
_MIN_STEP_M = 1e-5
# chosen: enough places for the smallest share, .01 of 4800 cells, are 48.
_STRIDE = 8
_BORDER_PX = 2


def without_constants(depth_m: np.ndarray, noise_floor: Noise) -> np.ndarray:
    """
    Return depth in which constants that stand for something else are NaN.

    Parameters
    ----------
    depth_m : (H, W) float32
        Measured, metres, NaN invalid.
    noise_floor : Noise
        Lower bound of the noise of its 1/z.

    Returns
    -------
    (H, W) float32
        The same array if there are none.

    Examples
    --------
    >>> floor = Noise(0.0003)
    >>> depth_m = np.random.default_rng(0).normal(2.0, 0.01, (120, 160)).astype(np.float32)
    >>> bool(without_constants(depth_m, floor) is depth_m)
    True
    >>> depth_m[80:, 40:] = 5.0
    >>> bool(np.isnan(without_constants(depth_m, floor)[80:, 40:]).all())
    True

    """
    dominant = _dominant_value(depth_m)
    values = _frequent_values(depth_m, dominant)
    if not values.size:
        return depth_m
    is_constant = _pieces_apart(np.ascontiguousarray(depth_m), values[values != dominant],
                                MIN_SHARE * depth_m.size)
    if dominant in values:
        is_constant |= depth_m == dominant
    if not is_constant.any():
        return depth_m
    rest_m = np.where(is_constant, np.float32(np.nan), depth_m)
    steps_m = np.diff(np.unique(rest_m[::_STRIDE, ::_STRIDE]))
    step_m = float(steps_m[steps_m > _MIN_STEP_M].min(initial=np.inf))
    step_m = step_m if np.isfinite(step_m) else 0.0
    floor_m = max(noise_floor.depth_floor_m, step_m / 12**0.5)
    grid = build_cell_grid(DisparityImage(*zero_filled(to_disparity(rest_m))))
    noise = estimate_noise(grid, replace(noise_floor, depth_floor_m=floor_m))
    # The pixels, not the means of cells: a curved surface has no noise either.
    if noise.pixel_sigma**2 <= noise.variance_floor(grid.typical_disparity):
        return depth_m
    # derived: with noise of half a step two thirds of the pixels have one value, and the others
    # lie between them.
    is_measured = noise.pixel_sigma * values.astype(float) ** 2 < step_m / 2
    for value in values[is_measured]:
        is_constant &= depth_m != value
    if is_measured.any():
        rest_m = np.where(is_constant, np.float32(np.nan), depth_m)
    return rest_m if is_constant.any() else depth_m


def _dominant_value(depth_m: np.ndarray) -> float:
    """Return the value far more frequent than any other; NaN if there is none."""
    places = depth_m[::_STRIDE, ::_STRIDE]
    values, counts = np.unique(places[np.isfinite(places)], return_counts=True)
    if not values.size:
        return np.nan
    top = counts.argmax()
    most, counts[top] = counts[top], 0
    return values[top] if counts.max() * MIN_FREQUENCY_RATIO <= most else np.nan


def _frequent_values(depth_m: np.ndarray, dominant: float) -> np.ndarray:
    """Return the values, sorted, that fill a large share of the places and may be constants."""
    places = depth_m[:-1:_STRIDE, :-1:_STRIDE]
    is_equal = (np.isfinite(places) & (places == depth_m[1::_STRIDE, :-1:_STRIDE])
                & (places == depth_m[:-1:_STRIDE, 1::_STRIDE]))
    least = max(MIN_SHARE * places.size, 1)
    if np.count_nonzero(is_equal) < least:
        return np.empty(0, depth_m.dtype)
    values, counts = np.unique(places[is_equal], return_counts=True)
    values, counts = values[counts >= least], counts[counts >= least]
    if not values.size:
        return values
    # In quantised depth there may be dozens, and most places beside theirs have the next step.
    border, attached = _count_borders(np.ascontiguousarray(places), values)
    return values[(attached <= 2 * MAX_ATTACHED_SHARE * border) | (values == dominant)]


@kernel("UniTuple(int64[::1], 2)(Array(float32, 2, 'C', readonly=True), float32[::1])",
        is_short=True)
def _count_borders(places, values):
    """
    Return how many places with another depth are beside those of each value, and how many near.

    Only beside places in a piece: a noisy wall at the same depth takes the value here and there.
    """
    border, attached = np.zeros(len(values), np.int64), np.zeros(len(values), np.int64)
    for row in range(places.shape[0]):
        for column in range(places.shape[1]):
            here, equal, other, near = places[row, column], 0, 0, 0
            k = np.searchsorted(values, here)
            if k == len(values) or values[k] != here:
                continue
            for side in range(4):
                r, c = row + (side == 0) - (side == 1), column + (side == 2) - (side == 3)
                if 0 <= r < places.shape[0] and 0 <= c < places.shape[1]:
                    there = places[r, c]
                    equal += there == here
                    other += there != here and abs(there) < np.inf
                    near += there != here and abs(there - here) <= np.float32(MIN_JUMP) * here
            border[k] += other * (equal > 1)
            attached[k] += near * (equal > 1)
    return border, attached


@kernel("boolean[:, ::1](Array(float32, 2, 'C', readonly=True), float32[::1], float64)")
def _pieces_apart(depth_m, values, least_px):
    """Return the pieces (H, W) of sorted values that stand apart, with a large one of each."""
    height, width = depth_m.shape
    found = np.zeros((height, width), np.bool_)
    if len(values) == 0:
        return found
    pieces, pixels = np.zeros((height, width), np.int32), np.empty(depth_m.size, np.int32)
    # Of each piece, the first one is 1: its first pixel, and the index of its value.
    start = np.zeros(depth_m.size + 2, np.int32)
    value_of = np.zeros(depth_m.size + 2, np.int32)
    largest, of_value = np.zeros(len(values), np.int64), np.zeros(len(values), np.int64)
    piece = count = done = 0
    for v in range(height):
        before, k = np.float32(np.nan), np.int64(-1)
        for u in range(width):
            value = depth_m[v, u]
            if value != before:
                before, k = value, np.int64(-1)
                if values[0] <= value <= values[-1]:
                    k = np.searchsorted(values, value)
                    k = k if values[k] == value else np.int64(-1)
            if k < 0 or pieces[v, u]:
                continue
            piece += 1
            start[piece], value_of[piece] = count, k
            of_value[k] += 1
            pieces[v, u], pixels[count], count = piece, v * width + u, count + 1
            while done < count:
                y, x = pixels[done] // width, pixels[done] % width
                done += 1
                for side in range(4):
                    h, w = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
                    if (0 <= h < height and 0 <= w < width and depth_m[h, w] == value
                            and not pieces[h, w]):
                        pieces[h, w], pixels[count], count = piece, h * width + w, count + 1
            largest[k] = max(largest[k], count - start[piece])
    start[piece + 1] = count
    # The pieces in the order of their values.
    order, ends = np.empty(piece, np.int32), np.cumsum(of_value) - of_value
    for i in range(1, piece + 1):
        order[ends[value_of[i]]] = i
        ends[value_of[i]] += 1
    border, attached = np.zeros(piece + 1, np.int64), np.zeros(piece + 1, np.int64)
    beside = np.zeros((height, width), np.int32)
    for piece in order:
        k = value_of[piece]
        if largest[k] < least_px:
            continue
        value, near = values[k], np.float32(MIN_JUMP) * values[k]
        for i in range(start[piece], start[piece + 1]):
            y, x = pixels[i] // width, pixels[i] % width
            if (0 < y < height - 1 and 0 < x < width - 1 and depth_m[y - 1, x] == value
                    and depth_m[y, x - 1] == value and depth_m[y + 1, x] == value
                    and depth_m[y, x + 1] == value):
                continue  # what is beside it is beside one of these
            for h in range(max(y - _BORDER_PX, 0), min(y + _BORDER_PX + 1, height)):
                for w in range(max(x - _BORDER_PX, 0), min(x + _BORDER_PX + 1, width)):
                    z, other = depth_m[h, w], beside[h, w]
                    if z != value and other != piece and abs(z) < np.inf:
                        is_near = abs(z - value) <= near
                        # A pixel beside two pieces of a value counts for one of them.
                        if other and value_of[other] == k:
                            border[other] -= 1
                            attached[other] -= is_near
                        border[piece] += 1
                        attached[piece] += is_near
                        beside[h, w] = piece
    is_apart, is_any = np.zeros(len(border), np.bool_), np.zeros(len(values), np.bool_)
    for piece in order:
        is_apart[piece] = attached[piece] <= MAX_ATTACHED_SHARE * border[piece]
        is_any[value_of[piece]] |= (is_apart[piece]
                                    and start[piece + 1] - start[piece] >= least_px)
    for piece in order:
        if is_apart[piece] and is_any[value_of[piece]]:
            for i in range(start[piece], start[piece + 1]):
                found[pixels[i] // width, pixels[i] % width] = True
    return found
