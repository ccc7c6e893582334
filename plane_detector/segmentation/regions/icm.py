# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
All planes compete for all cells, with a Potts prior.

Sequential search gives a cell to the first plane that fits it. Here each cell goes to the plane
that fits it best, and the planes are refitted, as in PEaRL (Isack and Boykov 2012). Iterated
conditional modes (Besag 1986) lower the energy: a truncated chi-squared per cell and a Potts term.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells.model import (
    PlaneRegions,
    WeightedCells,
    chi_squared,
    fit_regions,
)
from plane_detector.segmentation.regions.adjacency import BORDER_REACH_CELLS as REACH_CELLS
from plane_detector.segmentation.search.dbscan import label_clusters, neighbourhood

# derived: later sweeps change next to no cell.
SWEEPS = 4
# The misfit is truncated at this many squared thresholds.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
TRUNCATION = 3.0
# Cost of no plane, in squared thresholds.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
OUTLIER_COST = 1.6
# What one neighbour's agreement is worth, in units of chi-squared.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
POTTS_WEIGHT = 1.5


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
    around, square = regions.labels.astype(np.int16), np.ones((2 * REACH_CELLS + 1,) * 2, np.uint8)
    is_open = cv2.dilate(around, square) != cv2.erode(around, square)
    labels, model = np.ascontiguousarray(regions.labels, np.int32), (
        regions.coefficients, cells.table, cells.is_planar)
    for _ in range(SWEEPS):
        labels, is_open = _sweep(labels, is_open, model, threshold**2)
    clusters, count = label_clusters(labels, neighbourhood(dbscan))
    return fit_regions(cells, clusters, count, min_pixels)


@kernel('Tuple((int32[:, ::1], boolean[:, ::1]))(int32[:, ::1], boolean[:, ::1], '
        'Tuple((float64[:, ::1], float64[:, ::1], boolean[::1])), float64)')
def _sweep(labels, is_open, model, threshold2):
    """Choose the labels of the open cells; return all and the cells around those that changed."""
    (rows, columns), near = labels.shape, np.empty((2 * REACH_CELLS + 1) ** 2, np.int32)
    chosen, is_next = labels.copy(), np.zeros(labels.shape, np.bool_)
    for row in range(rows):
        for column in range(columns):
            if not is_open[row, column]:
                continue
            best = _best_label(labels, row, column, near, model, threshold2)
            if best != labels[row, column]:
                chosen[row, column] = best
                is_next[max(row - REACH_CELLS, 0):row + REACH_CELLS + 1,
                        max(column - REACH_CELLS, 0):column + REACH_CELLS + 1] = True
    return chosen, is_next


@kernel('int32(int32[:, ::1], int64, int64, int32[::1], '
        'Tuple((float64[:, ::1], float64[:, ::1], boolean[::1])), float64)')
def _best_label(labels, row, column, near, model, threshold2):
    """Return the label of lowest energy of a cell, given the others."""
    (planes, table, is_planar), (rows, columns) = model, labels.shape
    i, count = row * columns + column, 0
    for r in range(max(row - REACH_CELLS, 0), min(row + REACH_CELLS + 1, rows)):
        for c in range(max(column - REACH_CELLS, 0), min(column + REACH_CELLS + 1, columns)):
            label, is_known = labels[r, c], labels[r, c] < 0
            for k in range(count):
                is_known |= near[k] == label
            if not is_known:
                near[count] = label
                count += 1
    best, lowest = np.int32(-1), OUTLIER_COST * threshold2 if is_planar[i] else 0.0
    lowest -= POTTS_WEIGHT * _votes(labels, row, column, -1)
    for k in range(count):
        cost, label = 0.0, near[k]
        if is_planar[i]:  # a cell on an edge has no data term: its neighbours decide
            cost = min(chi_squared(table, i, planes[label, 0], planes[label, 1],
                                   planes[label, 2]), TRUNCATION * threshold2)
        cost -= POTTS_WEIGHT * _votes(labels, row, column, label)
        if cost < lowest or (cost == lowest and (best < 0 or label < best)):
            best, lowest = label, cost
    return best


@kernel('int64(int32[:, ::1], int64, int64, int64)')
def _votes(labels, row, column, label):
    """Count a label in the 3 x 3 cells around one; the grid's border is replicated."""
    rows, columns = labels.shape
    votes = 0
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            votes += labels[min(max(r, 0), rows - 1), min(max(c, 0), columns - 1)] == label
    return votes
