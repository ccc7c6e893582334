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

import cv2
import numpy as np

from plane_detector.config import ShapesConfig
from plane_detector.shapes.hypotheses import (
    TRIES,
    agreeing_cells,
    best_hypothesis,
    draw_samples,
)
from plane_detector.shapes.models import ShapeModel
from plane_detector.shapes.surfels import Surfels

# after: Schnabel 2007 takes samples from the cells of an octree of random level.
_WINDOWS_CELLS = (2, 4, 8)
# derived: a cone of less is a cylinder within its length, of more a plane with a dent.
_HALF_ANGLES_RAD = (np.radians(4.0), np.radians(70.0))
# derived: with 99 % one of so many samples of three is good if a third of the cells are.
_HYPOTHESES = 120
# Hypotheses are compared by a sample of the cells.
_SCORED_CELLS = 120
# A kind of shape that explains less than this share of what the best one does is not fitted.
# tuned: benchmark shapes --first-seed 100 --scenes 10; flat from 0.7 to 1.4 times.
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
    looked_at = np.ascontiguousarray(among[::-(-len(among) // _SCORED_CELLS)])
    samples = _draw(surfels.shape, among, _HYPOTHESES, rng)
    bounds = np.array([config.min_radius, config.max_radius, *_HALF_ANGLES_RAD])
    found = [candidate for model in models if (
        candidate := _best_candidate(surfels, among, looked_at, model, samples, bounds))]
    most = max((one.score for one in found), default=0.0)
    return [one for one in found if one.score >= _MIN_SCORE_SHARE * most]


def _best_candidate(surfels: Surfels, among: np.ndarray, looked_at: np.ndarray, model: ShapeModel,
                    samples: np.ndarray, bounds: np.ndarray) -> Candidate | None:
    shape, best = best_hypothesis(int(model.type), samples, bounds, surfels.table, looked_at)
    if best < 0:
        return None
    members = connected(surfels.shape, agreeing(surfels, shape, among), samples[best, 0])
    return Candidate(model, shape, members, float(surfels.count[members].sum()))


def agreeing(surfels: Surfels, shape: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Return those of some cells that agree with a shape (8,) in distance and in normal."""
    return among[agreeing_cells(shape, surfels.table, among)]


def connected(shape: tuple[int, int], cells: np.ndarray, seed: int) -> np.ndarray:
    """Return the cells (R * C,) bool that are connected with the seed through others of them."""
    mask = np.zeros(shape[0] * shape[1], np.uint8)
    mask[cells] = 1
    pieces = cv2.connectedComponents(mask.reshape(shape), connectivity=8)[1].ravel()
    return (pieces == pieces[seed]) & (mask > 0)


def _draw(shape: tuple[int, int], among: np.ndarray, count: int,
          rng: np.random.Generator) -> np.ndarray:
    """Return triples (H, 3) of different cells: seeds, and others from windows around them."""
    inside = np.zeros(shape[0] * shape[1], bool)
    inside[among] = True
    seeds = among[rng.integers(0, len(among), count)]
    reach = np.array(_WINDOWS_CELLS)[rng.integers(0, len(_WINDOWS_CELLS), count)]
    return draw_samples(inside.reshape(shape), seeds, reach, rng.random((count, 2 * TRIES, 2)))
