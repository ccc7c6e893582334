# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Merge pieces of one surface that a nearer object separates.

A floor continues behind a box; two tables of one height do not continue over the floor between
them. The depth between two coplanar pieces decides: something nearer than their plane hides its
continuation, something farther shows that it ends.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, has_no_depth
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.adjacency import MAX_DEVIATIONS, joint_misfit, merge
from plane_detector.segmentation.regions.model_selection import prefer_two_planes
from plane_detector.segmentation.regions.normal_agreement import normals_differ

# derived: as many as cells along the longer side of a piece, about.
SIGHT_LINES, SAMPLES_PER_LINE = 24, 24
# Of the cells between two pieces no more than this share may be farther than their plane.
# tuned: on rooms and lived-in rooms of seeds below 9000; compiled in, so its range was not swept.
MAX_SEEN_THROUGH = 0.2


def merge_occluded(cells: WeightedCells, regions: PlaneRegions,
                   correlation: Correlation | None) -> PlaneRegions:
    """
    Merge coplanar regions if hardly any cell between them is farther than their plane.

    Parameters
    ----------
    cells : WeightedCells
    regions : PlaneRegions
    correlation : Correlation or None
        As in :func:`plane_detector.segmentation.regions.merging.merge_adjacent`.

    Returns
    -------
    PlaneRegions

    """
    merged = True
    while merged and len(regions.coefficients) > 1:
        merged = False
        first, second = np.triu_indices(len(regions.coefficients), 1)
        misfit, joint = joint_misfit(cells, regions, first, second)
        misfit[normals_differ(cells, regions, first, second)] = np.inf
        labels = np.ascontiguousarray(regions.labels)
        for k in np.argsort(misfit):
            if misfit[k] > 1:
                break
            i, j = first[k], second[k]
            if (_is_hidden_between(labels, cells.table, cells.is_planar, joint[k],
                                   np.array([i, j]))
                    and not prefer_two_planes(cells, regions.labels, correlation, i, j)):
                regions, merged = merge(cells, regions, first[k:k + 1], second[k:k + 1]), True
                break
    return regions


@kernel('boolean(int32[:, ::1], float64[:, ::1], boolean[::1], float64[::1], int64[::1])')
def _is_hidden_between(labels, table, is_planar, plane, pair):
    """Sample straight lines from cells of one region to the nearest cells of the other."""
    rows, columns = labels.shape
    at, count = np.empty((2, labels.size), np.int64), np.zeros(2, np.int64)
    for i in range(labels.size):
        for side in range(2):
            if labels[i // columns, i % columns] == pair[side]:
                at[side, count[side]] = i
                count[side] += 1
    between, tested, farther = 0, 0, 0
    for line in range(SIGHT_LINES):
        start = at[0, (count[0] - 1) * line // (SIGHT_LINES - 1)]
        end, nearest = 0, 1e18
        for k in range(count[1]):
            i = at[1, k]
            square = (i // columns - start // columns) ** 2 + (i % columns - start % columns) ** 2
            if square < nearest:
                end, nearest = i, square
        for sample in range(SAMPLES_PER_LINE):
            t = sample / (SAMPLES_PER_LINE - 1)
            row = int(np.rint(start // columns + t * (end // columns - start // columns)))
            column = int(np.rint(start % columns + t * (end % columns - start % columns)))
            i, label = row * columns + column, labels[row, column]
            if label == pair[0] or label == pair[1] or has_no_depth(table, i):
                continue
            between += 1
            if is_planar[i]:  # a cell that straddles an edge is neither nearer nor farther
                tested += 1
                expected = plane[0] * table[i, 0] + plane[1] * table[i, 1] + plane[2]
                farther += expected - table[i, 2] > MAX_DEVIATIONS / np.sqrt(table[i, 5])
    return between > 0 and farther <= MAX_SEEN_THROUGH * tested
