# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops over samples: draw cells, fit shapes through them, score the shapes."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.shapes.patches import CONES_PER_PATCH, shape_of_patch
from plane_detector.shapes.surface import (
    CONE,
    DEVIATIONS,
    SPHERE,
    TINY,
    distance_normal,
    turn_of,
)
from plane_detector.shapes.surfels import COUNT, CURVED, MIN_COSINE, NORMAL, POINT, RAY, SIGMA

# Determinant of three unit normals below which they are coplanar.
_MIN_DETERMINANT = 1e-6
# Partners drawn for each cell of a sample, since windows extend beyond the component.
TRIES = 4


@kernel('int64[:, ::1](boolean[:, ::1], int64[::1], int64[::1], float64[:, :, ::1])')
def draw_samples(inside, seeds, reach, chances):
    """
    Return triples (H, 3) of different cells; -1 if no partner was found.

    Parameters
    ----------
    inside : (R, C) bool
        Cells to draw from.
    seeds, reach : (H,) int64
        First cell of each sample, and largest distance of its partners in cells.
    chances : (H, 2 * TRIES, 2) float64
        Uniform random numbers from 0 to 1.

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
    """Return the radius for which points minus radius times normals (2, 3) coincide, or NaN."""
    product = square = 0.0
    for k in range(3):
        turn = normals[0, k] - normals[1, k]
        product += (points[0, k] - points[1, k]) * turn
        square += turn * turn
    return product / square if square > TINY else np.nan


@kernel('float64[::1](float64[:, ::1], float64[:, ::1])')
def sphere_through(points, normals):
    """Return the sphere (8,) through two oriented points (2, 3); NaN if degenerate."""
    shape = np.zeros(8)
    radius = radius_of_pair(points, normals)
    for k in range(3):
        shape[k] = (points[0, k] + points[1, k] - radius * (normals[0, k] + normals[1, k])) / 2
    shape[6] = radius
    return shape


@kernel('float64[::1](float64[::1], float64[::1])')
def unit_cross(a, b):
    """Return the unit vector (3,) perpendicular to two vectors; NaN if they are parallel."""
    result = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                       a[0] * b[1] - a[1] * b[0]])
    length = np.sqrt((result * result).sum())
    return result / (length if length > TINY else np.nan)


@kernel('float64[::1](float64[:, ::1], float64[:, ::1])')
def cylinder_through(points, normals):
    """Return the cylinder (8,) through two oriented points (2, 3); NaN if degenerate."""
    axis, flat = unit_cross(normals[0], normals[1]), np.empty((2, 3))
    for i in range(2):
        flat[i] = points[i] - (points[i] * axis).sum() * axis
    shape = sphere_through(flat, normals)
    shape[3:6] = axis
    return shape


@kernel('float64[::1](float64[:, ::1], float64[:, ::1])')
def apex_of(points, normals):
    """Return the intersection (3,) of the planes of three oriented points (3, 3), or NaN."""
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


@kernel('float64[::1](float64[:, ::1], float64[:, ::1])')
def cone_through(points, normals):
    """Return the cone (8,) through three oriented points (3, 3); NaN if degenerate."""
    apex, sides, shape = apex_of(points, normals), np.empty((3, 3)), np.zeros(8)
    for i in range(3):
        side = points[i] - apex
        length = np.sqrt((side * side).sum())
        sides[i] = side / (length if length > TINY else np.nan)
    axis = unit_cross(sides[0] - sides[1], sides[0] - sides[2])
    cosine = ((sides[0] + sides[1] + sides[2]) * axis).sum() / 3
    shape[0:3] = apex
    shape[3:6] = axis * np.sign(cosine)
    shape[7] = np.arccos(min(abs(cosine), 1.0)) if np.isfinite(cosine) else np.nan
    return shape


@kernel('float64[::1](int64, float64[:, ::1], float64[:, ::1])')
def shape_through(kind, points, normals):
    """Return the shape (8,) of a :class:`ShapeType` through oriented points (2 or 3, 3)."""
    if kind == SPHERE:
        return sphere_through(points, normals)
    return cone_through(points, normals) if kind == CONE else cylinder_through(points, normals)


@kernel('boolean(float64[::1], UniTuple(float64, 2), float64[::1])')
def agrees(shape, turn, cell):
    """Return whether a cell, a row of :attr:`Surfels.table`, agrees in distance and normal."""
    distance, x, y, z = distance_normal(shape, turn, cell[POINT], cell[POINT + 1],
                                        cell[POINT + 2])
    cosine = x * cell[NORMAL] + y * cell[NORMAL + 1] + z * cell[NORMAL + 2]
    if not cosine > cell[MIN_COSINE]:
        return False
    facing = x * cell[RAY] + y * cell[RAY + 1] + z * cell[RAY + 2]
    noise = DEVIATIONS * facing * cell[SIGMA]
    return distance * distance < noise * noise + cell[CURVED] * cell[CURVED]


@kernel('boolean[::1](float64[::1], float64[:, ::1], int64[::1])')
def agreeing_cells(shape, table, among):
    """Return which cells (n,) of a table agree with a shape (8,)."""
    turn, result = turn_of(shape), np.empty(len(among), np.bool_)
    for i in range(len(among)):
        result[i] = agrees(shape, turn, table[among[i]])
    return result


@kernel('boolean[::1](float64[::1], float64[:, ::1], boolean[:, ::1], int64)')
def members_of(shape, table, inside, seed):
    """Return the cells (R * C,) that agree with a shape and are connected with the seed."""
    rows, columns = inside.shape
    turn, found = turn_of(shape), np.zeros(rows * columns, np.bool_)
    stack, top = np.empty(rows * columns, np.int64), 1
    stack[0], found[seed] = seed, True
    while top:
        top -= 1
        row, column = stack[top] // columns, stack[top] % columns
        for v in range(max(row - 1, 0), min(row + 2, rows)):
            for u in range(max(column - 1, 0), min(column + 2, columns)):
                cell = v * columns + u
                if inside[v, u] and not found[cell] and agrees(shape, turn, table[cell]):
                    found[cell], stack[top] = True, cell
                    top += 1
    return found


@kernel('boolean(float64[::1], float64[::1], float64[::1])')
def is_sane(shape, seed, bounds):
    """Return whether radius and half angle of a shape (8,) are within the bounds."""
    for value in shape:
        if not np.isfinite(value):
            return False
    if shape[7] == 0:
        return shape[6] >= bounds[0] and shape[6] <= bounds[1]
    along = ((seed[0] - shape[0]) * shape[3] + (seed[1] - shape[1]) * shape[4]
             + (seed[2] - shape[2]) * shape[5])
    return (shape[7] > bounds[2] and shape[7] < bounds[3] and along > 0
            and along * np.tan(shape[7]) <= bounds[1])


@kernel('float64(float64[::1], float64[:, ::1], int64[::1], float64, float64)')
def score_of(shape, table, among, most, total):
    """Return the number of agreeing pixels of some cells; 0 if it cannot exceed ``most``."""
    turn, score, left = turn_of(shape), 0.0, total
    for i in among:
        left -= table[i, COUNT]
        if agrees(shape, turn, table[i]):
            score += table[i, COUNT]
        elif score + left <= most:
            return 0.0
    return score


@kernel('float64[:, ::1](int64, int64[:, ::1], float64[:, ::1], float64[:, ::1])')
def shapes_of_kind(kind, samples, patches, table):
    """Return the shapes (., 9) from samples (H, 3), then from patches, with a cell of each."""
    points, normals = np.empty((3, 3)), np.empty((3, 3))
    needed, each = (3, CONES_PER_PATCH) if kind == CONE else (2, 1)
    shapes = np.full((len(samples) + each * len(patches), 9), np.nan)
    for h in range(len(samples)):
        if samples[h, needed - 1] >= 0:
            for i in range(needed):
                cell = table[samples[h, i]]
                points[i], normals[i] = cell[POINT:NORMAL], cell[NORMAL:RAY]
            shapes[h, :8], shapes[h, 8] = shape_through(kind, points, normals), samples[h, 0]
    for k in range(each * len(patches)):
        patch = patches[k // each]
        shapes[len(samples) + k, :8] = shape_of_patch(kind, patch, k % each)
        shapes[len(samples) + k, 8] = patch[11]
    return shapes


@kernel('float64[::1](float64[:, ::1], float64[::1], float64[:, ::1], int64[::1])')
def best_hypothesis(shapes, bounds, table, among):
    """
    Return the shape within the bounds that agrees with most pixels, with its cell (9,), or NaN.

    Parameters
    ----------
    shapes : (H, 9) float64
        Each with the index of a cell on it; may be NaN.
    bounds : (4,) float64
        Smallest and largest radius, smallest and largest half angle.
    table : (R * C, 13) float64
        Of :class:`Surfels`.
    among : (n,) int64
        Cells to compare with.

    """
    best, most, total = np.full(9, np.nan), 0.0, 0.0
    for i in among:
        total += table[i, COUNT]
    for h in range(len(shapes)):
        if np.isfinite(shapes[h, 8]) and is_sane(shapes[h, :8], table[int(shapes[h, 8])], bounds):
            score = score_of(shapes[h, :8], table, among, most, total)
            if score > most:
                best, most = shapes[h], score
    return best.copy()
