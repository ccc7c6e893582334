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
