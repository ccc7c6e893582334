# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Patches that touch and that the noise cannot tell apart become one plane.

Two patches are one when a joint plane fits both as well as the noise lets it, or when the smaller
one is a bulge of the larger: near its plane and without a step along the border. A step keeps
parallel planes apart, since the smooth part of the noise does not jump from cell to cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.model_selection import are_two

MAX_JOINT_VARIANCES = 2.0
MAX_BULGE_DEVIATIONS = 3.5
MAX_BULGE_STEP_DEVIATIONS = 2.0
MAX_BULGE_SHARE = 0.35
MIN_BORDER_PAIRS = 2
# Cells this far apart still touch: between them may lie cells that straddle the border.
BORDER_REACH_CELLS = 2


@dataclass(frozen=True)
class Borders:
    """
    Pairs of patches that touch, i < j, and the pairs of cells along each border.

    Attributes
    ----------
    first, second : (P,) int
        The patches.
    count : (P,) int
        Pairs of cells.
    pair : (B,) int
        Index of the pair of patches that each pair of cells belongs to.
    cell_first, cell_second : (B,) int
        The cells, on the side of ``first`` and of ``second``.

    """

    first: np.ndarray
    second: np.ndarray
    count: np.ndarray
    pair: np.ndarray
    cell_first: np.ndarray
    cell_second: np.ndarray


def find_borders(labels: np.ndarray, reach: int = BORDER_REACH_CELLS) -> Borders:
    """Find which patches of labels (R, C) touch along rows or columns of cells."""
    near, far = _pairs(labels.shape, reach)
    first, second = (np.concatenate([labels[side].ravel() for side in sides])
                     for sides in _sides(reach))
    touching = np.flatnonzero((first != second) & (np.minimum(first, second) >= 0))
    near, far, first, second = near[touching], far[touching], first[touching], second[touching]
    swap = first > second
    near, far = np.where(swap, far, near), np.where(swap, near, far)
    size = int(labels.max(initial=0)) + 1
    key = np.minimum(first, second).astype(np.int64) * size + np.maximum(first, second)
    count = np.bincount(key, minlength=size**2)
    found = np.flatnonzero(count)
    index = np.zeros(len(count), int)
    index[found] = np.arange(len(found))
    return Borders(*np.divmod(found, size), count[found], index[key], near, far)


@lru_cache(maxsize=8)
def _pairs(shape: tuple[int, int], reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of a grid that are up to ``reach`` apart in a row or column."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    near, far = _sides(reach)
    return (np.concatenate([index[side].ravel() for side in near]),
            np.concatenate([index[side].ravel() for side in far]))


def _sides(reach: int) -> tuple[list, list]:
    """Return the slices of a grid's cells and of those up to ``reach`` right and down of them."""
    gaps = range(1, reach + 1)
    return ([side for gap in gaps for side in (np.s_[:, :-gap], np.s_[:-gap])],
            [side for gap in gaps for side in (np.s_[:, gap:], np.s_[gap:])])


def merge_patches(model: CellModel, patches: Patches, noise: Noise) -> Patches:
    """
    Merge patches, the pairs that fit best first, until no pair fits.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    noise : Noise

    Returns
    -------
    Patches
        Planes refitted to all their cells.

    """
    while len(patches.planes) > 1:
        borders = find_borders(np.where(model.planar.reshape(patches.labels.shape),
                                        patches.labels, -1))
        misfit = _misfit(model, patches, borders)
        chosen = _chosen(model, patches, borders, misfit, Correlation.of(model, patches, noise))
        if not len(chosen):
            return patches
        patches = merged(model, patches, borders.first[chosen], borders.second[chosen])
    return patches


def _chosen(model: CellModel, patches: Patches, borders: Borders, misfit: np.ndarray,
            correlation: Correlation | None) -> np.ndarray:
    """Return the best pairs among those that no seam keeps apart."""
    tested = np.zeros(len(misfit), bool)
    while True:
        chosen = best_pairs(borders, misfit)
        new = chosen[~tested[chosen]]
        apart = new[are_two(model, patches.labels, correlation, borders.first[new],
                            borders.second[new])]
        if not len(apart):
            return chosen
        tested[new], misfit[apart] = True, np.inf


def best_pairs(borders: Borders, misfit: np.ndarray) -> np.ndarray:
    """Return the pairs that fit, best first, no patch twice: a merged one is another one."""
    chosen, used = [], set()
    for k in np.argsort(misfit, kind='stable'):
        if misfit[k] > 1:
            break
        pair = {borders.first[k], borders.second[k]}
        if not pair & used:
            chosen.append(k)
        used |= pair
    return np.array(chosen, int)


def merged(model: CellModel, patches: Patches, kept: np.ndarray, gone: np.ndarray) -> Patches:
    """Return the patches with some of them part of others, pair by pair."""
    count = len(patches.planes)
    target = np.arange(count)
    target[gone] = kept
    left = target == np.arange(count)
    renumbered = (np.cumsum(left) - 1)[target]
    labels = np.append(renumbered, -1)[patches.labels].astype(np.int32)
    planes = patches.planes[left]
    for k in renumbered[kept]:
        members = (labels.ravel() == k) & model.planar
        planes[k] = cells.fit_plane(members.astype(float) @ model.grid.moments)
    return Patches(labels, planes)


@dataclass(frozen=True)
class _Summary:
    """The cells of each patch: moments of their means (K, 10), count and mean variance (K,)."""

    moments: np.ndarray
    count: np.ndarray
    variance: np.ndarray


def memberships(model: CellModel, patches: Patches) -> np.ndarray:
    """Return which flat cells each patch has, 1 or 0, (K, R * C) float64."""
    labels = np.where(model.planar, patches.labels.ravel(), -1)
    return (labels == np.arange(len(patches.planes), dtype=labels.dtype)[:, None]).astype(float)


def _summarise(model: CellModel, patches: Patches) -> _Summary:
    members = memberships(model, patches)
    moments = members @ model.grid.mean_moments
    count = np.maximum(moments[:, cells.N], 1)
    return _Summary(moments, count, (members @ model.variances.mean) / count)


def joint_misfit(model: CellModel, patches: Patches, first: np.ndarray,
                 second: np.ndarray) -> np.ndarray:
    """Return how ill one plane fits both patches of each pair, (P,); up to 1 it fits."""
    return _joint_misfit(_summarise(model, patches), first, second)


def _joint_misfit(summary: _Summary, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    joint = cells.fit_planes(summary.moments[first] + summary.moments[second])
    return np.fmax(*(
        cells.squared_error(joint, summary.moments[side]) / summary.count[side]
        / summary.variance[side] for side in (first, second))) / MAX_JOINT_VARIANCES


def _misfit(model: CellModel, patches: Patches, borders: Borders) -> np.ndarray:
    """Return for each pair of patches how far it is from being one; up to 1 they are one."""
    summary = _summarise(model, patches)
    misfit = np.fmin(_joint_misfit(summary, borders.first, borders.second),
                     _bulge_misfit(model, patches, borders, summary))
    return np.where(borders.count >= MIN_BORDER_PAIRS, misfit, np.inf)


def _bulge_misfit(model: CellModel, patches: Patches, borders: Borders,
                  summary: _Summary) -> np.ndarray:
    """Return the same for the smaller patch as a bulge of the larger one's plane."""
    count, variance = summary.count, summary.variance
    first_larger = count[borders.first] >= count[borders.second]
    large = np.where(first_larger, borders.first, borders.second)
    small = np.where(first_larger, borders.second, borders.first)
    square = cells.squared_error(patches.planes[large], summary.moments[small]) / count[small]
    deviation = np.sqrt(np.maximum(square, 0) / variance[small])
    step = _border_step(model, patches.planes[large], borders) / np.sqrt(variance[large])
    misfit = np.maximum(deviation / MAX_BULGE_DEVIATIONS, step / MAX_BULGE_STEP_DEVIATIONS) ** 2
    return np.where(count[small] <= MAX_BULGE_SHARE * count[large], misfit, np.inf)


def _border_step(model: CellModel, planes: np.ndarray, borders: Borders) -> np.ndarray:
    """Return the mean step (P,) from one side of each border to the other, about its plane."""
    a, b, c = planes[borders.pair].T
    first, second = (d - c - (a * x + b * y) for x, y, d in (
        model.grid.mean[side].T for side in (borders.cell_first, borders.cell_second)))
    total = np.bincount(borders.pair, first - second, minlength=len(borders.count))
    return np.abs(total / np.maximum(borders.count, 1))
