# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The planes on the cells, and the noise that they were found with.

One cannot be known without the other. The first guess is that there is no noise but the floor:
where most of the picture then falls into planes, it was right. Otherwise the noise is estimated
from the picture, and the search starts again while the largest planes say that it is another.
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

# The largest planes tell noise that is smooth over more than a window of the estimate.
CALIBRATION_PLANES = 3
CALIBRATION_ROUNDS = 5
# Depth is exact when this share of it lies on planes that only exact depth shows.
MIN_EXACT_SHARE = 0.5

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
    noise, exact = least, least.known == 0
    for _ in range(CALIBRATION_ROUNDS):
        model = make_model(grid, noise)
        plain = flat_components(model, min_pixels, threshold) if exact else []
        if noise is least and _share(model, plain) < MIN_EXACT_SHARE:
            exact, plain, noise = False, [], estimate_noise(grid, least)
            model = make_model(grid, noise)
        search = search_planes(model, plain, min_pixels, config, rng)
        found = list(islice(search, min(CALIBRATION_PLANES, most)))
        calibrated = calibrate(model, collect(model, found), noise)
        if is_settled(model, noise, calibrated):
            break
        noise = calibrated
    found += islice(search, most - len(found))
    return model, collect(model, found), noise


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
