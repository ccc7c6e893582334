# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Search for the planes and the noise together, since each is needed to find the other.

1. the noise is estimated from differences between neighbouring cells;
2. the largest planes are found, and the noise is estimated from their residuals, which neither
   miss noise that is smooth over several cells nor count clutter as noise;
3. the remaining planes are found with this noise, or all of them again if it has changed.
"""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.search.ransac import Search, add_planes, no_planes

# Too high a start hides planes; too low a start is corrected from the planes.
# tuned: benchmark sensitivity; 1.0 doubles the labelled share of curved surfaces at 0.01.
START_SHARE = 0.7
# The largest planes reveal noise that is smooth over more than neighbouring cells.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
CALIBRATION_PLANES = 3
# derived: a bound; two or three are enough, and after only one a wall under smooth noise is in
# pieces, whose residuals are too small.
CALIBRATION_ROUNDS = 5
# A small plane fits the noise itself, and its residuals are too small.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
MIN_CELLS = 100
# derived: the median of so many is good to 4 %.
MAX_SAMPLES = 1000
# derived: planes are the same when the noise changes by less.
TOLERANCE = 0.1
# derived: focal length over image width for 64 degrees, for angles if the camera is unknown.
TYPICAL_FOCAL_SHARE = 0.8
# derived: the tangent of 30 degrees; neighbours on planes at this angle must not link.
MIN_CREASE_SLOPE = 0.577


def search_planes(search: Search, noise_floor: Noise) -> tuple[WeightedCells, PlaneRegions, Noise]:
    """
    Find planes and noise.

    Parameters
    ----------
    search : Search
    noise_floor : Noise
        Its floors and its ``source_sigma`` bound the noise from below.

    Returns
    -------
    cells : WeightedCells
        Weighted by the noise that is returned.
    regions : PlaneRegions
    noise : Noise

    """
    grid, most = search.grid, search.config.segmentation.max_planes
    noise = estimate_noise(grid, noise_floor)
    noise = noise.with_smooth_part(START_SHARE * noise.mean_sigma, noise.slope_sigma)
    cells, floor = weigh_cells(grid, noise), np.finfo(float).tiny
    floor += np.sqrt(noise.variance_floor(grid.typical_disparity))
    for _ in range(CALIBRATION_ROUNDS):
        regions = add_planes(search, cells, no_planes(grid), min(CALIBRATION_PLANES, most))
        shown = _noise_from_planes(cells, regions, noise)
        if abs(max(shown.mean_sigma, floor) / max(noise.mean_sigma, floor) - 1) < TOLERANCE:
            break
        noise, cells, regions = shown, weigh_cells(grid, shown), no_planes(grid)
    return cells, add_planes(search, cells, regions, most), noise


def _noise_from_planes(cells: WeightedCells, regions: PlaneRegions, noise: Noise) -> Noise:
    """Return the noise from the median absolute deviation from the large planes, if any."""
    labels, table = regions.labels.ravel(), cells.table
    size = np.bincount(labels + 1, minlength=len(regions.coefficients) + 1)[1:]
    members = np.flatnonzero(np.append(size > MIN_CELLS, False)[labels])
    if not len(members):
        return noise
    members = members[::len(members) // MAX_SAMPLES + 1]
    plane = regions.coefficients[labels[members]]
    residual = table[members, 2] - (plane[:, :2] * table[members, :2]).sum(axis=1) - plane[:, 2]
    sigmas = (SIGMA_PER_MEDIAN * median(np.abs(residual)),
              SIGMA_PER_MEDIAN * median(np.abs(table[members, 3:5] - plane[:, :2]).ravel()),
              median(cells.grid.residual_rms[members]))
    return noise.from_cells(sigmas, cells.grid.sparsity[members])


def sees_creases(grid: CellGrid, noise: Noise, threshold: float) -> bool:
    """Return whether neighbouring cells on two planes differ by more than this many deviations."""
    tolerance = threshold * 2**0.5 * noise.slope_sigma * TYPICAL_FOCAL_SHARE
    return noise.source_sigma == 0 and tolerance < MIN_CREASE_SLOPE * grid.typical_disparity
