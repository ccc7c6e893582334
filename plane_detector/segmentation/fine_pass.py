# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes too narrow for whole cells, looked for with smaller ones in what is left."""

from __future__ import annotations

from itertools import islice

import cv2
import numpy as np

from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import N, error_weights, make_cells
from plane_detector.segmentation.cells.labels import without
from plane_detector.segmentation.cells.model import CellModel, Patches, make_model
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.bends import find_bent
from plane_detector.segmentation.regions.curvature import drop_curved
from plane_detector.segmentation.regions.merging import MAX_JOINT_VARIANCES, memberships
from plane_detector.segmentation.search.connected_components import flat_components
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE, search_planes
from plane_detector.segmentation.search.ransac import collect

# Cells of fewer pixels say nothing of their slope.
MIN_CELL_SIZE_PX = 3
# Half of a plane's pixels may lie in cells that straddle its border.
MIN_CELL_SHARE = 0.5
# Pieces of one plane are no farther apart than this many of the smaller cells.
REACH_CELLS = 2

Cut = tuple[slice, slice]


def add_narrow(disparity: np.ndarray, valid: np.ndarray, labels: np.ndarray, model: CellModel,
               noise: Noise, planes: np.ndarray, config: Config,
               rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """
    Find more planes among the pixels without a label.

    Parameters
    ----------
    disparity : (H, W) float32
    valid : (H, W) bool
    labels : (H, W) int32
    model : CellModel
        That the others were found with.
    noise : Noise
    planes : (K, 3) float64
        The others.
    config : Config
    rng : numpy.random.Generator

    Returns
    -------
    labels : (H, W) int32
        A new plane that only goes on where another one was found too wide has that one's label.
    planes : (K + L, 3) float64
        With the new planes behind the others; some may have no pixels.

    """
    size, min_pixels = model.grid.size_px // 2, config.segmentation.min_plane_share * labels.size
    room = config.segmentation.max_planes - len(planes)
    # The errors of a network are as smooth as narrow planes: smaller cells would only find them.
    if noise.known > 0 or size < MIN_CELL_SIZE_PX or room < 1 or not _sees_width(model, noise):
        return labels, planes
    left, cut = _large_pieces(valid, labels, min_pixels)
    if cut is None:
        return labels, planes
    disparity = disparity[cut]
    grid = make_cells(np.where(left, disparity, np.float32(0)), left, size,
                      (cut[0].start, cut[1].start), labels.shape)
    smaller = make_model(grid, noise.for_smaller_cells(model.grid.size_px, size))
    min_cell_pixels, threshold = MIN_CELL_SHARE * min_pixels, config.ransac.inlier_threshold
    if grid.moments[smaller.planar, N].sum() < min_cell_pixels:
        return labels, planes
    exact = noise.is_exact(model.grid.typical_disparity)
    plain = flat_components(smaller, min_cell_pixels, threshold) if exact else []
    search = search_planes(smaller, plain, min_cell_pixels, config, rng)
    patches = drop_curved(smaller, collect(smaller, list(islice(search, room))), noise)
    new = label_pixels(disparity, left, smaller, patches, noise, threshold)
    bent = find_bent(smaller, patches, noise)
    new, _ = without(new, patches.planes, bent)
    patches = Patches(*without(patches.labels, patches.planes, bent))
    labels, whole = labels.copy(), labels[cut]
    labels[cut] = np.where(new >= 0, new + len(planes), whole)
    planes = np.vstack([planes, patches.planes])
    return _with_continuations(labels, cut, smaller, patches, planes), planes


def _sees_width(model: CellModel, noise: Noise) -> bool:
    """Say whether the noise is less than what a thing as wide as a smaller cell stands out by."""
    width = model.grid.size_px / 2 / (TYPICAL_FOCAL_SHARE * model.grid.width_px)
    return noise.mean < width * model.grid.typical_disparity


def _with_continuations(labels: np.ndarray, cut: Cut, model: CellModel, patches: Patches,
                        planes: np.ndarray) -> np.ndarray:
    """Give new planes and what they continue, touching and coplanar, the first label of these."""
    first = len(planes) - len(patches.planes)
    members = memberships(model, patches)
    square = members @ model.grid.mean_moments @ error_weights(planes).T
    fits = square <= MAX_JOINT_VARIANCES * (members @ model.variances.mean)[:, None]
    target = np.arange(len(planes) + 1)
    reach = REACH_CELLS * model.grid.size_px
    around = labels[tuple(slice(max(side.start - reach, 0), side.stop + reach) for side in cut)]
    square_px = np.ones((2 * reach + 1,) * 2, np.uint8)
    for k in np.flatnonzero(fits.sum(axis=1) > 1):
        near = cv2.dilate((around == first + k).astype(np.uint8), square_px) > 0
        same = [j for j in np.unique(around[near]) if j >= 0 and fits[k, j]]
        if same:
            target[np.isin(target, target[same])] = target[same].min()
    if (target[:-1] == np.arange(len(planes))).all():
        return labels
    target[-1] = -1
    return target.astype(np.int32).take(labels, mode='wrap')


def _large_pieces(valid: np.ndarray, labels: np.ndarray,
                  min_pixels: float) -> tuple[np.ndarray, Cut | None]:
    """
    Return the connected pieces without label that are large enough, as seen at half the size.

    They are cut out of the picture; with them the part that holds them all, None for none.
    """
    half = (valid[::2, ::2] & (labels[::2, ::2] < 0)).view(np.uint8)
    if 4 * cv2.countNonZero(half) < min_pixels:
        return valid, None
    _, pieces, statistics, _ = cv2.connectedComponentsWithStats(half, connectivity=4,
                                                                ltype=cv2.CV_16U)
    large = 4 * statistics[:, cv2.CC_STAT_AREA] >= min_pixels
    large[0] = False
    if not large.any():
        return valid, None
    left, top, width, height = statistics[large, :4].T
    cut = (slice(2 * int(top.min()), 2 * int((top + height).max())),
           slice(2 * int(left.min()), 2 * int((left + width).max())))
    whole = large[pieces].repeat(2, axis=1).repeat(2, axis=0)[cut]
    left = valid[cut] & (labels[cut] < 0)
    return left & whole[:left.shape[0], :left.shape[1]], cut
