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
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from plane_detector.config import ShapesConfig
from plane_detector.shapes.models import AXIS, HALF_ANGLE, RADIUS, ShapeModel, Surface, surface_of
from plane_detector.shapes.surfels import DEVIATIONS, Surfels

# after: Schnabel 2007 takes samples from the cells of an octree of random level.
_WINDOWS_CELLS = (2, 4, 8)
# derived: a cone of less is a cylinder within its length, of more a plane with a dent.
_HALF_ANGLES_RAD = (np.radians(4.0), np.radians(70.0))
# after: Schnabel 2007 uses 10 to 20 degrees between the normal of a point and of the shape.
_NORMAL_TOLERANCE_RAD = np.radians(15.0)
# derived: the mean of a cell on a ball as wide as four cells lies 1/8 of the cell's side below it.
_CELL_TOLERANCE = 0.125
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


def components_of(free: np.ndarray, links: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the component of each cell (R * C,), -1 for those that are not free."""
    first, second = links
    kept = free[first] & free[second]
    graph = coo_matrix((np.ones(kept.sum(), bool), (first[kept], second[kept])),
                       shape=(free.size, free.size))
    return np.where(free, connected_components(graph, directed=False)[1], -1)


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
    looked_at = among[::-(-len(among) // _SCORED_CELLS)]
    found = [candidate for model in models if (
        candidate := _best_candidate(surfels, among, looked_at, model, config, rng)) is not None]
    most = max((one.score for one in found), default=0.0)
    return [one for one in found if one.score >= _MIN_SCORE_SHARE * most]


def _best_candidate(surfels: Surfels, among: np.ndarray, looked_at: np.ndarray,
                    model: ShapeModel, config: ShapesConfig,
                    rng: np.random.Generator) -> Candidate | None:
    samples = _draw(surfels.shape, among, model.sample_size, _HYPOTHESES, rng)
    shapes = model.from_samples(surfels.points_m[samples], surfels.normals[samples])
    sane = _is_sane(shapes, surfels.points_m[samples[:, 0]], config)
    shapes, seeds = shapes[sane], samples[sane, 0]
    if not len(shapes):
        return None
    agree = agreeing(surfels, surface_of(shapes, surfels.points_m[looked_at]), looked_at)
    best = int((agree @ surfels.count[looked_at]).argmax())
    shape = shapes[best]
    cells = among[agreeing(surfels, surface_of(shape, surfels.points_m[among]), among)]
    members = connected(surfels.shape, cells, seeds[best])
    return Candidate(model, shape, members, float(surfels.count[members].sum()))


def agreeing(surfels: Surfels, surface: Surface, among: np.ndarray) -> np.ndarray:
    """Return which cells (..., n) agree with a surface in distance and in normal."""
    facing = np.abs(np.einsum('...nk,nk->...n', surface.normal, surfels.rays[among]))
    # The mean of a curved cell lies below its surface by up to its sagitta.
    allowed_m = np.hypot(DEVIATIONS * facing * surfels.depth_sigma_m[among],
                         _CELL_TOLERANCE * surfels.width_m[among])
    cosine = np.einsum('...nk,nk->...n', surface.normal, surfels.normals[among])
    turn_rad = _NORMAL_TOLERANCE_RAD + DEVIATIONS * surfels.normal_sigma_rad[among]
    return (np.abs(surface.distance_m) < allowed_m) & (cosine > np.cos(np.minimum(turn_rad, 1.0)))


def connected(shape: tuple[int, int], cells: np.ndarray, seed: int) -> np.ndarray:
    """Return the cells (R * C,) bool that are connected with the seed through others of them."""
    mask = np.zeros(shape[0] * shape[1], np.uint8)
    mask[cells] = 1
    pieces = cv2.connectedComponents(mask.reshape(shape), connectivity=8)[1].ravel()
    return (pieces == pieces[seed]) & (mask > 0)


def _draw(shape: tuple[int, int], among: np.ndarray, size: int, count: int,
          rng: np.random.Generator) -> np.ndarray:
    """Return samples (H, size) of different cells: seeds, and others from windows around them."""
    inside = np.zeros(shape[0] * shape[1], bool)
    inside[among] = True
    seeds = rng.choice(among, count)
    reach = rng.choice(_WINDOWS_CELLS, count)[:, None, None]
    # Several tries each, since windows reach beyond the component.
    steps = rng.integers(-reach, reach + 1, (count, 4 * (size - 1), 2))
    rows, columns = np.divmod(seeds, shape[1])
    at = np.stack([rows, columns], axis=1)[:, None] + steps
    good = ((at >= 0) & (at < shape)).all(axis=2)
    cell = np.where(good, at[..., 0] * shape[1] + at[..., 1], seeds[:, None])
    good = inside[cell] & (cell != seeds[:, None])
    order = np.argsort(~good, axis=1, kind='stable')[:, :size - 1]
    partners = np.take_along_axis(cell, order, axis=1)
    complete = np.take_along_axis(good, order, axis=1).all(axis=1)
    if size > 2:
        complete &= partners[:, 0] != partners[:, 1]
    return np.column_stack([seeds, partners])[complete]


def _is_sane(shapes: np.ndarray, seeds_m: np.ndarray, config: ShapesConfig) -> np.ndarray:
    """Say which hypotheses (H,) are of a size that is looked for."""
    radius, angle = shapes[RADIUS], shapes[HALF_ANGLE]
    is_cone = angle != 0
    along = ((seeds_m - shapes[..., 0:3]) * shapes[AXIS]).sum(axis=1)
    with np.errstate(invalid='ignore'):
        round_ = (radius >= config.min_radius) & (radius <= config.max_radius)
        pointed = ((angle > _HALF_ANGLES_RAD[0]) & (angle < _HALF_ANGLES_RAD[1])
                   & (along * np.tan(angle) <= config.max_radius) & (along > 0))
    return np.isfinite(shapes).all(axis=1) & np.where(is_cone, pointed, round_)
