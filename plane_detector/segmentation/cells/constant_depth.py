# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Depth that repeats exactly over a region is no measurement.

Drivers and robots write constants: over the robot's own body, beyond the range, as a mark for
invalid. Such a region has no noise, fills as a plane, and sets the noise of the image to 0. It is
known by its border, where it stands apart from what surrounds it, or by its frequency, far above
that of any other value. A wall that a simulator sees exactly from the front looks the same: what
is constant stays if the rest of the image has no noise either.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.compilation import kernel
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
    values = _frequent_values(depth_m)
    if not values.size:
        return depth_m
    is_constant = np.zeros(depth_m.shape, bool)
    for value in values:
        is_constant |= _unmeasured(depth_m, value)
    if not is_constant.any():
        return depth_m
    rest_m = np.where(is_constant, np.float32(np.nan), depth_m)
    steps_m = np.diff(np.unique(rest_m[::_STRIDE, ::_STRIDE]))
    step_m = float(steps_m[steps_m > _MIN_STEP_M].min(initial=np.inf))
    floor_m = max(noise_floor.depth_floor_m, step_m / 12**0.5 if np.isfinite(step_m) else 0.0)
    grid = build_cell_grid(DisparityImage(*zero_filled(to_disparity(rest_m))))
    noise = estimate_noise(grid, replace(noise_floor, depth_floor_m=floor_m))
    # The pixels, not the means of cells: a curved surface has no noise either.
    is_noisy = noise.pixel_sigma**2 > noise.variance_floor(grid.typical_disparity)
    return rest_m if is_noisy else depth_m


def _frequent_values(depth_m: np.ndarray) -> np.ndarray:
    """Return the values that fill a large share of the places and may be constants."""
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
    is_kept, most = attached <= 2 * MAX_ATTACHED_SHARE * border, counts.argmax()
    is_kept[most] = is_kept[most] or not _is_one_of_many(depth_m, values[most])
    return values[is_kept]


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


def _unmeasured(depth_m: np.ndarray, value: float) -> np.ndarray:
    """Return where a value is a constant, (H, W) bool: all of a frequent one, or pieces apart."""
    if not _is_one_of_many(depth_m, value):
        return depth_m == value
    return _pieces_apart(np.ascontiguousarray(depth_m), value, MIN_SHARE * depth_m.size)


@kernel("boolean[:, ::1](Array(float32, 2, 'C', readonly=True), float32, float64)")
def _pieces_apart(depth_m, value, least_px):
    """Return the connected pieces (H, W) that stand apart; none if all of these are small."""
    height, width = depth_m.shape
    found = np.zeros((height, width), np.bool_)
    pieces, pixels = np.zeros((height, width), np.int32), np.empty(depth_m.size, np.int32)
    sizes = np.zeros(depth_m.size // 2 + 2, np.int32)  # of each piece; the first one is 1
    piece = count = done = largest = 0
    for v in range(height):
        for u in range(width):
            if depth_m[v, u] != value or pieces[v, u]:
                continue
            piece, first = piece + 1, count
            pieces[v, u], pixels[count], count = piece, v * width + u, count + 1
            while done < count:
                y, x = pixels[done] // width, pixels[done] % width
                done += 1
                for side in range(4):
                    h, w = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
                    if (0 <= h < height and 0 <= w < width and depth_m[h, w] == value
                            and not pieces[h, w]):
                        pieces[h, w], pixels[count], count = piece, h * width + w, count + 1
            sizes[piece] = count - first
            largest = max(largest, count - first)
    if largest < least_px:
        return found
    border, attached = np.zeros(piece + 1, np.int64), np.zeros(piece + 1, np.int64)
    beside, near = np.zeros((height, width), np.int32), np.float32(MIN_JUMP) * value
    for i in range(count):  # in the order of the pieces
        y, x = pixels[i] // width, pixels[i] % width
        piece = pieces[y, x]
        if (0 < y < height - 1 and 0 < x < width - 1 and pieces[y - 1, x] and pieces[y, x - 1]
                and pieces[y + 1, x] and pieces[y, x + 1]):
            continue  # what is beside it is beside one of these
        for h in range(max(y - _BORDER_PX, 0), min(y + _BORDER_PX + 1, height)):
            for w in range(max(x - _BORDER_PX, 0), min(x + _BORDER_PX + 1, width)):
                z, before = depth_m[h, w], beside[h, w]
                if z != value and before != piece and abs(z) < np.inf:
                    is_near = abs(z - value) <= near
                    if before:  # a pixel beside two pieces counts for one of them
                        border[before] -= 1
                        attached[before] -= is_near
                    border[piece] += 1
                    attached[piece] += is_near
                    beside[h, w] = piece
    is_any = False
    for i in range(count):
        y, x = pixels[i] // width, pixels[i] % width
        piece = pieces[y, x]
        found[y, x] = attached[piece] <= MAX_ATTACHED_SHARE * border[piece]
        is_any |= found[y, x] and sizes[piece] >= least_px
    return found if is_any else np.zeros((height, width), np.bool_)


def _is_one_of_many(depth_m: np.ndarray, value: float) -> bool:
    """Return whether another value is about as frequent at the places, as in quantised depth."""
    places = depth_m[::_STRIDE, ::_STRIDE]
    counts = np.unique(places[np.isfinite(places) & (places != value)], return_counts=True)[1]
    return (counts.max(initial=0) * MIN_FREQUENCY_RATIO
            > np.count_nonzero(places == value))
