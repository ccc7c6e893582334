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
from plane_detector.segmentation.regions.merging import find_borders

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
    borders = find_borders(patches.labels, REACH_CELLS)
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


def _at_cells(model: CellModel, planes: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Return the value of each plane (n, 3) at its cell (n,)."""
    (x, y, _), (a, b, c) = model.grid.mean[cell].T, planes.T
    return c + (a * x + b * y)
