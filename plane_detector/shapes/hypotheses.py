# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops over samples: their cells, the shapes through them, how many cells agree."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.surface import TINY, distance_normal

# Below this the determinant of three unit normals says that they lie in a plane.
_MIN_DETERMINANT = 1e-6
# Partners that are tried for each cell of a sample, since windows reach beyond the component.
TRIES = 4


@kernel('int64[:, ::1](boolean[:, ::1], int64[::1], int64[::1], float64[:, :, ::1])')
def draw_samples(inside, seeds, reach, chances):
    """
    Return triples (H, 3) of different cells; -1 where no partner was met.

    Parameters
    ----------
    inside : (R, C) bool
        The cells to draw from.
    seeds, reach : (H,) int64
        First cell of each sample, and how far its partners may be.
    chances : (H, 2 * TRIES, 2) float64
        Even numbers from 0 to 1.

    """
    rows, columns = inside.shape
    samples = np.full((len(seeds), 3), -1)
    for h in range(len(seeds)):
        row, column = seeds[h] // columns, seeds[h] % columns
        samples[h, 0] = seeds[h]
        found = 1
        for k in range(chances.shape[1]):
            v = row + int(np.floor(chances[h, k, 0] * (2 * reach[h] + 1))) - reach[h]
            u = column + int(np.floor(chances[h, k, 1] * (2 * reach[h] + 1))) - reach[h]
            if v < 0 or u < 0 or v >= rows or u >= columns or not inside[v, u]:
                continue
            cell = v * columns + u
            if cell != samples[h, 0] and cell != samples[h, 1]:
                samples[h, found] = cell
                found += 1
                if found == 3:
                    break
    return samples


@kernel('float64(float64[:, ::1], float64[:, ::1])')
def radius_of_pair(points, normals):
    """Return the radius for which points less radius times normals (2, 3) coincide, or NaN."""
    product = square = 0.0
    for k in range(3):
        turn = normals[0, k] - normals[1, k]
        product += (points[0, k] - points[1, k]) * turn
        square += turn * turn
    return product / square if square > TINY else np.nan


@kernel('float64[:, ::1](float64[:, :, ::1], float64[:, :, ::1])')
def spheres(points, normals):
    """Return the spheres (H, 8) through two oriented points (H, 2, 3) each; NaN if degenerate."""
    shapes = np.zeros((len(points), 8))
    for h in range(len(points)):
        radius = radius_of_pair(points[h], normals[h])
        for k in range(3):
            shapes[h, k] = (points[h, 0, k] + points[h, 1, k]
                            - radius * (normals[h, 0, k] + normals[h, 1, k])) / 2
        shapes[h, 6] = radius
    return shapes


@kernel('float64[::1](float64[::1], float64[::1])')
def unit_cross(a, b):
    """Return the unit vector (3,) across two; NaN where they are parallel."""
    result = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                       a[0] * b[1] - a[1] * b[0]])
    length = np.sqrt((result * result).sum())
    return result / (length if length > TINY else np.nan)


@kernel('float64[:, ::1](float64[:, :, ::1], float64[:, :, ::1])')
def cylinders(points, normals):
    """Return the cylinders (H, 8) through two oriented points (H, 2, 3); NaN if degenerate."""
    shapes = np.zeros((len(points), 8))
    flat = np.empty((2, 3))
    for h in range(len(points)):
        axis = unit_cross(normals[h, 0], normals[h, 1])
        for i in range(2):
            along = (points[h, i] * axis).sum()
            flat[i] = points[h, i] - along * axis
        radius = radius_of_pair(flat, normals[h])
        for k in range(3):
            shapes[h, k] = (points[h, 0, k] + points[h, 1, k]
                            - radius * (normals[h, 0, k] + normals[h, 1, k])) / 2
            shapes[h, 3 + k] = axis[k]
        shapes[h, 6] = radius
    return shapes


@kernel('float64[::1](float64[:, ::1], float64[:, ::1])')
def apex_of(points, normals):
    """Return where the planes of three oriented points (3, 3) meet, (3,); NaN if they do not."""
    apex, determinant = np.zeros(3), 0.0
    for i in range(3):
        a, b = normals[(i + 1) % 3], normals[(i + 2) % 3]
        offset = (normals[i] * points[i]).sum()
        across = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
        for k in range(3):
            apex[k] += offset * across[k]
        determinant += (normals[i, 0] * across[0] + normals[i, 1] * across[1]
                        + normals[i, 2] * across[2]) / 3
    return apex / (determinant if abs(determinant) > _MIN_DETERMINANT else np.nan)


@kernel('float64[:, ::1](float64[:, :, ::1], float64[:, :, ::1])')
def cones(points, normals):
    """Return the cones (H, 8) through three oriented points (H, 3, 3) each; NaN if degenerate."""
    shapes = np.zeros((len(points), 8))
    for h in range(len(points)):
        apex = apex_of(points[h], normals[h])
        sides = np.empty((3, 3))
        for i in range(3):
            side = points[h, i] - apex
            length = np.sqrt((side * side).sum())
            sides[i] = side / (length if length > TINY else np.nan)
        axis = unit_cross(sides[0] - sides[1], sides[0] - sides[2])
        cosine = ((sides[0] + sides[1] + sides[2]) * axis).sum() / 3
        shapes[h, 0:3] = apex
        shapes[h, 3:6] = axis * np.sign(cosine)
        shapes[h, 7] = np.arccos(min(abs(cosine), 1.0)) if np.isfinite(cosine) else np.nan
    return shapes


@kernel('boolean(float64[::1], float64, float64, float64[::1], float64)')
def agrees(shape, cosine, sine, cell, deviations):
    """Say whether a cell, a row of :attr:`Surfels.table`, agrees in distance and in normal."""
    distance, x, y, z = distance_normal(shape, cosine, sine, cell[0], cell[1], cell[2])
    if not x * cell[3] + y * cell[4] + z * cell[5] > cell[11]:
        return False
    facing = x * cell[6] + y * cell[7] + z * cell[8]
    noise = deviations * facing * cell[9]
    return distance * distance < noise * noise + cell[10] * cell[10]


@kernel('boolean[::1](float64[::1], float64[:, ::1], int64[::1], float64)')
def agreeing_cells(shape, table, among, deviations):
    """Return which cells (n,) of a table agree with a shape (8,)."""
    cosine, sine = np.cos(shape[7]), np.sin(shape[7])
    result = np.empty(len(among), np.bool_)
    for i in range(len(among)):
        result[i] = agrees(shape, cosine, sine, table[among[i]], deviations)
    return result


@kernel('boolean(float64[::1], float64[::1], float64[::1])')
def is_sane(shape, seed, bounds):
    """Say whether a shape (8,) is of a size that is looked for: radii, half angles."""
    for value in shape:
        if not np.isfinite(value):
            return False
    if shape[7] == 0:
        return shape[6] >= bounds[0] and shape[6] <= bounds[1]
    along = ((seed[0] - shape[0]) * shape[3] + (seed[1] - shape[1]) * shape[4]
             + (seed[2] - shape[2]) * shape[5])
    return (shape[7] > bounds[2] and shape[7] < bounds[3] and along > 0
            and along * np.tan(shape[7]) <= bounds[1])


@kernel('int64(float64[:, ::1], int64[::1], float64[::1], float64[:, ::1], int64[::1], float64)')
def best_hypothesis(shapes, seeds, bounds, table, among, deviations):
    """Return the shape (H, 8) of a sane size with which most pixels agree, or -1."""
    best, most = -1, -1.0
    for h in range(len(shapes)):
        if not is_sane(shapes[h], table[seeds[h]], bounds):
            continue
        cosine, sine = np.cos(shapes[h, 7]), np.sin(shapes[h, 7])
        total = 0.0
        for i in among:
            if agrees(shapes[h], cosine, sine, table[i], deviations):
                total += table[i, 12]
        if total > most:
            best, most = h, total
    return best
