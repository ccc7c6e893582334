# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The noise, estimated from the residuals of the largest planes.

Differences between neighbouring cells miss noise that is smooth over several cells, and count
clutter as noise. The residuals of the largest planes do neither.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import Noise

# A small plane fits the noise itself, and its residuals are too small.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MIN_CELLS = 100
# derived: the median of so many samples is good to 4 %.
MAX_SAMPLES = 1500
# derived: planes are the same when the noise changes by less.
TOLERANCE = 0.1


def noise_from_planes(cells: WeightedCells, regions: PlaneRegions, noise: Noise) -> Noise:
    """
    Estimate the noise from the cells of the given planes, by median absolute deviation.

    Parameters
    ----------
    cells : WeightedCells
    regions : PlaneRegions
        The largest planes; small ones are ignored.
    noise : Noise
        The noise that the planes were found with.

    Returns
    -------
    Noise
        The given noise if all planes are too small.

    """
    members = _members(np.ascontiguousarray(regions.labels).reshape(-1),
                       len(regions.coefficients))
    if not len(members):
        return noise
    residual, tilt = _deviations(members, np.ascontiguousarray(regions.labels).reshape(-1),
                                 regions.coefficients, cells.table)
    return noise.from_cells((SIGMA_PER_MEDIAN * median(residual), SIGMA_PER_MEDIAN * median(tilt),
                             median(cells.grid.inner_rms[members])), cells.grid.sparsity[members])


@kernel('int64[::1](int32[::1], int64)')
def _members(labels, count):
    """Return a sample of the cells of the planes that are large enough."""
    size = np.zeros(count + 1, np.int64)
    for label in labels:
        size[label] += 1  # -1 is the last entry
    total = 0
    for k in range(count):
        total += size[k] if size[k] > MIN_CELLS else 0
    step, seen, n = total // MAX_SAMPLES + 1, 0, 0
    members = np.empty(total // step + 1, np.int64)
    for i in range(len(labels)):
        if labels[i] >= 0 and size[labels[i]] > MIN_CELLS:
            if seen % step == 0:
                members[n] = i
                n += 1
            seen += 1
    return members[:n].copy()


@kernel('UniTuple(float64[::1], 2)(int64[::1], int32[::1], float64[:, ::1], float64[:, ::1])')
def _deviations(members, labels, planes, table):
    """Return the moduli of the residuals (n,) of some cells, and of their tilts (2 n,)."""
    residual, tilt = np.empty(len(members)), np.empty(2 * len(members))
    for n, i in enumerate(members):
        a, b, c = planes[labels[i], 0], planes[labels[i], 1], planes[labels[i], 2]
        residual[n] = abs(table[i, 2] - (a * table[i, 0] + b * table[i, 1] + c))
        tilt[2 * n], tilt[2 * n + 1] = abs(table[i, 3] - a), abs(table[i, 4] - b)
    return residual, tilt


def has_converged(cells: WeightedCells, before: Noise, after: Noise) -> bool:
    """Say whether a search with the noise ``after`` would find the same as with ``before``."""
    floor = np.sqrt(before.variance_floor(cells.grid.typical_disparity))
    ratio = max(after.mean_sigma, floor) / max(before.mean_sigma, floor, np.finfo(float).tiny)
    return 1 - TOLERANCE <= ratio <= 1 + TOLERANCE
