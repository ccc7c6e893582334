# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Connected components of cells whose local planes continue each other.

On depth with little noise each cell determines its plane, and one pass finds all planes of the
image, however many there are, as in Trevor, Gedikli, Rusu and Christensen, "Efficient Organized
Point Cloud Segmentation with Connected Components" (2013). Under noise cells link across creases;
such a component is not planar and is left to the search by hypotheses.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.plane_fit import fit_plane

# The mean of chi-squared over the cells of a plane is 1; a bent component exceeds it by far.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
MAX_VARIANCES = 3.0


def planar_components(cells: WeightedCells, min_pixels: float, threshold: float) -> PlaneRegions:
    """
    Find the connected components of cells that are planes, largest first.

    Parameters
    ----------
    cells : WeightedCells
    min_pixels : float
        Smallest plane.
    threshold : float
        Neighbours link up to this many standard deviations.

    Returns
    -------
    PlaneRegions

    """
    component, count = _components(cells.table, cells.is_planar, cells.grid.shape[1], threshold)
    pixels = np.bincount(component + 1, cells.grid.moments[:, 0], count + 1)[1:]
    large = np.flatnonzero(pixels >= max(min_pixels, 1))
    large = large[np.argsort(-pixels[large], kind='stable')]
    rank = np.full(count + 1, -1, np.int32)
    rank[large] = np.arange(len(large))
    labels = rank[component]
    planes, is_plane = _planes(cells.table, cells.grid.moments, labels, len(large))
    rank = np.append(np.where(is_plane, np.cumsum(is_plane) - 1, -1), -1).astype(np.int32)
    return PlaneRegions(rank[labels].reshape(cells.grid.shape), planes[is_plane])


@kernel('Tuple((int32[::1], int64))(float64[:, ::1], boolean[::1], int64, float64)')
def _components(table, is_planar, columns, threshold):
    """Return the component of each cell, -1 for cells that are not planar, and their number."""
    component, count = np.full(len(table), np.int32(-1)), 0
    queue = np.empty(len(table), np.int32)
    for seed in range(len(table)):
        if component[seed] >= 0 or not is_planar[seed]:
            continue
        component[seed], queue[0] = count, seed
        head, tail = 0, 1
        while head < tail:
            i = queue[head]
            head += 1
            for j in (i - 1, i + 1, i - columns, i + columns):
                if (j < 0 or j >= len(table) or component[j] >= 0 or not is_planar[j]
                        or (abs(j - i) == 1 and i // columns != j // columns)):
                    continue
                if _is_linked(table, i, j, threshold):
                    component[j], queue[tail] = count, j
                    tail += 1
        count += 1
    return component, count


@kernel('boolean(float64[:, ::1], int64, int64, float64)')
def _is_linked(table, i, j, threshold):
    """Say whether two cells are coplanar: equal slopes and no step half-way between them."""
    step = (table[j, 2] - table[i, 2]
            - (table[i, 3] + table[j, 3]) * (table[j, 0] - table[i, 0]) / 2
            - (table[i, 4] + table[j, 4]) * (table[j, 1] - table[i, 1]) / 2)
    bend = (table[j, 3] - table[i, 3]) ** 2 + (table[j, 4] - table[i, 4]) ** 2
    chi_square = (step * step / (1 / table[i, 5] + 1 / table[j, 5])
                  + bend / (1 / table[i, 6] + 1 / table[j, 6]))
    return chi_square < threshold**2


@kernel('Tuple((float64[:, ::1], boolean[::1]))'
        '(float64[:, ::1], float64[:, ::1], int32[::1], int64)')
def _planes(table, moments, labels, count):
    """Fit planes to components and say which of them are planar."""
    total, planes = np.zeros((count, 10)), np.zeros((count, 3))
    for i in range(len(labels)):
        if labels[i] >= 0:
            total[labels[i]] += moments[i]
    for k in range(count):
        planes[k, 0], planes[k, 1], planes[k, 2] = fit_plane(total[k])
    error, expected = np.zeros(count), np.zeros(count)
    for i in range(len(labels)):
        k = labels[i]
        if k >= 0:
            residual = table[i, 2] - (planes[k, 0] * table[i, 0] + planes[k, 1] * table[i, 1]
                                      + planes[k, 2])
            error[k] += residual * residual
            expected[k] += 1 / table[i, 5]
    return planes, error < MAX_VARIANCES * expected
