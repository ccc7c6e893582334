# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Where two planes meet in a crease, geometry draws the border and not the noise.

Close to the line in which two planes cut each other both fit alike, and residuals only say what
the noise says. But on one side of the line the one plane is what the camera sees, on the other
side the other one.
"""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.regions.merging import Borders, find_borders

REACH_CELLS = 3


def find_creases(model: CellModel, patches: Patches) -> np.ndarray:
    """
    Find the pairs of touching patches whose planes cut each other along their border.

    Returns
    -------
    (K, K) int8
        Entry i, j is the sign of plane i less plane j, as 1/z, where i is seen; 0: no crease,
        one is in front of the other or they do not touch.

    """
    return _signs(model, patches, find_borders(patches.labels, REACH_CELLS))


def _signs(model: CellModel, patches: Patches, borders: Borders) -> np.ndarray:
    """Return what :func:`find_creases` does, given the borders."""
    signs = np.zeros((len(patches.planes),) * 2, np.int8)
    if not len(borders.first):
        return signs
    difference = patches.planes[borders.first] - patches.planes[borders.second]
    sides = [np.bincount(borders.pair, _at_cells(model, difference[borders.pair], cell))
             for cell in (borders.cell_first, borders.cell_second)]
    crease = sides[0] * sides[1] < 0
    first, second = borders.first[crease], borders.second[crease]
    signs[first, second] = np.sign(sides[0][crease])
    signs[second, first] = -np.sign(sides[1][crease])
    return signs


def straighten(model: CellModel, patches: Patches, threshold: float) -> Patches:
    """Give the cells along creases, where both planes fit, to the plane of their side."""
    borders, labels = find_borders(patches.labels, REACH_CELLS), patches.labels.ravel().copy()
    signs = _signs(model, patches, borders)
    first, second = borders.first[borders.pair], borders.second[borders.pair]
    for own, other, cell in ((first, second, borders.cell_first),
                             (second, first, borders.cell_second)):
        difference = _at_cells(model, patches.planes[own] - patches.planes[other], cell)
        unclear = np.abs(difference) < threshold * np.sqrt(model.variances.mean[cell])
        wrong = unclear & (signs[own, other] * difference < 0)
        labels[cell[wrong]] = other[wrong]
    return Patches(labels.reshape(patches.labels.shape), patches.planes)


def _at_cells(model: CellModel, planes: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Return the value of each plane (n, 3) at its cell (n,)."""
    (x, y, _), (a, b, c) = model.grid.mean[cell].T, planes.T
    return c + (a * x + b * y)
