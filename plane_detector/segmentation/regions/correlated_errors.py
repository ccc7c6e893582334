# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Reassignment of cells under smooth noise.

Where two planes are closer to each other than the noise, each cell joins the plane that its error
moves it to: regions are ragged. But smooth noise does not jump. Where there is no step in the
depth, the residuals of neighbours differ by the gap between their planes if a border separates
them; where there is one, they differ unless a border is there. This is the energy of a Gaussian
Markov random field (Rue and Held 2005): chi-squared of the cells, divided by the number of cells
that share their error, and of the differences between neighbours, with a Potts term. Iterated
conditional modes (Besag 1986) lower it for single cells and for connected pieces of regions, since
a piece on the wrong plane goes as a whole or not at all.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.config import DbscanConfig
from plane_detector.segmentation.cells.labels import at_borders
from plane_detector.segmentation.cells.model import (
    PlaneRegions,
    chi_squared,
    fit_regions,
    residual,
)
from plane_detector.segmentation.cells.noise_correlation import MIN_REGION_CELLS, Correlation
from plane_detector.segmentation.regions.icm import POTTS_WEIGHT
from plane_detector.segmentation.search.dbscan import clusters_and_cells
from plane_detector.segmentation.search.frame import Frame
from plane_detector.segmentation.search.ransac import MAX_TRIALS

# derived: a cell has one error, but eight neighbours, each pair of which is shared by two cells.
PAIRS_PER_CELL = 4
# derived: with one sample per cluster, a cluster is a connected piece.
CONNECTED = DbscanConfig(eps=1.0, min_samples=1)
# Types of kernels' arguments: planes, table, is_planar of the cells; weights of the three terms.
MODEL = 'Tuple((float64[:, ::1], float64[:, ::1], boolean[::1])), UniTuple(float64, 3)'


def reassign_cells(frame: Frame, regions: PlaneRegions,
                   correlation: Correlation | None) -> PlaneRegions:
    """
    Reassign the cells of regions to the planes of their neighbours, and refit the planes.

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
    labels = _reassign(np.ascontiguousarray(regions.labels),
                       (regions.coefficients, cells.table, cells.is_planar), weights)
    return fit_regions(cells, labels, count, frame.min_pixels)


def _reassign(given: np.ndarray, model: tuple, weights: tuple) -> np.ndarray:
    """Lower the energy of labels by single cells and by pieces, in turn; return the labels."""
    labels, single = given.copy(), np.arange(given.size, dtype=np.int32).reshape(given.shape)
    for _ in range(MAX_TRIALS):
        cells = np.flatnonzero(at_borders(labels, 1)).astype(np.int32)
        _improve(labels, (single, cells, np.arange(len(cells) + 1)), model, weights)
        if not _improve(labels, clusters_and_cells(labels, CONNECTED), model, weights):
            break
    return labels


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
