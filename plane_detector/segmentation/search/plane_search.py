# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The planes on the cells, and the noise that they were found with.

One cannot be known without the other:

1. the noise is estimated from differences between neighbouring cells;
2. where it lets creases be seen, the connected components of cells are tried: planes that cover
   most of the image are planes indeed, and the search needs no hypotheses for them;
3. the largest planes are found and the noise is taken from their residuals, in rounds, until it
   has converged;
4. the other planes are found with this noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from plane_detector.config import Config
from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import CellModel, Patches, make_model
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.search.calibration import calibrate, is_settled
from plane_detector.segmentation.search.connected_components import flat_components
from plane_detector.segmentation.search.dbscan import GridDbscan
from plane_detector.segmentation.search.ransac import collect, peel_planes

# Noise taken too high hides planes; taken too low, the planes raise it.
# tuned: evaluation.benchmark rooms at 0.01, living at 0.004, flat from 0.5 to 0.8.
START_SHARE = 0.7
# The largest planes tell noise that is smooth over more than neighbouring cells.
CALIBRATION_PLANES = 3
CALIBRATION_ROUNDS = 5
# Components are the planes when this share of the depth lies on flat ones.
MIN_COMPONENT_SHARE = 0.5
# Creases of 30 degrees stay visible, at a common focal length over the width of the image.
TYPICAL_FOCAL_SHARE, MIN_CREASE_SLOPE = 0.8, 0.577

Found = tuple[np.ndarray, np.ndarray]
"""A plane, 1/z = a x + b y + c, (3,) float64, and its cells, (R * C,) bool."""


def find_patches(grid: CellGrid, least: Noise, min_pixels: float, config: Config,
                 rng: np.random.Generator) -> tuple[CellModel, Patches, Noise]:
    """
    Find planes and noise.

    Parameters
    ----------
    grid : CellGrid
    least : Noise
        Its floors and what is known bound the noise from below.
    min_pixels : float
        Smallest plane.
    config : Config
    rng : numpy.random.Generator

    Returns
    -------
    model : CellModel
    patches : Patches
    noise : Noise

    """
    most, threshold = config.segmentation.max_planes, config.ransac.inlier_threshold
    noise = estimate_noise(grid, least)
    noise = noise.with_smooth_part(START_SHARE * noise.mean, noise.slope)
    model, plain = make_model(grid, noise), []
    if _sees_creases(grid, noise, threshold):
        plain = flat_components(model, min_pixels, threshold)
    is_plain = _share(model, plain) >= MIN_COMPONENT_SHARE
    for _ in range(CALIBRATION_ROUNDS):
        search = search_planes(model, plain if is_plain else [], min_pixels, config, rng)
        found = list(islice(search, min(CALIBRATION_PLANES, most)))
        calibrated = calibrate(model, collect(model, found), noise)
        if is_settled(model, noise, calibrated):
            found += islice(search, most - len(found))
            return model, collect(model, found), noise
        noise, model = calibrated, make_model(grid, calibrated)
        plain = flat_components(model, min_pixels, threshold) if is_plain else []
    search = search_planes(model, plain, min_pixels, config, rng)
    return model, collect(model, list(islice(search, most))), noise


def _sees_creases(grid: CellGrid, noise: Noise, threshold: float) -> bool:
    """Say whether neighbours on two planes at an angle of 30 degrees differ beyond the noise."""
    tolerance = threshold * 2**0.5 * noise.slope * TYPICAL_FOCAL_SHARE
    return noise.known == 0 and tolerance < MIN_CREASE_SLOPE * grid.typical_disparity


def _share(model: CellModel, found: list[Found]) -> float:
    """Return the share of the picture's pixels with depth that lie on planes."""
    count = model.grid.moments[:, cells.N]
    return (count @ _taken(model, found)) / max(count.sum(), 1)


def _taken(model: CellModel, found: list[Found]) -> np.ndarray:
    """Return the cells of any of the planes, (R * C,) bool."""
    taken = np.zeros(len(model.planar), bool)
    for _, members in found:
        taken |= members
    return taken


def search_planes(model: CellModel, plain: list[Found], min_pixels: float, config: Config,
                  rng: np.random.Generator) -> Iterator[Found]:
    """Yield the planes that are plain to see, then those that RANSAC finds in what is left."""
    yield from plain
    clustering = GridDbscan(config.dbscan.eps, config.dbscan.min_samples)
    yield from peel_planes(model, min_pixels, config.ransac, clustering, rng,
                           _taken(model, plain))
