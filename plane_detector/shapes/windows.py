# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops over the pixels of cells.

The image is given as the depth (H, W), the plane of each pixel (H, W), -1 for none, and a mask (K
+ 1,) of planes that may be replaced; its last entry is for -1. The camera is given as fx, fy, cx,
cy, standard deviation of 1/depth, smallest standard deviation of depth, side of a cell in pixels.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.surface import DEVIATIONS, depth_on_ray, distance_deviation, turn_of

# For speed only every third ray is tested.
THROUGH_STEP_PX = 3
# derived: the surface of a ball with a radius of 30 pixels ends with a step of this many pixels.
STEEP = 8.0


@kernel('UniTuple(float64, 2)(float64, float64[::1])')
def noise_at(z, camera):
    """Return the standard deviation of the depth z of a pixel, and the side of a pixel there."""
    return np.sqrt((camera[4] * z * z) ** 2 + camera[5] ** 2), z / camera[0]


@kernel('float64[::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), int64, int64, int64)')
def free_shares(image, size, rows, columns):
    """Return the share (rows * columns,) of each cell's pixels that are free."""
    depth, labels, may_take = image
    share = np.zeros(rows * columns)
    for v in range(min(depth.shape[0], rows * size)):
        for u in range(min(depth.shape[1], columns * size)):
            if np.isfinite(depth[v, u]) and may_take[labels[v, u]]:
                share[v // size * columns + u // size] += 1 / size**2
    return share


@kernel('int64[::1](float32[:, ::1], int32[:, ::1], boolean[:, ::1], int64, int64)')
def label_counts(depth, labels, cells, size, count):
    """Return the number of pixels of cells (R, C) with depth, by label; the last: no plane."""
    result = np.zeros(count + 1, np.int64)
    for row in range(cells.shape[0]):
        for column in range(cells.shape[1]):
            if cells[row, column]:
                for v in range(row * size, min((row + 1) * size, depth.shape[0])):
                    for u in range(column * size, min((column + 1) * size, depth.shape[1])):
                        if np.isfinite(depth[v, u]):
                            result[labels[v, u]] += 1
    return result


@kernel('int64[::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), int64[::1], int64, '
        'int64, int64)')
def free_pixels(image, cells, columns, size, step):
    """Return every step-th free pixel of cells (n,) as v * width + u."""
    depth, labels, may_take = image
    height, width = depth.shape
    area = size * size
    found = np.empty(len(cells) * area // step + 1, np.int64)
    count = 0
    for k in range(0, len(cells) * area, step):
        cell, place = cells[k // area], k % area
        v, u = cell // columns * size + place // size, cell % columns * size + place % size
        if (v < height and u < width and np.isfinite(depth[v, u])
                and may_take[labels[v, u]]):
            found[count] = v * width + u
            count += 1
    return found[:count].copy()


@kernel('float64[:, ::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), int64[::1], '
        'int64, float64[::1])')
def silhouette_rays(image, cells, columns, camera):
    """
    Return rays (M, 4) between free pixels of cells (n,) and a background far behind them.

    The columns are x and y at depth 1, depth of the free pixel, and its standard deviation.
    """
    depth, labels, may_take = image
    (height, width), size, count = depth.shape, int(camera[6]), 0
    found = np.empty((4 * len(cells) * size * size, 4))
    for cell in cells:
        top, left = cell // columns * size, cell % columns * size
        for v in range(top, min(top + size, height)):
            for u in range(left, min(left + size, width)):
                z = depth[v, u]
                for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                    y, x = v + down, u + right
                    if not (0 <= y < height and 0 <= x < width):
                        continue
                    step = depth[y, x] - z
                    if not (step > STEEP * z / camera[0] and may_take[labels[v, u]]):
                        continue  # NaN is not a step
                    sigma, behind = noise_at(z, camera)[0], noise_at(depth[y, x], camera)[0]
                    if step > DEVIATIONS * np.hypot(sigma, behind) + STEEP * z / camera[0]:
                        found[count, 0] = (u + right / 2 - camera[2]) / camera[0]
                        found[count, 1] = (v + down / 2 - camera[3]) / camera[1]
                        found[count, 2], found[count, 3] = z, sigma
                        count += 1
    return found[:count].copy()


@kernel('int64[::1](float32[:, ::1], int32[:, ::1], int64, int64)')
def plane_pixels(depth, labels, k, step):
    """Return the pixels of plane k with depth, every step-th row and column."""
    height, width = depth.shape
    found = np.empty(((height - 1) // step + 1) * ((width - 1) // step + 1), np.int64)
    count = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            if labels[v, u] == k and np.isfinite(depth[v, u]):
                found[count] = v * width + u
                count += 1
    return found[:count].copy()


@kernel('UniTuple(float64[:, ::1], 2)(float32[:, ::1], int64[::1], float64[::1])')
def points_of(depth, where, camera):
    """Return points (N, 3) of pixels v * width + u (N,), and their :func:`noise_at` (N, 2)."""
    count, width = len(where), depth.shape[1]
    points, noise = np.empty((count, 3)), np.empty((count, 2))
    for i in range(count):
        v, u = where[i] // width, where[i] % width
        z = depth[v, u]
        points[i, 0] = (u - camera[2]) / camera[0] * z
        points[i, 1] = (v - camera[3]) / camera[1] * z
        points[i, 2] = z
        noise[i, 0], noise[i, 1] = noise_at(z, camera)
    return points, noise


@kernel('uint8[:, ::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), boolean[:, ::1], '
        'UniTuple(int64, 4), float64[::1], float64[::1])')
def pixels_on(image, cells, window, shape, camera):
    """Return which free pixels of cells (R, C) lie on a shape, (h, w) for v0, v1, u0, u1."""
    depth, labels, may_take = image
    v0, v1, u0, u1 = window
    size, turn = int(camera[6]), turn_of(shape)
    result = np.zeros((v1 - v0, u1 - u0), np.uint8)
    for v in range(v0, v1):
        ray_y = (v - camera[3]) / camera[1]
        for u in range(u0, u1):
            z = depth[v, u]
            if np.isfinite(z) and cells[v // size, u // size] and may_take[labels[v, u]]:
                point = (u - camera[2]) / camera[0] * z, ray_y * z, z
                distance, deviation = distance_deviation(shape, turn, point, noise_at(z, camera))
                result[v - v0, u - u0] = abs(distance) < DEVIATIONS * deviation
    return result


@kernel('int64(float32[:, ::1], boolean[:, ::1], float64[::1], UniTuple(float64, 2), '
        'float64[::1])')
def rays_through(depth, cells, shape, ends, camera):
    """Return the number of rays of cells (R, C) that pass through a shape between its ends."""
    through, size = 0, int(camera[6])
    for v in range(0, min(depth.shape[0], cells.shape[0] * size), THROUGH_STEP_PX):
        ray_y = (v - camera[3]) / camera[1]
        for column in range(cells.shape[1]):
            if not cells[v // size, column]:
                continue
            # First pixel of the cell at a multiple of the step from the border of the image.
            first = -(-column * size // THROUGH_STEP_PX) * THROUGH_STEP_PX
            for u in range(first, min((column + 1) * size, depth.shape[1]), THROUGH_STEP_PX):
                z = depth[v, u]
                if np.isfinite(z):
                    met = depth_on_ray(shape, (u - camera[2]) / camera[0], ray_y, *ends)
                    through += z - met > DEVIATIONS * noise_at(z, camera)[0]
    return through
