# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Depth that is discarded before the search for planes: constants, and pixels behind a mesh.

Depth that repeats exactly over a region is not a measurement. Drivers and robots write constants:
over the robot's own body, beyond the range, or as a mark for invalid pixels. Such a region has no
noise, is a perfect plane, and sets the noise of the image to 0. It is recognised by its border,
where it is separated from its surroundings, or by its frequency, far above that of any other
value. A wall seen exactly from the front in a simulator looks the same, so constants stay if the
rest of the image has no noise either. Near constants stay too: there, the noise of 1/z corresponds
to far less than a millimetre of depth, and all pixels of a front are rounded to one value. Removed
depth may still be the front of an obstacle: `ground.obstacles` decides by what is visible behind
it.

Some rays to a mesh, a grating or a fence hit it, others hit what is behind it. The least-squares
plane of a cell that contains both lies between the two layers. Only the near layer is a surface
there, so pixels of the far layer are made invalid. A cell at an edge has two layers too; those of
a mesh are interleaved, and the neighbouring cells also have them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.disparity import to_disparity, zero_filled
from plane_detector.segmentation.cells.grid import (
    CellGrid,
    D,
    DisparityImage,
    N,
    add_moments,
    build_cell_grid,
    fit_plane,
)
from plane_detector.segmentation.cells.noise import Noise, estimate_noise

# A constant fills at least this share of the image; a single value of noisy depth in millimetres
# has up to .001 of the pixels.
# chosen: field cases have .24 and .43; half the smallest plane.
MIN_SHARE = 0.01
# Depth around a constant differs by more than this. Steps of quantised depth are smaller: .03 at 8
# m for a Kinect. chosen: above that.
MIN_JUMP = 0.05
# chosen: a mask may have the depth of the floor at a few places of its border; the front of a box
# that stands on the floor has it along a fifth.
MAX_ATTACHED_SHARE = 0.15
# A constant is this many times as frequent as any other value, or is separated. The values of a
# quantised wall are about equally frequent.
# chosen: between 2 and the 100 of a limit.
MIN_FREQUENCY_RATIO = 8
# chosen: above the rounding of float32 at 10 m, below what sensors and files resolve.
_MIN_STEP_M = 1e-5
# chosen: enough places for the smallest share, .01 of 4800 cells, are 48.
_STRIDE = 8
_BORDER_PX = 2
# Least distance between two layers: a share of 1/z, in deviations of the near layer about its
# plane, and in lower bounds of the noise.
# chosen: noise in two halves is apart by 2.3 deviations of the upper half as measured here, even
# values by 3; of steps of quantisation, whose bound is 1 / sqrt(12) of one, 12 are more than 3.
MIN_GAP_SHARE, MIN_GAP_DEVIATIONS, MIN_GAP_FLOORS = 0.02, 5.0, 12.0
# Two halves of normal noise are apart by 2.65 deviations of one half.
# chosen: above that, by chance of 64 pixels; mixed pixels between two layers leave 5.
MIN_SPLIT = 3.5
# Least length of the borders between interleaved layers in a cell, in sides of the cell.
# derived: an edge has one to 1.4, a bar two.
MIN_BORDER_SIDES = 2.0
# Of the 5 x 5 cells around one of a mesh, the least number with interleaved layers, or with two.
# chosen: along a pole or a cable 5 are interleaved, along an edge 5 to 10 have two layers; bars
# that are two cells apart leave 10 of the first kind, three cells apart 15 of the second.
AROUND_CELLS, MIN_INTERLEAVED, MIN_TWO_LAYERS = 2, 10, 15
# chosen: most splits settle in two.
ROUNDS = 3


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
    values, dominant = _frequent_values(depth_m)
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
    # The noise of pixels, not of cell means: a curved surface has no noise either.
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


def _frequent_values(depth_m: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return the values, sorted, that fill a large share of the places and may be constants.

    And the one that is far more frequent than any other; NaN if there is none, or no such value.
    """
    places = depth_m[:-1:_STRIDE, :-1:_STRIDE]
    is_equal = (np.isfinite(places) & (places == depth_m[1::_STRIDE, :-1:_STRIDE])
                & (places == depth_m[:-1:_STRIDE, 1::_STRIDE]))
    least = max(MIN_SHARE * places.size, 1)
    if np.count_nonzero(is_equal) < least:
        return np.empty(0, depth_m.dtype), np.nan
    values, counts = np.unique(places[is_equal], return_counts=True)
    values, counts = values[counts >= least], counts[counts >= least]
    if not values.size:
        return values, np.nan
    all_places = depth_m[::_STRIDE, ::_STRIDE]
    of_all, counts = np.unique(all_places[np.isfinite(all_places)], return_counts=True)
    top = counts.argmax()
    most, counts[top] = counts[top], 0
    dominant = of_all[top] if counts.max() * MIN_FREQUENCY_RATIO <= most else np.nan
    # In quantised depth there may be dozens, and most places next to theirs have the next step.
    border, attached = _count_borders(np.ascontiguousarray(places), values)
    is_kept = (attached <= 2 * MAX_ATTACHED_SHARE * border) | (values == dominant)
    return values[is_kept], dominant


@kernel("UniTuple(int64[::1], 2)(Array(float32, 2, 'C', readonly=True), float32[::1])",
        is_short=True)
def _count_borders(places, values):
    """
    Count places with another depth next to those of each value, and how many of them are near.

    Only next to places in a piece: a noisy wall at the same depth takes the value here and there.
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
                continue  # its neighbours are neighbours of one of these
            for h in range(max(y - _BORDER_PX, 0), min(y + _BORDER_PX + 1, height)):
                for w in range(max(x - _BORDER_PX, 0), min(x + _BORDER_PX + 1, width)):
                    z, other = depth_m[h, w], beside[h, w]
                    if z != value and other != piece and abs(z) < np.inf:
                        is_near = abs(z - value) <= near
                        # A pixel next to two pieces of a value counts for one of them.
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


def without_far_layer(image: DisparityImage, grid: CellGrid,
                      noise_floor: Noise) -> tuple[DisparityImage, CellGrid]:
    """
    Return an image and its grid without the pixels that see through a mesh.

    Parameters
    ----------
    image : DisparityImage
    grid : CellGrid
        Of this image.
    noise_floor : Noise
        Lower bound of the noise.

    Returns
    -------
    image : DisparityImage
        The same if there are none.
    grid : CellGrid
        Of this image; ``is_mesh`` says where the pixels were.

    """
    floors = noise_floor.depth_floor_m**2, noise_floor.disparity_floor**2
    values, valid, is_mesh = _near_layers(
        image.values, image.valid, grid.moments, (*grid.shape, grid.size_px, grid.width_px),
        grid.origin, grid.residual_rms, floors)
    if not is_mesh.any():
        return image, grid
    image = DisparityImage(values, valid)
    return image, replace(build_cell_grid(image, grid.size_px, lens=grid.lens), is_mesh=is_mesh)


@kernel('Tuple((float32[:, ::1], boolean[:, ::1], boolean[::1]))(float32[:, ::1], '
        'boolean[:, ::1], float64[:, ::1], UniTuple(int64, 4), UniTuple(float64, 2), '
        'float64[::1], UniTuple(float64, 2))')
def _near_layers(disparity, valid, moments, shape, origin, rms, floors):
    """Return values and validity without the far layers, and which cells had them."""
    (rows, columns, size, width_px), (height, width) = shape, disparity.shape
    planes, pixel = np.zeros((rows * columns, 3)), 1.0 / width_px
    limits, sides = np.full(rows * columns, np.nan), np.zeros(rows * columns)
    work, joint, count = np.empty((2, size * size)), np.empty(10), 0
    # One cell of each 2 x 2 first, then the others if such a one beside them has two layers: of
    # most images this is a third.
    for turn in range(2):
        for i in range(rows * columns):
            row, column, plane = i // columns, i % columns, planes[i]
            if (turn == 0) != (row & column & 1) or (
                    rms[i] <= 0.2 * MIN_GAP_SHARE * moments[i, D] / max(moments[i, N], 1.0)):
                continue
            beside = 0.0
            joint[:] = 0.0
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    add_moments(joint, moments[r * columns + c])
                    beside += sides[r * columns + c] * (r & c & 1)
            a, b, c0 = fit_plane(joint)
            if np.isnan(a) or (turn == 1 and beside == 0):
                continue
            plane[0], plane[1] = a * pixel, b * pixel
            plane[2] = a * origin[0] + b * origin[1] + c0
            limits[i], sides[i] = _limit_of_near_layer(
                disparity, valid, (row * size, column * size, size), plane, floors, work)
            count += sides[i] > 0
    is_mesh = np.zeros(rows * columns, np.bool_)
    if count < MIN_INTERLEAVED:
        return disparity, valid, is_mesh
    values, kept = disparity.copy(), valid.copy()
    for row in range(rows):
        for column in range(columns):
            i, two, interleaved = row * columns + column, 0, 0
            if np.isnan(limits[i]):
                continue
            for r in range(max(row - AROUND_CELLS, 0), min(row + AROUND_CELLS + 1, rows)):
                for c in range(max(column - AROUND_CELLS, 0),
                               min(column + AROUND_CELLS + 1, columns)):
                    two += sides[r * columns + c] > 0
                    interleaved += sides[r * columns + c] >= MIN_BORDER_SIDES
            if two < MIN_TWO_LAYERS and interleaved < MIN_INTERLEAVED:
                continue
            is_mesh[i] = True
            for v in range(row * size, min(row * size + size, height)):
                for u in range(column * size, min(column * size + size, width)):
                    off = disparity[v, u] - (planes[i, 0] * u + planes[i, 1] * v + planes[i, 2])
                    if off < limits[i]:
                        values[v, u], kept[v, u] = 0, False
    return values, kept, is_mesh


@kernel('UniTuple(float64, 2)(float32[:, ::1], boolean[:, ::1], UniTuple(int64, 3), float64[::1], '
        'UniTuple(float64, 2), float64[:, ::1])')
def _limit_of_near_layer(disparity, valid, corner, plane, floors, work):
    """Return the residual of the farthest pixels of the near layer, and the sides of layers."""
    (top, left, size), (height, width), n, total = corner, disparity.shape, 0, 0.0
    bottom, right = min(top + size, height), min(left + size, width)
    for v in range(top, bottom):
        for u in range(left, right):
            if valid[v, u]:
                off = disparity[v, u] - (plane[0] * u + plane[1] * v + plane[2])
                work[0, n], n, total = off, n + 1, total + off
    limit, gap = total / max(n, 1), 0.0
    for _ in range(ROUNDS):
        near, of_near, square, of_far = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            is_near = 1.0 if work[0, k] >= limit else 0.0
            near += is_near
            of_near += is_near * work[0, k]
            square += is_near * work[0, k] * work[0, k]
            of_far += (1.0 - is_near) * work[0, k]
        if near == 0 or near == n:
            return np.nan, 0.0
        mean, far = of_near / near, of_far / (n - near)
        gap, limit = mean - far, (mean + far) / 2
        if gap * gap < MIN_SPLIT**2 * (square / near - mean * mean):
            return np.nan, 0.0  # most cells
    count = 0
    for k in range(n):
        if work[0, k] >= limit:
            work[1, count] = work[0, k]
            count += 1
    ordered = np.sort(work[1, :count])
    middle, upper = ordered[count // 2], ordered[count * 5 // 6]
    off = (top + size / 2) * plane[1] + (left + size / 2) * plane[0] + plane[2] + middle
    floor = floors[0] * off**4 + floors[1]
    if (gap < MIN_GAP_SHARE * off or gap < MIN_GAP_DEVIATIONS * (upper - middle)
            or gap * gap < MIN_GAP_FLOORS**2 * floor):
        return np.nan, 0.0
    limit, borders = max(limit, middle - 5 * max(upper - middle, 0.05 * gap)), 0
    for v in range(top, bottom):
        for u in range(left, right):
            is_near = disparity[v, u] - (plane[0] * u + plane[1] * v + plane[2]) >= limit
            for y, x in ((v, u + 1), (v + 1, u)):
                if y < bottom and x < right and valid[v, u] and valid[y, x]:
                    other = disparity[y, x] - (plane[0] * x + plane[1] * y + plane[2])
                    borders += is_near != (other >= limit)
    return limit, borders / size
