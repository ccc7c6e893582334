# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Several planes or one curved surface.

Noise hides the curve of a single patch, and then a column or a cushion is three or four planes.
But where two patches meet, one quadratic surface has as many parameters as their two planes: it
fits a bend better than they do, and a fold between planes worse. What is bent in measured depth
is no plane; as for steps there are two thresholds (Canny 1986), a clear bend and what it goes on
in. A network bends flat walls: where its depth has a slight bend, the patches are one plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.segmentation.cells.model import MIN_VARIANCE, CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import least_squares, quadratic_products
from plane_detector.segmentation.regions.curvature import MIN_TURN_DEG, TYPICAL_FOCAL_SHARE
from plane_detector.segmentation.regions.merging import (
    Borders,
    best_pairs,
    find_borders,
    memberships,
    merged,
)

# Fewer cells fit any surface.
MIN_CELLS = 4
MIN_BORDER_PAIRS = 2
# Things that are curved: planes that meet at less than the first angle are one plane with a dent,
# at more than the second an edge.
MIN_FOLD_DEG, MAX_FOLD_DEG = 10.0, 70.0
# A curved surface does not jump: so many deviations of a cell from the one plane to the other.
MAX_STEP = 3.0
# One plane fits worse than the curved surface by so many variances of the noise.
MIN_GAIN, MIN_WEAK_GAIN = 1.0, 0.5
# The curved surface may fit one of the patches so many times worse than its plane does, if it
# fits them better together.
MAX_RATIO = 2.0
# Small patches fit their noise: no plane is taken to fit better than these shares of it.
LEAST_SHARE, LEAST_WEAK_SHARE = 0.25, 0.8
# Walls that a network bows: the same for these, where its noise is known. Where the shift of its
# disparity is not, the angle is a rough one.
MAX_BOW_DEG, MAX_BOW_STEP, MAX_BOW_RATIO, LEAST_BOW_SHARE = 35.0, 4.0, 3.0, 0.1


@dataclass(frozen=True)
class _Facets:
    """
    What is known of each patch.

    Attributes
    ----------
    products : (K, 7, 7) float64
        As :func:`plane_detector.segmentation.cells.plane_fit.quadratic_products` gives them.
    noise : (K,) float64
        Squared error that the noise leaves.
    error : (K,) float64
        Squared error of the patch's own plane.

    """

    products: np.ndarray
    noise: np.ndarray
    error: np.ndarray


def find_bent(model: CellModel, patches: Patches, noise: Noise) -> np.ndarray:
    """
    Find patches that a curved surface explains as well as their planes do.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    noise : Noise
        The errors of a network bend walls: where the noise is known from the source nothing is
        found.

    Returns
    -------
    (n,) int
        Indices of the patches.

    """
    if noise.known > 0 or len(patches.planes) < 2:
        return np.zeros(0, int)
    borders = find_borders(patches.labels)
    pairs = _pairs(borders)[_may_be_curved(model, patches, borders, noise)]
    if not len(pairs):
        return np.zeros(0, int)
    facets = _facets(model, patches)
    clear = np.zeros(len(patches.planes), bool)
    bent, goes_on = _judge(facets, _one_hot(pairs, len(clear)))
    clear[pairs[bent].ravel()] = True
    return np.flatnonzero(_spread(clear, pairs[goes_on]))


def join_bowed(model: CellModel, patches: Patches, noise: Noise) -> Patches:
    """
    Join patches that are one wall, bowed by the network whose depth it is.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    noise : Noise
        Where it is not known from the source, depth is measured, and nothing is joined.

    Returns
    -------
    Patches
        Planes refitted to all their cells.

    """
    while noise.known > 0 and len(patches.planes) > 1:
        borders = find_borders(patches.labels)
        misfit = np.full(len(borders.count), np.inf)
        slight = np.flatnonzero(_is_slight(model, patches, borders))
        misfit[slight] = _bow_misfit(model, patches, _pairs(borders)[slight])
        chosen = best_pairs(borders, misfit)
        if not len(chosen):
            break
        patches = merged(model, patches, borders.first[chosen], borders.second[chosen])
    return patches


def _pairs(borders: Borders) -> np.ndarray:
    return np.stack([borders.first, borders.second], axis=1)


def _facets(model: CellModel, patches: Patches) -> _Facets:
    members = memberships(model, patches)
    used = members.any(axis=0)
    members, values = members[:, used], model.grid.mean[used]
    x, y, d = (values - values.mean(axis=0)).T
    products = quadratic_products(members, x, y, d)
    return _Facets(products, members @ model.variances.mean[used], least_squares(products, 3)[0])


def _may_be_curved(model: CellModel, patches: Patches, borders: Borders,
                   noise: Noise) -> np.ndarray:
    """Say which pairs (P,) of patches are large enough and meet in a blunt fold, no step."""
    count = np.bincount(patches.labels[patches.labels >= 0], minlength=len(patches.planes))
    exact = noise.is_exact(model.grid.typical_disparity)
    fold_deg, step = _folds(model, patches, borders)
    return ((np.minimum(count[borders.first], count[borders.second]) >= MIN_CELLS)
            & (borders.count >= MIN_BORDER_PAIRS) & (step < MAX_STEP)
            & (fold_deg > (MIN_TURN_DEG if exact else MIN_FOLD_DEG)) & (fold_deg < MAX_FOLD_DEG))


def _is_slight(model: CellModel, patches: Patches, borders: Borders) -> np.ndarray:
    """Say which pairs (P,) of patches meet in so slight a fold that a network may have made it."""
    fold_deg, step = _folds(model, patches, borders)
    return ((borders.count >= MIN_BORDER_PAIRS) & (step < MAX_BOW_STEP)
            & (fold_deg < MAX_BOW_DEG))


def _folds(model: CellModel, patches: Patches,
           borders: Borders) -> tuple[np.ndarray, np.ndarray]:
    """Return the angle at which the planes of each pair meet and their step there, (P,) each."""
    normals = patches.planes * [TYPICAL_FOCAL_SHARE, TYPICAL_FOCAL_SHARE, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = (normals[borders.first] * normals[borders.second]).sum(axis=1)
    middle = (model.grid.mean[borders.cell_first] + model.grid.mean[borders.cell_second]) / 2
    gap = (patches.planes[borders.first] - patches.planes[borders.second])[borders.pair]
    gap = (gap[:, :2] * middle[:, :2]).sum(axis=1) + gap[:, 2]
    variance = np.maximum(model.variances.mean[borders.cell_first], MIN_VARIANCE)
    total = np.bincount(borders.pair, gap / np.sqrt(variance), len(cosine))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))), np.abs(total) / borders.count


def _one_hot(groups: np.ndarray, count: int) -> np.ndarray:
    """Return groups of patches (G, n) as the members of each, (G, K) bool."""
    return (groups[:, :, None] == np.arange(count)).any(axis=1)


def _judge(facets: _Facets, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit a quadratic surface to each group of patches (G, K).

    Returns
    -------
    bent : (G,) bool
        As well as the planes of the group do, while no single plane fits.
    goes_on : (G,) bool
        The same, less clearly.

    """
    members = groups.astype(float)
    products = _products(facets, groups)
    joint, error = _fit_quadratic(facets, products)
    gain = (least_squares(products, 3)[0] - joint) / (members @ facets.noise)
    own, weak_own = (np.maximum(facets.error, share * facets.noise)
                     for share in (LEAST_SHARE, LEAST_WEAK_SHARE))
    bent = ((gain > MIN_GAIN) & (joint < members @ own)
            & ((error < MAX_RATIO * own) | ~groups).all(axis=1))
    goes_on = (gain > MIN_WEAK_GAIN) & ((error < MAX_RATIO * weak_own) | ~groups).all(axis=1)
    return bent, goes_on


def _products(facets: _Facets, groups: np.ndarray) -> np.ndarray:
    """Return the products (G, 7, 7) of all cells of each group."""
    return np.tensordot(groups.astype(float), facets.products, axes=1)


def _fit_quadratic(facets: _Facets, products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the squared error (G,) of a quadratic surface, and that over each patch (G, K)."""
    joint, surface = least_squares(products, 6)
    surface = np.hstack([surface, -np.ones((len(surface), 1))])
    return joint, np.einsum('gi,kij,gj->gk', surface, facets.products, surface, optimize=True)


def _bow_misfit(model: CellModel, patches: Patches, pairs: np.ndarray) -> np.ndarray:
    """Return how much worse than the planes one curved surface fits, (P,); up to 1 it may."""
    if not len(pairs):
        return np.zeros(0)
    facets, groups = _facets(model, patches), _one_hot(pairs, len(patches.planes))
    own = np.maximum(facets.error, LEAST_BOW_SHARE * facets.noise)
    _, error = _fit_quadratic(facets, _products(facets, groups))
    return np.where(groups, error / own, 0).max(axis=1) / MAX_BOW_RATIO


def _spread(clear: np.ndarray, weak: np.ndarray) -> np.ndarray:
    """Return the clear patches (K,) bool and those that weak pairs (P, 2) link to them."""
    reached = clear.copy()
    while True:
        halfway = weak[reached[weak].sum(axis=1) == 1]
        if not len(halfway):
            return reached
        reached[halfway.ravel()] = True
