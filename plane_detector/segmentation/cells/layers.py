# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Surfaces that are seen through: meshes, gratings, fences.

Some rays hit the mesh, others what is behind it. The least-squares plane of a cell that holds both
lies between them, by the share of either. Only the near layer is a surface of the image there:
pixels of the far one are not valid. A cell at an edge has two layers, too; those of a mesh are
interleaved, and cells around it have them as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import D, N, add_moments, fit_plane

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
