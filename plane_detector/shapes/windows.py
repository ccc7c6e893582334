# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops over the pixels of cells."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.surface import depth_on_ray, distance_deviation


@kernel('float64[::1](float64[:, ::1], int32[:, ::1], boolean[::1], int64, int64, int64)')
def free_shares(depth, labels, may_take, size, rows, columns):
    """Return the share (rows * columns,) of each cell's pixels that have a depth and are free."""
    share = np.zeros(rows * columns)
    for v in range(min(depth.shape[0], rows * size)):
        for u in range(min(depth.shape[1], columns * size)):
            if np.isfinite(depth[v, u]) and may_take[labels[v, u]]:
                share[v // size * columns + u // size] += 1 / size**2
    return share


@kernel('int64[::1](float64[:, ::1], int32[:, ::1], boolean[:, ::1], int64, int64)')
def label_counts(depth, labels, cells, size, count):
    """Return how many pixels of cells (R, C) have a depth, by label; the last are without."""
    result = np.zeros(count + 1, np.int64)
    for row in range(cells.shape[0]):
        for column in range(cells.shape[1]):
            if cells[row, column]:
                for v in range(row * size, min((row + 1) * size, depth.shape[0])):
                    for u in range(column * size, min((column + 1) * size, depth.shape[1])):
                        if np.isfinite(depth[v, u]):
                            result[labels[v, u]] += 1
    return result


@kernel('int64[::1](float64[:, ::1], int32[:, ::1], boolean[::1], boolean[:, ::1], int64, int64)')
def free_pixels(depth, labels, may_take, cells, size, step):
    """Return every step-th free pixel of cells (R, C) with a depth, as v * width + u, in rows."""
    height, width = depth.shape
    found = np.empty(cells.sum() * size * size // step + 1, np.int64)
    seen = count = 0
    for v in range(min(height, cells.shape[0] * size)):
        for column in range(cells.shape[1]):
            if cells[v // size, column]:
                for u in range(column * size, min((column + 1) * size, width)):
                    if np.isfinite(depth[v, u]) and may_take[labels[v, u]]:
                        if seen % step == 0:
                            found[count] = v * width + u
                            count += 1
                        seen += 1
    return found[:count].copy()


@kernel('int64[::1](float64[:, ::1], int32[:, ::1], int64, int64)')
def plane_pixels(depth, labels, k, step):
    """Return the pixels of plane k that have a depth, every step-th row and column."""
    height, width = depth.shape
    found = np.empty(((height - 1) // step + 1) * ((width - 1) // step + 1), np.int64)
    count = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            if labels[v, u] == k and np.isfinite(depth[v, u]):
                found[count] = v * width + u
                count += 1
    return found[:count].copy()


@kernel('Tuple((float64[:, ::1], float64[:, ::1], float64[::1], float64[::1]))'
        '(float64[:, ::1], int64[::1], float64[::1])')
def points_of(depth, where, camera):
    """
    Return points (N, 3), rays (N, 3), deviations (N,) and sides (N,) of pixels.

    Parameters
    ----------
    depth : (H, W) float64
    where : (N,) int64
        v * W + u.
    camera : (6,) float64
        fx, fy, cx, cy, deviation of 1/depth, least deviation of the depth.

    """
    count, width = len(where), depth.shape[1]
    points, rays = np.empty((count, 3)), np.empty((count, 3))
    sigma, side = np.empty(count), np.empty(count)
    for i in range(count):
        v, u = where[i] // width, where[i] % width
        z = depth[v, u]
        rays[i, 0] = (u - camera[2]) / camera[0]
        rays[i, 1] = (v - camera[3]) / camera[1]
        rays[i, 2] = 1.0
        points[i] = rays[i] * z
        sigma[i] = np.sqrt((camera[4] * z * z) ** 2 + camera[5] ** 2)
        side[i] = z / camera[0]
    return points, rays, sigma, side


@kernel('uint8[:, ::1](float64[:, ::1], int32[:, ::1], boolean[::1], boolean[:, ::1], int64, '
        'UniTuple(int64, 4), float64[::1], float64[::1], float64)')
def pixels_on(depth, labels, may_take, cells, size, window, shape, camera, deviations):
    """Return which free pixels of cells (R, C) lie on a shape, (h, w) of v0, v1, u0, u1."""
    v0, v1, u0, u1 = window
    cosine, sine = np.cos(shape[7]), np.sin(shape[7])
    result = np.zeros((v1 - v0, u1 - u0), np.uint8)
    for v in range(v0, v1):
        ray_y = (v - camera[3]) / camera[1]
        for u in range(u0, u1):
            if not (cells[v // size, u // size] and may_take[labels[v, u]]
                    and np.isfinite(depth[v, u])):
                continue
            z = depth[v, u]
            sigma = np.sqrt((camera[4] * z * z) ** 2 + camera[5] ** 2)
            distance, deviation = distance_deviation(
                shape, cosine, sine, (u - camera[2]) / camera[0], ray_y, z, sigma, z / camera[0])
            result[v - v0, u - u0] = abs(distance) < deviations * deviation
    return result


@kernel('int64(float64[:, ::1], boolean[:, ::1], int64, int64, float64[::1], '
        'UniTuple(float64, 2), float64[::1], float64)')
def rays_through(depth, cells, size, step, shape, ends, camera, deviations):
    """Return how many rays of cells (R, C) go through a shape between its ends."""
    through = 0
    for v in range(0, min(depth.shape[0], cells.shape[0] * size), step):
        ray_y = (v - camera[3]) / camera[1]
        for u in range(0, min(depth.shape[1], cells.shape[1] * size), step):
            z = depth[v, u]
            if not cells[v // size, u // size] or not np.isfinite(z):
                continue
            sigma = np.sqrt((camera[4] * z * z) ** 2 + camera[5] ** 2)
            met = depth_on_ray(shape, (u - camera[2]) / camera[0], ray_y, ends[0], ends[1])
            through += z - met > deviations * sigma
    return through
