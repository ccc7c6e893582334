# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Input of the search and of the stages after it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage
from plane_detector.segmentation.cells.model import WeightedCells, weigh_cells
from plane_detector.segmentation.cells.noise import DepthKind, Noise


@dataclass(frozen=True)
class Frame:
    """
    An image, or a part of one, and what is known of it.

    Attributes
    ----------
    image : DisparityImage
    grid : CellGrid
        Of this image.
    noise : Noise
        Of this image; before the search its lower bound.
    min_pixels : float
        Smallest plane.
    config : Config
    rng : numpy.random.Generator

    """

    image: DisparityImage
    grid: CellGrid
    noise: Noise
    min_pixels: float
    config: Config
    rng: np.random.Generator

    @cached_property
    def kind(self) -> DepthKind:
        """Kind of its depth errors."""
        return self.noise.kind(self.grid.typical_disparity)

    @property
    def threshold(self) -> float:
        """Inlier threshold in standard deviations."""
        return self.config.ransac.inlier_threshold

    @cached_property
    def cells(self) -> WeightedCells:
        """The cells of the grid, weighted by the noise."""
        return weigh_cells(self.grid, self.noise)
