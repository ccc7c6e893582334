# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The planes compete for the cells.

Sequential search gives a cell to the first plane that fits it. Here each cell goes to the plane
that fits it best, and the planes are refitted, as in PEaRL (Isack and Boykov 2012). Iterated
conditional modes (Besag 1986) lower an energy: chi-squared per cell, or the cost of no plane, and
a Potts term.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.labels import at_borders
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    MEAN_WEIGHT,
    Frame,
    PlaneRegions,
    chi_squared,
    fit_regions,
)
from plane_detector.segmentation.search.dbscan import label_clusters

# Cost of no plane, in squared thresholds.
# tuned: rooms, lived-in rooms and curved scenes below seed 9000; not flat: at noise 0.01 0.06 more
# of curved surfaces have labels at 0.7 times, recall of lived-in rooms -0.024 at 1.4 times.
OUTLIER_COST = 1.6
# What one neighbour's agreement is worth, in units of chi-squared.
# tuned: as above; flat from 0.7 times; at 1.4 times recall of lived-in rooms -0.025 at noise
# 0.004, and 0.04 more of curved surfaces have labels at 0.01.
POTTS_WEIGHT = 1.5
# chosen: real images take at most 10 sweeps. Rounding of huge misfits must not let them go on.
MOST_SWEEPS = 1000


def compete_for_cells(frame: Frame, regions: PlaneRegions) -> PlaneRegions:
    """
    Reassign all cells to planes and refit the planes.

    Planes are split into density clusters; pieces far apart become separate planes, and small ones
    are dropped.
    """
    if len(regions.coefficients) == 0:
        return regions
    labels = _compete(regions.labels, at_borders(regions.labels, 1),
                      (regions.coefficients, frame.cells.table), MAX_DEVIATIONS**2)
    clusters, _, starts = label_clusters(labels, frame.config.dbscan)
    return fit_regions(frame.cells, clusters, len(starts) - 1, frame.min_pixels)


@kernel('int32[:, ::1](int32[:, ::1], boolean[:, ::1], UniTuple(float64[:, ::1], 2), float64)')
def _compete(given, is_open, model, threshold2):
    """Change the labels of open cells while that lowers the energy."""
    labels, (rows, columns) = given.copy(), given.shape
    work = np.empty(9, np.int32), np.full(len(model[0]) + 1, -1)
    has_open = np.ones(rows, np.bool_)
    for _ in range(MOST_SWEEPS):
        has_converged = True
        for row in range(rows):
            is_done, has_open[row] = not has_open[row], False
            for column in range(0 if is_done else columns):
                if not is_open[row, column]:
                    continue
                is_open[row, column] = False
                best = _best_label(labels, row, column, work, model, threshold2)
                if best != labels[row, column]:
                    labels[row, column], has_converged = best, False
                    for v in range(max(row - 1, 0), min(row + 2, rows)):
                        has_open[v] = True
                        for u in range(max(column - 1, 0), min(column + 2, columns)):
                            is_open[v, u] = True
        if has_converged:
            break
    return labels


@kernel('int32(int32[:, ::1], int64, int64, Tuple((int32[::1], int64[::1])), '
        'UniTuple(float64[:, ::1], 2), float64)')
def _best_label(labels, row, column, work, model, threshold2):
    """
    Return the label of lowest energy of a cell, given those around it.

    All votes are -1 before and after. A cell whose neighbours all have its label keeps it. A cell
    without depth goes with its neighbours.
    """
    (planes, table), (near, votes), (rows, columns) = model, work, labels.shape
    i, count = row * columns + column, 0
    for down in range(-1, 2):
        r = min(max(row + down, 0), rows - 1)  # the grid's border is replicated
        for right in range(-1, 2):
            label = labels[r, min(max(column + right, 0), columns - 1)]
            if votes[label] < 0:  # no plane is the last
                near[count], votes[label] = label, 0
                count += 1
            votes[label] += 1
    best, lowest = np.int32(-1), OUTLIER_COST * threshold2 if table[i, MEAN_WEIGHT] > 0 else 0.0
    lowest -= POTTS_WEIGHT * max(votes[-1], 0)
    if count == 1:
        best, lowest = near[0], -np.inf
    for k in range(count):
        cost, label = 0.0, near[k]
        if label >= 0:
            cost = chi_squared(table, i, planes[label, 0], planes[label, 1], planes[label, 2])
        cost -= POTTS_WEIGHT * votes[label]
        votes[label] = -1
        if label >= 0 and (cost < lowest or (cost == lowest and (best < 0 or label < best))):
            best, lowest = label, cost
    return best
