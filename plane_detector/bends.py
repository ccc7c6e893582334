# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes that are facets of one curved surface, told under noise.

Noise hides the curve of a single patch, and then a column or a cushion is three or four planes.
But where two patches meet, one quadratic surface has as many parameters as their two planes: it
fits a bend better than they do, and a fold between planes worse. As for steps there are two
thresholds (Canny 1986): a clear bend, and what it goes on in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.cells import fit_planes, squared_error
from plane_detector.curvature import MIN_TURN_DEG, TYPICAL_FOCAL_SHARE, least_squares
from plane_detector.measurement import renumber
from plane_detector.merging import Borders, find_borders, memberships
from plane_detector.noise import Noise
from plane_detector.ransac import MIN_VARIANCE, CellModel, Patches

# Fewer cells fit any surface.
MIN_CELLS = 4
MIN_BORDER_PAIRS = 2
# Planes that meet at less than this are one plane with a dent, at more they are an edge.
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


@dataclass(frozen=True)
class _Facets:
    """
    What is known of each patch.

    Attributes
    ----------
    products : (K, 7, 7) float64
        Sums over the cells of the products of two of 1, x, y, xx, xy, yy and the disparity.
    moments : (K, M) float64
        The same as :class:`plane_detector.cells.CellGrid` has them.
    noise : (K,) float64
        Squared error that the noise leaves.
    error : (K,) float64
        Squared error of the patch's own plane.

    """

    products: np.ndarray
    moments: np.ndarray
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
    pairs = np.stack([borders.first, borders.second], axis=1)[
        _may_be_one(model, patches, borders, noise)]
    if not len(pairs):
        return np.zeros(0, int)
    facets = _facets(model, patches)
    touching = np.zeros((len(patches.planes),) * 2, bool)
    touching[pairs[:, 0], pairs[:, 1]] = touching[pairs[:, 1], pairs[:, 0]] = True
    clear = np.zeros(len(touching), bool)
    bent, goes_on = _judge(facets, _one_hot(pairs, len(touching)))
    clear[pairs[bent].ravel()] = True
    triples = _extended(pairs[goes_on], touching)
    clear |= triples[_judge(facets, triples)[0]].any(axis=0)
    return np.flatnonzero(_spread(clear, pairs[goes_on]))


def _facets(model: CellModel, patches: Patches) -> _Facets:
    members = memberships(model, patches)
    used = members.any(axis=0)
    members, values = members[:, used], model.grid.mean[used]
    x, y, d = (values - values.mean(axis=0)).T
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, d], axis=1)
    products = members @ (basis[:, :, None] * basis[:, None, :]).reshape(len(x), -1)
    moments = members @ model.grid.mean_moments[used]
    # Cells in a line have no plane; too few to be judged, they only must not spoil a sum.
    error = np.nan_to_num(squared_error(fit_planes(moments), moments))
    return _Facets(products.reshape(-1, 7, 7), moments, members @ model.variances.mean[used],
                   np.maximum(error, 0))


def _may_be_one(model: CellModel, patches: Patches, borders: Borders,
                noise: Noise) -> np.ndarray:
    """Say which pairs (P,) of patches are large enough and meet in a blunt fold, no step."""
    count = np.bincount(patches.labels[patches.labels >= 0], minlength=len(patches.planes))
    normals = patches.planes * [TYPICAL_FOCAL_SHARE, TYPICAL_FOCAL_SHARE, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = (normals[borders.first] * normals[borders.second]).sum(axis=1)
    middle = (model.grid.mean[borders.cell_first] + model.grid.mean[borders.cell_second]) / 2
    gap = (patches.planes[borders.first] - patches.planes[borders.second])[borders.pair]
    gap = (gap[:, :2] * middle[:, :2]).sum(axis=1) + gap[:, 2]
    variance = np.maximum(model.variances.mean[borders.cell_first], MIN_VARIANCE)
    step = np.abs(np.bincount(borders.pair, gap / np.sqrt(variance), len(cosine))) / borders.count
    exact = noise.is_exact(model.grid.typical_disparity)
    least_deg = MIN_TURN_DEG if exact else MIN_FOLD_DEG
    return ((np.minimum(count[borders.first], count[borders.second]) >= MIN_CELLS)
            & (borders.count >= MIN_BORDER_PAIRS) & (step < MAX_STEP)
            & (cosine < np.cos(np.radians(least_deg)))
            & (cosine > np.cos(np.radians(MAX_FOLD_DEG))))


def _one_hot(groups: np.ndarray, count: int) -> np.ndarray:
    """Return groups of patches (G, n) as the members of each, (G, K) bool."""
    return (groups[:, :, None] == np.arange(count)).any(axis=1)


def _extended(pairs: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """Return the members (G, K) of all groups of a pair and a patch that touches it."""
    pair = _one_hot(pairs, len(touching))
    at, third = np.nonzero(touching[pairs].any(axis=1) & ~pair)
    groups = pair[at]
    groups[np.arange(len(at)), third] = True
    return groups


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
    products = np.tensordot(members, facets.products, axes=1)
    joint, surface = least_squares(products[:, :6, :6], products[:, :6, 6], products[:, 6, 6])
    surface = np.hstack([surface, -np.ones((len(surface), 1))])
    error = np.einsum('gi,kij,gj->gk', surface, facets.products, surface, optimize=True)
    moments, expected = members @ facets.moments, members @ facets.noise
    gain = (squared_error(fit_planes(moments), moments) - joint) / expected
    own, weak_own = (np.maximum(facets.error, share * facets.noise)
                     for share in (LEAST_SHARE, LEAST_WEAK_SHARE))
    bent = ((gain > MIN_GAIN) & (joint < members @ own)
            & ((error < MAX_RATIO * own) | ~groups).all(axis=1))
    goes_on = (gain > MIN_WEAK_GAIN) & ((error < MAX_RATIO * weak_own) | ~groups).all(axis=1)
    return bent, goes_on


def _spread(clear: np.ndarray, weak: np.ndarray) -> np.ndarray:
    """Return the clear patches (K,) bool and those that weak pairs (P, 2) link to them."""
    reached = clear.copy()
    while True:
        halfway = weak[reached[weak].sum(axis=1) == 1]
        if not len(halfway):
            return reached
        reached[halfway.ravel()] = True


def without_bent(labels: np.ndarray, model: CellModel, patches: Patches,
                 noise: Noise) -> tuple[np.ndarray, Patches]:
    """Return labels of pixels (H, W) and patches without those of :func:`find_bent`."""
    count = len(patches.planes)
    kept = np.delete(np.arange(count), find_bent(model, patches, noise))
    left = Patches(renumber(patches.labels, kept, count), patches.planes[kept])
    return renumber(labels, kept, count), left
