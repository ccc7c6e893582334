# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The planes compete for the cells.

Sequential search gives a cell to the first plane that fits it. Here each cell goes to the plane
that fits it best, and the planes are refitted, as in PEaRL (Isack and Boykov 2012). Iterated
conditional modes (Besag 1986) lower an energy: chi-squared per cell, or the cost of no plane, and
a Potts term.

Under smooth noise this is repeated. Where two planes are closer to each other than the noise, each
cell has joined the plane toward which its error moves it, so regions are ragged. But smooth noise
does not jump. Where there is no step in the depth, the residuals of neighbours differ by the gap
between their planes if a border separates them; where there is a step, they differ unless there is
a border. This is the energy of a Gaussian Markov random field (Rue and Held 2005): chi-squared of
the cells, divided by the number of cells that share their error, and of the differences between
neighbours, with a Potts term. It is lowered for single cells and for connected pieces of regions,
because a piece on the wrong plane changes as a whole or not at all.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    MEAN_WEIGHT,
    Frame,
    PlaneRegions,
    at_borders,
    chi_squared,
    fit_regions,
    residual,
)
from plane_detector.segmentation.cells.noise_correlation import MIN_REGION_CELLS, Correlation
from plane_detector.segmentation.search.ransac import MAX_TRIALS, label_clusters

# Cost of no plane, in squared thresholds.
# tuned: rooms, lived-in rooms and curved scenes below seed 9000; not flat: at noise 0.01 0.06 more
# of curved surfaces have labels at 0.7 times, recall of lived-in rooms -0.024 at 1.4 times.
OUTLIER_COST = 1.6
# Value of the agreement of one neighbour, in units of chi-squared.
# tuned: as above; flat from 0.7 times; at 1.4 times recall of lived-in rooms -0.025 at noise
# 0.004, and 0.04 more of curved surfaces have labels at 0.01.
POTTS_WEIGHT = 1.5
# derived: a cell has one error, but eight neighbours, each pair of which is shared by two cells.
PAIRS_PER_CELL = 4
# chosen: real images take at most 10 sweeps. Rounding of huge misfits must not let them go on.
MOST_SWEEPS = 1000
# derived: with one sample per cluster, a cluster is a connected piece.
CONNECTED = DbscanConfig(eps=1.0, min_samples=1)
# Types of kernels' arguments: planes, table, is_planar of the cells; weights of the three terms.
MODEL = 'Tuple((float64[:, ::1], float64[:, ::1], boolean[::1])), UniTuple(float64, 3)'


def compete_for_cells(frame: Frame, regions: PlaneRegions) -> PlaneRegions:
    """
    Reassign all cells to planes and refit the planes.

    Planes are split into density clusters; pieces far apart become separate planes, and small ones
    are dropped.
    """
    if len(regions.coefficients) == 0:
        return regions
    labels = _compete(regions.labels, at_borders(regions.labels),
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
    without depth follows its neighbours.
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


def reassign_cells(frame: Frame, regions: PlaneRegions,
                   correlation: Correlation | None) -> PlaneRegions:
    """
    Reassign the cells of regions to the planes of their neighbours, and refit the planes.

    The energy of the labels is lowered by single cells and by connected pieces, in turn.

    Parameters
    ----------
    frame : Frame
    regions : PlaneRegions
        On its cells.
    correlation : Correlation or None
        If None, nothing changes.

    Returns
    -------
    PlaneRegions
        Regions that become too small are dropped.

    """
    cells, count = frame.cells, len(regions.coefficients)
    if correlation is None or count < 2:
        return regions
    table = correlation.table
    variance = 2 * (table[0, 0] - table[0, 1])  # of the difference between neighbours
    weights = (table[0, 0] / correlation.density,
               POTTS_WEIGHT / PAIRS_PER_CELL, 1 / (PAIRS_PER_CELL * variance))
    model, labels = (regions.coefficients, cells.table, cells.is_planar), regions.labels.copy()
    single = np.arange(labels.size, dtype=np.int32).reshape(labels.shape)
    for _ in range(MAX_TRIALS):
        changed = np.flatnonzero(at_borders(labels)).astype(np.int32)
        _improve(labels, (single, changed, np.arange(len(changed) + 1)), model, weights)
        if not _improve(labels, label_clusters(labels, CONNECTED), model, weights):
            break
    return fit_regions(cells, labels, count, frame.min_pixels)


@kernel('boolean(int32[:, ::1], Tuple((int32[:, ::1], int32[::1], int64[::1])), '
        f'{MODEL})')
def _improve(labels, units, model, weights):
    """Give each unit of cells the label of lowest energy around it; return whether any changed."""
    (unit, cells, starts), columns, has_changed = units, labels.shape[1], False
    near, is_near = np.empty(len(model[0]), np.int32), np.zeros(len(model[0]), np.bool_)
    for k in range(len(starts) - 1):
        members = cells[starts[k]:starts[k + 1]]
        best = labels[members[0] // columns, members[0] % columns]
        if best < 0 or len(members) > MIN_REGION_CELLS:
            continue
        count, lowest = _find_labels_around(labels, members, best, near, is_near), np.inf
        for m in range(-1 if count else 0, count):
            label = near[m] if m >= 0 else best
            energy = _energy(labels, unit, members, label, model, weights)
            if energy < lowest:
                best, lowest = label, energy
        for i in members:
            has_changed |= labels[i // columns, i % columns] != best
            labels[i // columns, i % columns] = best
    return has_changed


@kernel('int64(int32[:, ::1], int32[::1], int32, int32[::1], boolean[::1])')
def _find_labels_around(labels, members, own, near, is_near):
    """Write the other labels around some cells to near; return how many. All flags stay unset."""
    (rows, columns), count = labels.shape, 0
    for i in members:
        row, column = i // columns, i % columns
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                label = labels[r, c]
                if label >= 0 and label != own and not is_near[label]:
                    near[count], is_near[label] = label, True
                    count += 1
    for k in range(count):
        is_near[near[k]] = False
    return count


@kernel(f'float64(int32[:, ::1], int32[:, ::1], int32[::1], int32, {MODEL})')
def _energy(labels, unit, members, label, model, weights):
    """Return the energy of a unit of cells with a label, given the cells around it."""
    (planes, table, is_planar), (share, border_cost, per_jump) = model, weights
    (rows, columns), energy = labels.shape, 0.0
    for i in members:
        if not is_planar[i]:
            continue
        row, column = i // columns, i % columns
        energy += share * chi_squared(table, i, planes[label, 0], planes[label, 1],
                                      planes[label, 2])
        here = residual(table, i, planes[label, 0], planes[label, 1], planes[label, 2])
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                j, other, pairs = r * columns + c, labels[r, c], 1.0
                if j == i or other < 0 or not is_planar[j]:
                    continue
                if unit[r, c] == unit[row, column]:  # both cells of the pair count it
                    other, pairs = label, 0.5
                jump = here - residual(table, j, planes[other, 0], planes[other, 1],
                                       planes[other, 2])
                energy += pairs * (jump * jump * per_jump + border_cost * (other != label))
    return energy
