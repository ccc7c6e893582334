# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Search for the planes and the noise together, since each is needed to find the other.

1. the noise is estimated from differences between neighbouring cells;
2. if creases are visible at this noise, connected components of cells are formed; if planar
   components cover most of the image, they are its planes, and few hypotheses remain to be tested;
3. the largest planes are found and the noise is estimated from their residuals, repeatedly, until
   the noise has converged;
4. the remaining planes are found with this noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import CellGrid, N
from plane_detector.segmentation.cells.model import PlaneRegions, WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.search.connected_components import planar_components
from plane_detector.segmentation.search.dbscan import neighbourhood
from plane_detector.segmentation.search.noise_from_planes import (
    has_converged,
    noise_from_planes,
)
from plane_detector.segmentation.search.ransac import SequentialRansac

# Too high a start hides planes; too low a start is corrected from the planes.
# tuned: benchmark sensitivity; 1.0 doubles what is taken for planes of curved things at 0.01.
START_SHARE = 0.7
# The largest planes reveal noise that is smooth over more than neighbouring cells.
# tuned: benchmark sensitivity; flat from 0.7 to 1.4 times.
CALIBRATION_PLANES, CALIBRATION_ROUNDS = 3, 5
# derived: most of the depth. Components are the planes when so much of it lies on planar ones.
MIN_COMPONENT_SHARE = 0.5
# derived: of a lens of 64 degrees, over the image width; for angles where the camera is unknown.
TYPICAL_FOCAL_SHARE = 0.8
# derived: the tangent of 30 degrees; neighbours on planes at this angle must not link.
MIN_CREASE_SLOPE = 0.577


@dataclass(frozen=True)
class Search:
    """Inputs of a search beside the noise: grid, smallest plane, settings and random generator."""

    grid: CellGrid
    min_pixels: float
    config: Config
    rng: np.random.Generator


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
    noise = _start_noise(search.grid, noise_floor)
    cells = weigh_cells(search.grid, noise)
    start = _components(search, cells, noise)
    by_components, most = start is not None, search.config.segmentation.max_planes
    for _ in range(CALIBRATION_ROUNDS):
        ransac = _begin(search, cells, start)
        largest = ransac.find(min(CALIBRATION_PLANES, most))
        shown = noise_from_planes(cells, largest, noise)
        if has_converged(cells, noise, shown):
            break
        noise, cells = shown, weigh_cells(search.grid, shown)
        start = _planar_components(search, cells) if by_components else None
    else:
        ransac = _begin(search, cells, start)
    return cells, ransac.find(most), noise


def _start_noise(grid: CellGrid, noise_floor: Noise) -> Noise:
    """Return the noise of the first round."""
    noise = estimate_noise(grid, noise_floor)
    return noise.with_smooth_part(START_SHARE * noise.mean_sigma, noise.slope_sigma)


def find_planes(search: Search, cells: WeightedCells, noise: Noise, most: int) -> PlaneRegions:
    """Find at most ``most`` planes with a given noise."""
    return _begin(search, cells, _components(search, cells, noise)).find(most)


def sees_creases(grid: CellGrid, noise: Noise, threshold: float) -> bool:
    """Say whether neighbouring cells on two planes differ by more than this many deviations."""
    tolerance = threshold * 2**0.5 * noise.slope_sigma * TYPICAL_FOCAL_SHARE
    return noise.source_sigma == 0 and tolerance < MIN_CREASE_SLOPE * grid.typical_disparity


def _components(search: Search, cells: WeightedCells, noise: Noise) -> PlaneRegions | None:
    """Return the planar components if creases are visible and they cover most of the depth."""
    if not sees_creases(search.grid, noise, search.config.ransac.inlier_threshold):
        return None
    components = _planar_components(search, cells)
    count = search.grid.moments[:, N]
    covered = count[components.labels.ravel() >= 0].sum()
    return components if covered >= MIN_COMPONENT_SHARE * max(count.sum(), 1) else None


def _planar_components(search: Search, cells: WeightedCells) -> PlaneRegions:
    return planar_components(cells, search.min_pixels, search.config.ransac.inlier_threshold)


def _begin(search: Search, cells: WeightedCells, start: PlaneRegions | None) -> SequentialRansac:
    """Return a search that starts from components, or from nothing."""
    return SequentialRansac(cells, search.min_pixels, search.config.ransac,
                            neighbourhood(search.config.dbscan), search.rng, start)
