# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The noise, estimated from the residuals of the largest planes.

Differences between neighbouring cells miss noise that is smooth over several cells, and count
clutter as noise. The residuals of the largest planes do neither.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.noise import GRAIN_PER_NOISE, Noise

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
    labels = regions.labels.ravel()
    size = np.bincount(labels + 1, minlength=len(regions.coefficients) + 1)
    size[0] = 0
    members = np.flatnonzero(size[labels + 1] > MIN_CELLS)
    if not len(members):
        return noise
    members = members[::len(members) // MAX_SAMPLES + 1]
    plane, (x, y, d) = regions.coefficients[labels[members]].T, cells.grid.mean[members].T
    residual = d - (plane[0] * x + plane[1] * y) - plane[2]
    tilt = (cells.grid.slope[members].T - plane[:2]).ravel()
    pixel_sigma = max(median(cells.grid.inner_rms[members]), GRAIN_PER_NOISE * noise.source_sigma)
    return replace(noise, pixel_sigma=pixel_sigma).with_smooth_part(
        SIGMA_PER_MEDIAN * median(np.abs(residual)), SIGMA_PER_MEDIAN * median(np.abs(tilt)))


def has_converged(cells: WeightedCells, before: Noise, after: Noise) -> bool:
    """Say whether a search with the noise ``after`` would find the same as with ``before``."""
    floor = np.sqrt(before.variance_floor(cells.grid.typical_disparity))
    ratio = max(after.mean_sigma, floor) / max(before.mean_sigma, floor, np.finfo(float).tiny)
    return 1 - TOLERANCE <= ratio <= 1 + TOLERANCE
