# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Many planes: hypothesise, take the largest, refine, split by DBSCAN, repeat, label every pixel.

Everything works on 1/z over the picture, where planes are affine, where the noise of stereo and
of depth networks is near constant, and where an unknown scale and shift of a network's disparity
changes nothing about which pixels form a plane.
"""

from __future__ import annotations

import numpy as np

from plane_detector.config import Config
from plane_detector.geometry.disparity import disparity_range, zero_filled
from plane_detector.segmentation.cells.grid import CellGrid, make_cells
from plane_detector.segmentation.cells.labels import without
from plane_detector.segmentation.cells.noise import Noise, with_rounding
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.fine_pass import MIN_CELL_SHARE, add_narrow
from plane_detector.segmentation.pixels.edge_snapping import GuideImage, snap_to_image_edges
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.bends import find_bent, join_bowed
from plane_detector.segmentation.regions.curvature import drop_curved
from plane_detector.segmentation.regions.depth_steps import split_at_steps
from plane_detector.segmentation.regions.icm import relabel
from plane_detector.segmentation.regions.merging import merge_patches
from plane_detector.segmentation.regions.occlusion import join_hidden
from plane_detector.segmentation.search.plane_search import find_patches
from plane_detector.segmentation.threads import one_blas_thread

# What exact planes of a disparity of unknown unit may stray by, as a share of its range.
RELATIVE_FLOOR = 1e-4


def metric_noise_floor(config: Config, disparity_noise: float = 0.0) -> Noise:
    """
    Return the least noise of 1/z in 1/metres.

    Parameters
    ----------
    config : Config
        Its ``ransac.noise_floor``; its ``segmentation.disparity_noise`` comes first.
    disparity_noise : float
        What the source of the depth is known for, per metre; 0 when nothing is known.

    """
    known = config.segmentation.disparity_noise or disparity_noise
    return Noise(config.ransac.noise_floor, known=known)


def unitless_noise_floor(disparity: np.ndarray, disparity_noise: float = 0.0) -> Noise:
    """
    Return the least noise of a disparity of unknown scale and shift.

    Parameters
    ----------
    disparity : (H, W) floating
        Not finite where invalid.
    disparity_noise : float
        What its source is known for, in the same unit; 0 when nothing is known.

    """
    return Noise(0.0, RELATIVE_FLOOR * disparity_range(disparity), disparity_noise)


@one_blas_thread
def segment(disparity: np.ndarray, noise_floor: Noise, config: Config,
            rng: np.random.Generator | None = None,
            guide: GuideImage | None = None) -> PixelRegions:
    """
    Find the regions of a disparity image that are planes.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/depth, in any unit; not finite where invalid.
    noise_floor : Noise
        The noise is estimated from the disparity and taken to be at least this.
    config : Config
        Its ``segmentation``, ``ransac`` and ``dbscan`` are used.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.
    guide : GuideImage, optional
        The colour image, where the source of the disparity blurs the edges of things.

    Returns
    -------
    PixelRegions
        In the unit of the disparity. Finding no plane is not an error.

    """
    rng = rng or np.random.default_rng(config.ransac.seed)
    disparity, valid = zero_filled(disparity)
    grid = make_cells(disparity, valid)
    noise_floor = with_rounding(noise_floor, disparity, valid)
    labels, planes, noise = _label(disparity, valid, grid, noise_floor, config, rng)
    if guide is not None:
        labels = np.where(valid, snap_to_image_edges(labels, guide), -1)
    return PixelRegions(disparity, labels, planes, grid, noise)


def _label(disparity: np.ndarray, valid: np.ndarray, grid: CellGrid, noise_floor: Noise,
           config: Config, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Noise]:
    """Return labels (H, W), planes (K, 3) of the cells' coordinates, and the noise."""
    threshold = config.ransac.inlier_threshold
    min_cell_pixels = MIN_CELL_SHARE * config.segmentation.min_plane_share * disparity.size
    model, patches, noise = find_patches(grid, noise_floor, min_cell_pixels, config, rng)
    patches = relabel(model, patches, threshold, min_cell_pixels, config.dbscan)
    patches = join_hidden(model, merge_patches(model, patches, noise), noise)
    if noise.is_exact(grid.typical_disparity):
        patches = drop_curved(model, patches, noise)
    else:
        patches = split_at_steps(disparity, valid, model, patches, noise, min_cell_pixels)
        patches = join_bowed(model, patches, noise)
    labels = label_pixels(disparity, valid, model, patches, noise, threshold)
    labels, planes = add_narrow(disparity, valid, labels, model, noise, patches.planes, config,
                                rng)
    # Curved regions are removed last, so that no plane can grow into their pixels.
    return *without(labels, planes, find_bent(model, patches, noise)), noise
