# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Pieces of one surface that something nearer cuts apart become one plane again.

A floor goes on behind a box; two tables of one height do not go on over the floor between them.
What tells these apart is what the camera sees between two coplanar pieces: something nearer than
their plane hides how it goes on, something farther shows that it ends.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.merging import joint_misfit, merged
from plane_detector.segmentation.regions.model_selection import are_two

SIGHT_LINES = 24
SAMPLES_PER_LINE = 24
FARTHER_DEVIATIONS = 3.0
# Of the cells between two pieces no more than this share may be farther than their plane.
MAX_SEEN_THROUGH = 0.2


def join_hidden(model: CellModel, patches: Patches, noise: Noise) -> Patches:
    """
    Join coplanar patches where next to nothing between them is farther than their plane.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    noise : Noise

    Returns
    -------
    Patches

    """
    joined = True
    while joined and len(patches.planes) > 1:
        joined = False
        first, second = np.array(list(combinations(range(len(patches.planes)), 2))).T
        misfit = joint_misfit(model, patches, first, second)
        for k in np.argsort(misfit):
            if misfit[k] > 1:
                break
            pair = first[k:k + 1], second[k:k + 1]
            if (_is_hidden_between(model, patches, first[k], second[k]) and not are_two(
                    model, patches.labels, Correlation.of(model, patches, noise), *pair)[0]):
                patches, joined = merged(model, patches, *pair), True
                break
    return patches


def _is_hidden_between(model: CellModel, patches: Patches, first: int, second: int) -> bool:
    """Look along straight lines from cells of one patch to the nearest ones of the other."""
    at_first, at_second = (np.argwhere(patches.labels == k) for k in (first, second))
    start = at_first[np.linspace(0, len(at_first) - 1, SIGHT_LINES).astype(int)]
    end = _nearest(start, at_second)
    t = np.linspace(0, 1, SAMPLES_PER_LINE)[:, None, None]
    between = np.rint(start + t * (end - start)).astype(int).reshape(-1, 2)
    cell = np.ravel_multi_index(between.T, patches.labels.shape)
    label = patches.labels.ravel()[cell]
    cell = cell[(label != first) & (label != second) & (model.grid.moments[cell, cells.N] > 0)]
    if not len(cell):
        return False
    # A cell that straddles an edge is neither nearer nor farther.
    cell = cell[model.planar[cell]]
    if not len(cell):
        return True
    x, y, d = model.grid.mean[cell].T
    labels = patches.labels.ravel()
    members = ((labels == first) | (labels == second)) & model.planar
    a, b, c = cells.fit_plane(members.astype(float) @ model.grid.moments)
    farther = (a * x + b * y + c) - d > FARTHER_DEVIATIONS * np.sqrt(model.variances.mean[cell])
    return bool(farther.mean() <= MAX_SEEN_THROUGH)


def _nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return for each point (n, 2) the nearest of the others (m, 2)."""
    square = ((points[:, None] - others[None]) ** 2).sum(axis=2)
    return others[square.argmin(axis=1)]
