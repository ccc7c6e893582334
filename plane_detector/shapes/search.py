# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Search for shapes among the cells without a plane: RANSAC on oriented points.

1. Group the free cells into smoothly connected components.
2. In a component, draw seeds with partners from a window around them; pairs give spheres and
   cylinders, triples give cones.
3. Score hypotheses by the pixels of the cells that agree in distance and normal.
4. Reduce the best hypothesis of each kind to the cells that are connected with its seed.

References
----------
R. Schnabel, R. Wahl, R. Klein: Efficient RANSAC for Point-Cloud Shape Detection, 2007.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import ShapesConfig
from plane_detector.shapes.fitting import solved
from plane_detector.shapes.models import ShapeModel
from plane_detector.shapes.surface import (
    CONE,
    DEVIATIONS,
    SPHERE,
    TINY,
    distance_normal,
    frame_of,
    turn_of,
)
from plane_detector.shapes.surfels import (
    COUNT,
    CURVED,
    MIN_COSINE,
    NORMAL,
    POINT,
    RAY,
    SIGMA,
    Surfels,
)

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


# after: Schnabel 2007, who draws samples from the cells of an octree at a random level.
_WINDOWS_CELLS = (2, 4, 8)
# derived: with a smaller angle it resembles a cylinder, with a larger one a plane with a dent.
_HALF_ANGLES_RAD = (np.radians(4.0), np.radians(70.0))
# derived: if a third of the cells are inliers, one sample of three is correct with 99 %.
_HYPOTHESES = 120
# Paraboloids are fitted to windows with these half widths, and to all cells at once.
_PATCH_REACHES_CELLS = np.repeat([3, 6, 12, 1000], [8, 8, 8, 1])
# Hypotheses are compared on a sample of the cells.
_SCORED_CELLS = 80
# A kind of shape is not fitted if it explains less than this share of what the best one explains.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 times, at 1.4 times 11 of 197
# fewer are found.
_MIN_SCORE_SHARE = 0.7


@dataclass(frozen=True)
class Candidate:
    """A shape (8,) of a model, the cells (R * C,) bool that it was found on, their pixels."""

    model: ShapeModel
    shape: np.ndarray
    members: np.ndarray
    score: float


def best_candidates(surfels: Surfels, among: np.ndarray, models: Sequence[ShapeModel],
                    config: ShapesConfig, rng: np.random.Generator) -> list[Candidate]:
    """
    Return the best hypotheses for some cells, at most one per model.

    Parameters
    ----------
    surfels : Surfels
    among : (n,) int
        The cells.
    models : sequence of ShapeModel
    config : ShapesConfig
    rng : numpy.random.Generator
        For the samples.

    """
    inside = np.zeros(surfels.shape, bool)
    inside.flat[among] = True
    samples, patches = _draw(inside, among, rng), _patches(surfels, inside, among, rng)
    bounds = np.array([config.min_radius, config.max_radius, *_HALF_ANGLES_RAD])
    looked_at = np.ascontiguousarray(among[::-(-len(among) // _SCORED_CELLS)])
    found = []
    for model in models:
        shapes = shapes_of_kind(int(model.type), samples, patches, surfels.table)
        best = best_hypothesis(shapes, bounds, surfels.table, looked_at)
        if np.isfinite(best[8]):
            members = members_of(best[:8], surfels.table, inside, int(best[8]))
            found.append(Candidate(model, best[:8], members,
                                   float(surfels.count[members].sum())))
    most = max((one.score for one in found), default=0.0)
    return [one for one in found if one.score >= _MIN_SCORE_SHARE * most]


def _patches(surfels: Surfels, inside: np.ndarray, among: np.ndarray,
             rng: np.random.Generator) -> np.ndarray:
    seeds = among[rng.integers(0, len(among), len(_PATCH_REACHES_CELLS))]
    return curved_patches(surfels.table, inside, seeds, _PATCH_REACHES_CELLS)


def agreeing(surfels: Surfels, shape: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Return those of some cells that agree with a shape (8,) in distance and normal."""
    return among[agreeing_cells(shape, surfels.table, among)]


def connected(surfels: Surfels, shape: np.ndarray, agree: np.ndarray, seed: int) -> np.ndarray:
    """Return the agreeing cells (n,) that are connected with one another, (R * C,) bool."""
    inside = np.zeros(surfels.shape, bool)
    inside.flat[agree] = True
    return members_of(shape, surfels.table, inside, int(seed))


def _draw(inside: np.ndarray, among: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return triples (H, 3) of different cells: seeds, and partners from windows around them."""
    seeds = among[rng.integers(0, len(among), _HYPOTHESES)]
    reach = np.array(_WINDOWS_CELLS)[rng.integers(0, len(_WINDOWS_CELLS), _HYPOTHESES)]
    return draw_samples(inside, seeds, reach, rng.random((_HYPOTHESES, 2 * TRIES, 2)))
