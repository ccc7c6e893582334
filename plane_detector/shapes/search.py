# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Search for shapes among the cells without a plane: RANSAC on oriented points.

1. In a component of smoothly connected cells, draw seeds with partners from a window around them;
   pairs give spheres and cylinders, triples give cones.
2. Score hypotheses by the pixels of the cells that agree in distance and normal.
3. Reduce the best hypothesis of each kind to the cells that are connected with its seed.

References
----------
R. Schnabel, R. Wahl, R. Klein: Efficient RANSAC for Point-Cloud Shape Detection, 2007.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.shapes.surface import (
    AXIS,
    DEVIATIONS,
    HALF_ANGLE,
    POSITION,
    RADIUS,
    distance_normal,
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
from plane_detector.types import ShapeType

# after: Schnabel 2007, who draws samples from the cells of an octree at a random level. Small
# windows stay on small shapes, in large ones the noise of the normals matters less.
_WINDOWS_CELLS = np.array([2, 4, 8, 16, 32])
# tuned: benchmark shapes --first-seed 100 and 200 --scenes 40; flat to 800, with 300 4 of 390
# fewer are found.
_HYPOTHESES = 400
# Partners drawn for each cell of a sample, since windows extend beyond the component.
_TRIES = 4
# chosen: with a smaller angle it resembles a cylinder, with a larger one a plane with a dent.
_HALF_ANGLES_RAD = (np.radians(4.0), np.radians(70.0))
# chosen: radii of the smallest and the largest sphere or cylinder, and visible part of a cone.
_SMALLEST_M, _LARGEST_M = 0.02, 1.5
# Determinant of three unit normals below which they are coplanar.
_MIN_DETERMINANT = 1e-6
# Hypotheses are compared on a sample of the cells.
_SCORED_CELLS = 80
# A kind of shape is not fitted if it explains less than this share of what the best one explains.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 times, at 1.4 times 11 of 197
# fewer are found.
_MIN_SCORE_SHARE = 0.7


@dataclass(frozen=True)
class Candidate:
    """A shape (8,) of a kind, the cells (R * C,) bool that it was found on, their pixels."""

    type: ShapeType
    shape: np.ndarray
    members: np.ndarray
    score: float


def best_candidates(surfels: Surfels, among: np.ndarray, kinds: Sequence[ShapeType],
                    rng: np.random.Generator) -> list[Candidate]:
    """Return the best hypotheses for some cells (n,) int, at most one per kind."""
    samples = draw_samples(surfels.mask(among), among, rng)
    looked_at = np.ascontiguousarray(among[::-(-len(among) // _SCORED_CELLS)])
    points_m, normals = surfels.points_m[samples], surfels.normals[samples]
    found = []
    for kind in kinds:
        whole = samples[:, 2 if kind == ShapeType.CONE else 1] >= 0
        shapes = shapes_through(kind, points_m, normals)
        sane = np.flatnonzero(whole & _is_sane(shapes, points_m[:, 0]))
        shapes = shapes[sane]
        best = best_hypothesis(shapes, surfels.table, looked_at)
        if best >= 0:
            members = connected(surfels, shapes[best], among, samples[sane[best], 0])
            found.append(Candidate(kind, shapes[best], members,
                                   float(surfels.count[members].sum())))
    most = max((one.score for one in found), default=0.0)
    return [one for one in found if one.score >= _MIN_SCORE_SHARE * most]


def draw_samples(inside: np.ndarray, among: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """
    Return triples (H, 3) of different cells; -1 where no partner was found.

    The cells to draw from are given as a mask (R, C) and by their indices (n,).
    """
    seeds = among[rng.integers(0, len(among), _HYPOTHESES)]
    reach = _WINDOWS_CELLS[rng.integers(0, len(_WINDOWS_CELLS), _HYPOTHESES)]
    chances = rng.random((2, 2 * _TRIES, _HYPOTHESES))
    away = (chances * (2 * reach + 1)).astype(int) - reach
    row, column = away + np.stack(np.divmod(seeds, inside.shape[1]))[:, None]
    is_good = (row >= 0) & (row < inside.shape[0]) & (column >= 0) & (column < inside.shape[1])
    cells = np.where(is_good, row * inside.shape[1] + column, seeds)
    is_good = inside.ravel()[cells] & (cells != seeds)
    samples, every = [seeds], np.arange(_HYPOTHESES)
    for _ in range(2):
        first = is_good.argmax(axis=0)
        partner = np.where(is_good[first, every], cells[first, every], -1)
        samples.append(partner)
        is_good &= cells != partner
    return np.stack(samples, axis=1)


def shapes_through(kind: ShapeType, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the shapes (H, 8) through oriented points (H, 3, 3); NaN where degenerate."""
    shapes = np.zeros((len(points), 8))
    (p, q, _), (n, m, _) = points.swapaxes(0, 1), normals.swapaxes(0, 1)
    with np.errstate(divide='ignore', invalid='ignore'):
        if kind == ShapeType.CONE:
            # The apex is where the planes of the points meet; the sides start there.
            across = np.cross(normals[:, (1, 2, 0)], normals[:, (2, 0, 1)])
            determinant = _dot(n, across[:, 0])
            determinant[np.abs(determinant) < _MIN_DETERMINANT] = np.nan
            apex = np.einsum('hi,hik->hk', _dot(normals, points), across) / determinant[:, None]
            sides = _unit(points - apex[:, None])
            axis = _unit(np.cross(sides[:, 0] - sides[:, 1], sides[:, 0] - sides[:, 2]))
            cosine = _dot(sides[:, 0], axis)
            shapes[POSITION], shapes[AXIS] = apex, axis * np.sign(cosine)[:, None]
            shapes[HALF_ANGLE] = np.arccos(np.minimum(np.abs(cosine), 1.0))
            return shapes
        if kind == ShapeType.CYLINDER:
            shapes[AXIS] = axis = _unit(np.cross(n, m))
            p, q = (point - _dot(point, axis)[:, None] * axis for point in (p, q))
        # The radius for which points minus radius times normals coincide.
        radius = (_dot(p - q, n - m) / _dot(n - m, n - m))[:, None]
        shapes[POSITION] = (p + q - radius * (n + m)) / 2
        shapes[RADIUS] = radius[:, 0]
    return shapes


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products of vectors (..., 3); faster than the sum of a product."""
    return np.einsum('...k,...k->...', a, b)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) of length 1; NaN for zeros."""
    return vectors / np.sqrt(_dot(vectors, vectors))[..., None]


def _is_sane(shapes: np.ndarray, seeds_m: np.ndarray) -> np.ndarray:
    """Return which shapes (H, 8) have an allowed size at their seeds (H, 3); False for NaN."""
    radius_m, angle = shapes[RADIUS], shapes[HALF_ANGLE]
    along_m = _dot(seeds_m - shapes[POSITION], shapes[AXIS])
    low, high = _HALF_ANGLES_RAD
    of_cone = ((angle > low) & (angle < high) & (along_m > 0)
               & (along_m * np.tan(angle) <= _LARGEST_M))
    return of_cone | (radius_m >= _SMALLEST_M) & (radius_m <= _LARGEST_M)


def connected(surfels: Surfels, shape: np.ndarray, among: np.ndarray, seed: int) -> np.ndarray:
    """Return the cells (R * C,) bool that agree with a shape and are connected with the seed."""
    return members_of(shape, surfels.table, surfels.mask(among), int(seed))


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


@kernel('int64[::1](float64[::1], float64[:, ::1], int64[::1])')
def agreeing(shape, table, among):
    """Return those of some cells (n,) of a table that agree with a shape (8,)."""
    turn, is_in = turn_of(shape), np.empty(len(among), np.bool_)
    for i in range(len(among)):
        is_in[i] = agrees(shape, turn, table[among[i]])
    return among[is_in]


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


@kernel('int64(float64[:, ::1], float64[:, ::1], int64[::1])')
def best_hypothesis(shapes, table, among):
    """Return the shape (H, 8) that agrees with most pixels of some cells (n,); -1 for none."""
    best, most, total = -1, 0.0, 0.0
    for i in among:
        total += table[i, COUNT]
    for h in range(len(shapes)):
        turn, score, left = turn_of(shapes[h]), 0.0, total
        for i in among:
            left -= table[i, COUNT]
            if agrees(shapes[h], turn, table[i]):
                score += table[i, COUNT]
            elif score + left <= most:
                break
        if score > most:
            best, most = h, score
    return best
