# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled: shapes from the curvature of windows of cells.

Under noise the normals of single cells are inaccurate. A paraboloid fitted to the cells of a
window averages the noise: its principal curvatures give the radius of a sphere or a cylinder, and
the direction without curvature is that of the straight lines on a cylinder or cone.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.fitting import solved
from plane_detector.shapes.surface import CONE, SPHERE, frame_of
from plane_detector.shapes.surfels import NORMAL, POINT, RAY

# derived: twice the unknowns of a paraboloid.
_MIN_CELLS = 12
# Half angles of the cones to try, with the apex on either side; the fit refines the angle.
# derived: each angle from 7 to 50 degrees is within a factor 1.5 of one of them.
_CONE_ANGLES_RAD = np.radians(np.array([10.0, 20.0, 35.0]))
CONES_PER_PATCH = 2 * len(_CONE_ANGLES_RAD)


@kernel('float64[:, ::1](float64[:, ::1], boolean[:, ::1], int64[::1], int64[::1])')
def curved_patches(table, inside, seeds, reach):
    """
    Return paraboloids (H, 12): point (3), normal (3), line (3), radii across and along it, seed.

    Parameters
    ----------
    table : (R * C, 13) float64
        Of :class:`Surfels`.
    inside : (R, C) bool
        Cells to use.
    seeds, reach : (H,) int64
        Centre of each window and its half width in cells. A row is NaN if it has too few cells.

    """
    rows, columns = inside.shape
    result, window = np.full((len(seeds), 12), np.nan), np.empty(rows * columns, np.int64)
    for h in range(len(seeds)):
        row, column, count = seeds[h] // columns, seeds[h] % columns, 0
        for v in range(max(row - reach[h], 0), min(row + reach[h] + 1, rows)):
            for u in range(max(column - reach[h], 0), min(column + reach[h] + 1, columns)):
                if inside[v, u]:
                    window[count] = v * columns + u
                    count += 1
        if count >= _MIN_CELLS:
            result[h, :11] = paraboloid(table, window[:count], table[seeds[h], POINT:NORMAL])
            result[h, 11] = seeds[h]
    return result


@kernel('float64[::1](float64[:, ::1], int64[::1], float64[::1])')
def paraboloid(table, cells, middle):
    """Return the paraboloid (11,) fitted to some cells (n,) about a point (3,)."""
    upright, result = np.zeros(8), np.empty(11)
    for i in cells:
        upright[3:6] += table[i, NORMAL:RAY]
    upright[3:6] /= np.sqrt((upright[3:6] ** 2).sum())
    frame = frame_of(upright)
    matrix, vector, row = np.zeros((6, 6)), np.zeros(6), np.ones(6)
    for i in cells:
        height = 0.0
        row[1] = row[2] = 0.0
        for k in range(3):
            apart = table[i, POINT + k] - middle[k]
            row[1] += apart * frame[0, k]
            row[2] += apart * frame[1, k]
            height += apart * frame[2, k]
        row[3], row[4], row[5] = row[1] ** 2 / 2, row[1] * row[2], row[2] ** 2 / 2
        for j in range(6):
            vector[j] += row[j] * height
            for k in range(6):
                matrix[j, k] += row[j] * row[k]
    fit = solved(matrix, vector)
    across = np.arctan2(2 * fit[4], fit[3] - fit[5]) / 2 + np.pi / 2
    mean, half = (fit[3] + fit[5]) / 2, np.hypot((fit[3] - fit[5]) / 2, fit[4])
    steep = np.sqrt(1 + fit[1] ** 2 + fit[2] ** 2)
    for k in range(3):
        result[k] = middle[k] + fit[0] * frame[2, k]
        result[3 + k] = (frame[2, k] - fit[1] * frame[0, k] - fit[2] * frame[1, k]) / steep
        result[6 + k] = np.sin(across) * frame[0, k] - np.cos(across) * frame[1, k]
    result[9], result[10] = 1 / (half - mean), -1 / (half + mean)
    return result


@kernel('float64[::1](int64, float64[::1], int64)')
def shape_of_patch(kind, patch, choice):
    """Return a shape (8,) with the curvature of a patch; ``choice`` is the cone's angle."""
    shape, radius = np.zeros(8), patch[9]
    if kind == SPHERE:
        radius = 2 / (1 / patch[9] + 1 / patch[10])
    for k in range(3):
        point, normal, line = patch[k], patch[3 + k], patch[6 + k]
        if kind == CONE:
            angle, side = _CONE_ANGLES_RAD[choice // 2], 1.0 - 2 * (choice % 2)
            # At distance d from the apex a cone has the radius of curvature d tan(angle).
            shape[k] = point - side * radius / np.tan(angle) * line
            shape[3 + k] = side * np.cos(angle) * line - np.sin(angle) * normal
            shape[7] = angle
        else:
            shape[k] = point - radius * normal
            shape[3 + k] = line if kind != SPHERE else 0.0
            shape[6] = radius
    return shape
