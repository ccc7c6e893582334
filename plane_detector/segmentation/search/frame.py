# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Input of the stages after the search."""

from __future__ import annotations

from dataclasses import dataclass

from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import DisparityImage
from plane_detector.segmentation.cells.model import WeightedCells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.search.ransac import Search


@dataclass(frozen=True)
class Frame:
    """
    An image, or a part of one, and what is known of it after the search.

    Attributes
    ----------
    image : DisparityImage
    cells : WeightedCells
        Of this image, weighted by its noise.
    noise : Noise
    search : Search
        The search that found the planes: settings and smallest plane.

    """

    image: DisparityImage
    cells: WeightedCells
    noise: Noise
    search: Search

    @property
    def config(self) -> Config:
        """Settings of the segmentation."""
        return self.search.config

    @property
    def threshold(self) -> float:
        """Inlier threshold in standard deviations."""
        return self.search.config.ransac.inlier_threshold
