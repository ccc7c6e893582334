# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Search for the planes and the noise together, since each is needed to find the other.

1. the noise is estimated from differences between neighbouring cells, its lateral part from how
   the deviation of the pixels grows with the slope;
2. the largest planes are found, and the noise is estimated from their residuals, which neither
   miss noise that is smooth over several cells nor count clutter as noise. This is repeated with
   the new noise as long as the planes explain more, because an image may have two noise levels
   that agree with their own planes, and chance would decide between them;
3. the growth of the residuals with distance shows the systematic part of the noise;
4. the remaining planes are found with this noise, in a stream with its mean over the last images,
   or all of them again if it differs.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import (
    LOCAL_RATIO,
    SLOPE_X,
    SLOPE_Y,
    Frame,
    PlaneRegions,
    residual,
)
from plane_detector.segmentation.cells.noise import (
    Noise,
    estimate_noise,
    roughness_of,
    sample_cells,
    with_lateral_noise,
    with_local_noise,
)
from plane_detector.segmentation.cells.noise_correlation import (
    MAX_BENDING,
    bending_of,
    in_large_regions,
)
from plane_detector.segmentation.memory import NO_MEMORY, Memory
from plane_detector.segmentation.search.ransac import MAX_TRIALS, add_planes, no_planes

# Too high a start hides planes; too low a start is corrected from the planes.
# tuned: benchmark sensitivity of bb08c3e; 1.0 doubles the labelled share of curved surfaces at
# 0.01.
START_SHARE = 0.7
# The largest planes reveal noise that is smooth over more than neighbouring cells.
# tuned: benchmark sensitivity of bb08c3e; flat from 0.7 to 1.4 times.
CALIBRATION_PLANES = 3
# chosen: planes are the same when the noise changes by less.
TOLERANCE = 0.1
# Neighbours on planes at this angle must not link; walls that a network bends by less are one.
# tuned: 14 real frames through FastDepth: SC -0.009 at 20 and at 70; for links flat from 20 to 45.
MIN_CREASE_DEG = 35.0


def search_planes(frame: Frame, memory: Memory = NO_MEMORY) -> tuple[Frame, PlaneRegions]:
    """
    Find planes and noise; return the frame with this noise, and the planes.

    The floors and the ``source_sigma`` of the noise given bound the noise from below. With a
    memory it is the mean of the last images.
    """
    grid, most = frame.grid, frame.config.segmentation.max_planes
    roughness = roughness_of(frame.image.values, frame.image.valid, grid.slope, grid.size_px,
                             grid.width_px)
    noise = with_lateral_noise(estimate_noise(grid, frame.noise), grid, roughness)
    noise, grid = with_local_noise(noise, grid, roughness)
    noise = noise.with_smooth_part(START_SHARE * noise.mean_sigma, noise.slope_sigma)
    frame, floor = replace(frame, grid=grid, noise=noise), sys.float_info.min
    floor += math.sqrt(noise.variance_floor(grid.typical_disparity))
    best, trial = -math.inf, frame
    for _ in range(MAX_TRIALS):
        found = add_planes(trial, no_planes(grid), min(CALIBRATION_PLANES, most))
        found_noise = _noise_from_planes(trial, found)
        # The log-likelihood gain of cells on planes over cells at any typical disparity.
        evidence = np.count_nonzero(found.labels >= 0) * math.log(max(
            grid.typical_disparity / max(found_noise.mean_sigma, floor), 1.0))
        if evidence <= best:
            break
        best, frame, regions, noise = evidence, trial, found, found_noise
        if not _differs(noise, frame.noise, floor):
            break
        trial = replace(frame, noise=noise)
    if _differs(noise.with_bending(MAX_BENDING), noise, floor):
        noise = noise.with_bending(bending_of(frame.cells, regions, noise))
    noise = memory.average_noise(grid, noise)
    if _differs(noise, frame.noise, floor):
        frame, regions = replace(frame, noise=noise), no_planes(grid)
    elif len(memory.planes):  # in a stream no jump of up to the tolerance
        frame = replace(frame, noise=noise)
    return frame, add_planes(frame, regions, most)


def _differs(noise: Noise, other: Noise, floor: float) -> bool:
    """Return whether planes found with one noise and the other may differ."""
    return abs(max(noise.mean_sigma, floor) / max(other.mean_sigma, floor) - 1) >= TOLERANCE


def _noise_from_planes(frame: Frame, regions: PlaneRegions) -> Noise:
    """Return the noise from the median absolute deviation from the large planes, if any."""
    grid, planes = frame.grid, regions.coefficients
    cells = sample_cells(in_large_regions(regions.labels, len(planes)))
    if not len(cells):
        return frame.noise
    moduli, tilt = _deviations(regions.labels, planes, frame.cells.table, cells)
    local = frame.cells.table[cells, LOCAL_RATIO]
    sigmas = (SIGMA_PER_MEDIAN * median(moduli), SIGMA_PER_MEDIAN * median(tilt),
              median(grid.residual_rms[cells] / np.sqrt(local)))
    return frame.noise.from_cells(sigmas, grid.sparsity.take(cells, 0))


@kernel('UniTuple(float64[::1], 2)(int32[:, ::1], float64[:, ::1], float64[:, ::1], int64[:])',
        is_short=True)
def _deviations(labels, planes, table, cells):
    """Return moduli of residuals (n,) of cells to their planes, and of slopes' (2 * n,)."""
    moduli, tilt, label = np.empty(len(cells)), np.empty(2 * len(cells)), labels.reshape(-1)
    for m, i in enumerate(cells):
        a, b, c = planes[label[i], 0], planes[label[i], 1], planes[label[i], 2]
        per = table[i, LOCAL_RATIO] ** -0.5
        moduli[m] = per * abs(residual(table, i, a, b, c))
        tilt[2 * m] = per * abs(table[i, SLOPE_X] - a)
        tilt[2 * m + 1] = per * abs(table[i, SLOPE_Y] - b)
    return moduli, tilt


def sees_creases(grid: CellGrid, noise: Noise, threshold: float) -> bool:
    """Return whether neighbouring cells on two planes differ by more than this many deviations."""
    tolerance = threshold * 2**0.5 * noise.slope_sigma * grid.lens[:2].max()
    crease = math.tan(math.radians(MIN_CREASE_DEG)) * grid.typical_disparity
    return noise.source_sigma == 0 and tolerance < crease
