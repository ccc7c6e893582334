# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Shapes among the cells that belong to no plane: RANSAC on oriented points.

1. Free cells form components that go on smoothly.
2. In a component, seeds are drawn with partners from a window around them; pairs give spheres and
   cylinders, triples give cones.
3. Hypotheses are scored by the pixels of the cells that agree in distance and in normal.
4. The best one of each kind keeps the cells that are connected with its seed.

References
----------
R. Schnabel, R. Wahl, R. Klein: Efficient RANSAC for Point-Cloud Shape Detection, 2007.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector.config import ShapesConfig
from plane_detector.shapes.hypotheses import (
    TRIES,
    agreeing_cells,
    best_hypothesis,
    draw_samples,
    members_of,
    shapes_of_kind,
)
from plane_detector.shapes.models import ShapeModel
from plane_detector.shapes.patches import curved_patches
from plane_detector.shapes.surfels import Surfels

# after: Schnabel 2007 takes samples from the cells of an octree of random level.
_WINDOWS_CELLS = (2, 4, 8)
# derived: a cone of less is a cylinder within its length, of more a plane with a dent.
_HALF_ANGLES_RAD = (np.radians(4.0), np.radians(70.0))
# derived: with 99 % one of so many samples of three is good if a third of the cells are.
_HYPOTHESES = 120
# Paraboloids are fitted to windows that reach so far, and to all cells at once.
_PATCH_REACHES_CELLS = np.repeat([3, 6, 12, 1000], [8, 8, 8, 1])
# Hypotheses are compared by a sample of the cells.
_SCORED_CELLS = 80
# A kind of shape that explains less than this share of what the best one does is not fitted.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 times, at 1.4 times 11 of 197
# finds less.
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
    Return the best hypotheses among some cells, at most one of each model.

    Parameters
    ----------
    surfels : Surfels
    among : (n,) int
        The cells.
    models : sequence of ShapeModel
    config : ShapesConfig
    rng : numpy.random.Generator
        Draws the samples.

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
    """Return those of some cells that agree with a shape (8,) in distance and in normal."""
    return among[agreeing_cells(shape, surfels.table, among)]


def connected(surfels: Surfels, shape: np.ndarray, agree: np.ndarray, seed: int) -> np.ndarray:
    """Return the cells (R * C,) bool of some that agree (n,), connected with one of them."""
    inside = np.zeros(surfels.shape, bool)
    inside.flat[agree] = True
    return members_of(shape, surfels.table, inside, int(seed))


def _draw(inside: np.ndarray, among: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return triples (H, 3) of different cells: seeds, and others from windows around them."""
    seeds = among[rng.integers(0, len(among), _HYPOTHESES)]
    reach = np.array(_WINDOWS_CELLS)[rng.integers(0, len(_WINDOWS_CELLS), _HYPOTHESES)]
    return draw_samples(inside, seeds, reach, rng.random((_HYPOTHESES, 2 * TRIES, 2)))
