# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
All planes compete for all cells, with a Potts prior.

Sequential search gives a cell to the first plane that fits it. Here each cell goes to the plane
that fits it best, and the planes are refitted, as in PEaRL (Isack and Boykov 2012). Iterated
conditional modes (Besag 1986) lower the energy: a truncated chi-squared per cell and a Potts term.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells.model import (
    PlaneRegions,
    WeightedCells,
    chi_squared,
    fit_regions,
)
from plane_detector.segmentation.search.dbscan import label_clusters, neighbourhood

# derived: with no more than this share of the cells changing, another sweep changes next to none.
SWEEPS, SETTLED_SHARE = 4, 0.004
# The misfit is truncated at this many squared thresholds.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
TRUNCATION = 3.0
# Cost of no plane, in squared thresholds.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
OUTLIER_COST = 1.6
# What one neighbour's agreement is worth, in units of chi-squared.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
POTTS_WEIGHT = 1.5
# A plane competes for cells up to this many cells away from its own.
REACH_CELLS = 2


def compete_for_cells(cells: WeightedCells, regions: PlaneRegions, threshold: float,
                      min_pixels: float, dbscan: DbscanConfig) -> PlaneRegions:
    """
    Reassign all cells to planes and refit the planes.

    Parameters
    ----------
    cells : WeightedCells
    regions : PlaneRegions
    threshold : float
        Inlier threshold in standard deviations.
    min_pixels : float
        Smaller clusters are dropped.
    dbscan : DbscanConfig
        Splits planes into clusters; pieces far apart become separate planes.

    Returns
    -------
    PlaneRegions

    """
    if len(regions.coefficients) == 0:
        return regions
    labels = np.ascontiguousarray(regions.labels, np.int32)
    for _ in range(SWEEPS):
        labels, changed = _sweep(labels, regions.coefficients, cells.table, cells.is_planar,
                                 threshold**2)
        if changed <= SETTLED_SHARE * labels.size:
            break
    clusters, count = label_clusters(labels, neighbourhood(dbscan))
    return fit_regions(cells, clusters, count, min_pixels)


@kernel('Tuple((int32[:, ::1], int64))(int32[:, ::1], float64[:, ::1], float64[:, ::1], '
        'boolean[::1], float64)')
def _sweep(labels, planes, table, is_planar, threshold2):
    """Return the label of lowest energy of each cell, given the others, and how many changed."""
    rows, columns = labels.shape
    updated, changed = labels.copy(), 0
    near = np.empty((2 * REACH_CELLS + 1) ** 2, np.int32)
    for i in range(labels.size):
        row, column = i // columns, i % columns
        count = 0
        for r in range(max(row - REACH_CELLS, 0), min(row + REACH_CELLS + 1, rows)):
            for c in range(max(column - REACH_CELLS, 0), min(column + REACH_CELLS + 1, columns)):
                label, known = labels[r, c], labels[r, c] < 0
                for k in range(count):
                    known |= near[k] == label
                if not known:
                    near[count] = label
                    count += 1
        if count == 0:
            continue
        best, lowest = -1, OUTLIER_COST * threshold2 if is_planar[i] else 0.0
        lowest -= POTTS_WEIGHT * _votes(labels, row, column, -1)
        for k in range(count):
            cost, label = 0.0, near[k]
            if is_planar[i]:  # a cell on an edge has no data term: its neighbours decide
                cost = min(chi_squared(table, i, planes[label, 0], planes[label, 1],
                                       planes[label, 2]), TRUNCATION * threshold2)
            cost -= POTTS_WEIGHT * _votes(labels, row, column, label)
            if cost < lowest or (cost == lowest and (best < 0 or label < best)):
                best, lowest = label, cost
        if best != labels[row, column]:
            updated[row, column] = best
            changed += 1
    return updated, changed


@kernel('int64(int32[:, ::1], int64, int64, int64)')
def _votes(labels, row, column, label):
    """Count a label in the 3 x 3 cells around one; the grid's border is replicated."""
    rows, columns = labels.shape
    votes = 0
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            votes += labels[min(max(r, 0), rows - 1), min(max(c, 0), columns - 1)] == label
    return votes
