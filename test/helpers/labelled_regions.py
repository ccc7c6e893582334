# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Given labels as regions of a disparity image, in the format of the segmentation."""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.disparity import zero_filled
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid, fit_planes
from plane_detector.segmentation.cells.model import PixelRegions
from plane_detector.segmentation.cells.noise import estimate_noise
from plane_detector.segmentation.segment import unitless_noise_floor


def labelled_regions(disparity: np.ndarray, labels: np.ndarray) -> PixelRegions:
    """
    Return the regions of given labels, each with the least-squares plane of its pixels.

    The disparity (H, W) may have any unit, and is not finite where it is invalid; a label of -1 is
    no plane.
    """
    image = DisparityImage(*zero_filled(disparity))
    grid = build_cell_grid(image)
    moments = [build_cell_grid(DisparityImage(image.values, image.valid & (labels == k)))
               .moments.sum(axis=0) for k in range(int(labels.max(initial=-1)) + 1)]
    noise = estimate_noise(grid, unitless_noise_floor(disparity))
    return PixelRegions(image.values, np.where(image.valid, labels, -1).astype(np.int32),
                        fit_planes(np.reshape(moments, (-1, 10))), grid, noise)
