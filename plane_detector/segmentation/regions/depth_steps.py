# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Patches that a step cuts apart become several planes.

A picture frame on a wall may stand out less than the noise of any pixel or cell, so that no plane
of its own explains it better. But the smooth part of noise does not jump, and the grain averages
out along an edge: differences of the means on both sides of a line show much smaller steps than
residuals do. They are linked with two thresholds, as in Canny's detector (1986), and what they
cut off is a plane of its own if its seam says so.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.model_selection import are_two
from plane_detector.segmentation.search.calibration import SIGMA_PER_MEDIAN
from plane_detector.segmentation.search.dbscan import NEIGHBOURS, linked_components

# Blocks of pixels along the side of a cell.
BLOCKS = 4
# The means compared are of half a cell by three cells along the step.
LENGTH_CELLS = 3
# A step in standard deviations of what is everywhere: everywhere along it, and somewhere.
WEAK, STRONG = 1.7, 4.0
# The piece is off its surroundings by this many deviations of the noise, at the step and overall.
MIN_OFFSET = 0.5
# Residuals are cut off at this many deviations, lest an outlier be the only step.
MAX_RESIDUAL = 6.0


def split_at_steps(disparity: np.ndarray, valid: np.ndarray, model: CellModel, patches: Patches,
                   noise: Noise, min_pixels: float) -> Patches:
    """
    Split patches along steps.

    Parameters
    ----------
    disparity : (H, W) float32
        0 where not valid.
    valid : (H, W) bool
    model : CellModel
    patches : Patches
    noise : Noise
    min_pixels : float
        Smallest piece.

    Returns
    -------
    Patches
        The pieces behind the others, each with a plane of its own.

    """
    size = model.grid.size_px
    # The steps of a network are smeared, and its errors have steps of their own.
    if noise.known > 0 or size < BLOCKS or not len(patches.planes):
        return patches
    residual, inside = _residual(disparity, valid, model, patches, noise)
    labels = patches.labels.repeat(BLOCKS, axis=0).repeat(BLOCKS, axis=1)
    free = inside & ~_steps(residual, inside)
    pieces = _pieces(free, labels)
    area = np.bincount(pieces.ravel() + 1)[1:]
    owner = np.zeros(len(area) + 1, int)
    owner[pieces] = labels
    large = np.flatnonzero(area * (size / BLOCKS) ** 2 >= min_pixels)
    large = large[np.argsort(-area[large], kind='stable')]
    split, correlation = patches, Correlation.of(model, patches, noise)
    for rank, piece in enumerate(large):
        larger = large[:rank][owner[large[:rank]] == owner[piece]]
        if not len(larger):
            continue
        mask, patch = pieces == piece, labels == owner[piece]
        rest_mean = residual[pieces == larger[0]].mean()
        if _stands_out(mask, patch & inside, residual, rest_mean, MIN_OFFSET * noise.mean):
            split = _cut_off(model, split, mask, owner[piece], correlation)
    return split


def _residual(disparity: np.ndarray, valid: np.ndarray, model: CellModel, patches: Patches,
              noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return the residual of each block to its patch's plane, and which blocks have one."""
    grid, (rows, columns) = model.grid, patches.labels.shape
    shape = columns * BLOCKS, rows * BLOCKS
    missing = [(0, -side % grid.size_px) for side in valid.shape]
    weight, mean = (cv2.resize(np.pad(image, missing).astype(np.float32), shape,
                               interpolation=cv2.INTER_AREA) for image in (valid, disparity))
    inside = (weight > 0.5) & (patches.labels >= 0).repeat(BLOCKS, 0).repeat(BLOCKS, 1)
    planes = np.append(patches.planes, np.zeros((1, 3)), axis=0)[patches.labels]
    pitch = grid.size_px / BLOCKS / grid.width_px
    half = (grid.size_px / BLOCKS - 1) / 2 / grid.width_px
    x, y = (first + half + pitch * np.arange(count)
            for first, count in zip(grid.origin, shape, strict=True))
    a, b, c = np.moveaxis(planes.astype(np.float32), -1, 0)
    expected = (c[:, None, :, None] + a[:, None, :, None] * x.reshape(1, 1, columns, BLOCKS)
                + b[:, None, :, None] * y.reshape(rows, BLOCKS, 1, 1)).reshape(mean.shape)
    limit = MAX_RESIDUAL * np.hypot(noise.mean, noise.grain)
    residual = np.clip(mean / np.maximum(weight, 0.5) - expected, -limit, limit)
    return np.where(inside, residual, 0).astype(np.float32), inside


def _steps(residual: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the blocks that lie on a step."""
    across = np.repeat([-1.0, 1.0], BLOCKS // 2) / (BLOCKS // 2)
    length = LENGTH_CELLS * BLOCKS
    along = np.full(length, 1 / length)
    height, sample = np.zeros(residual.shape, np.float32), np.s_[::3, ::3]
    if not inside[sample].any():
        return np.zeros_like(inside)
    for kernel_x, kernel_y in ((across, along), (along, across)):
        step = np.abs(cv2.sepFilter2D(residual, -1, kernel_x, kernel_y))
        typical = SIGMA_PER_MEDIAN * float(np.median(step[sample][inside[sample]]))
        np.maximum(height, step / max(typical, np.finfo(np.float32).tiny), out=height)
    count, components = cv2.connectedComponents((height > WEAK).astype(np.uint8), connectivity=8,
                                                ltype=cv2.CV_32S)
    strong = np.zeros(count, bool)
    strong[components[height > STRONG]] = True
    strong[0] = False
    return strong[components]


def _pieces(free: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the connected piece of its label that each free block belongs to, -1 none."""
    right, down = (free[near] & free[far] & (labels[near] == labels[far])
                   for near, far in NEIGHBOURS)
    return linked_components(free, right, down)


def _stands_out(piece: np.ndarray, patch: np.ndarray, residual: np.ndarray, rest_mean: float,
                least: float) -> bool:
    """Say whether a piece (H, W) bool is off its patch, and the same way at the step."""
    beyond = _grown(piece, BLOCKS)
    outer = _grown(beyond, BLOCKS) & ~beyond & patch
    inner = piece & _grown(patch & ~piece, BLOCKS + BLOCKS // 2)
    if not outer.any() or not inner.any():
        return False
    offsets = np.array([residual[inner].mean() - residual[outer].mean(),
                        residual[piece].mean() - rest_mean])
    return bool((offsets >= least).all() or (offsets <= -least).all())


def _grown(mask: np.ndarray, reach: int) -> np.ndarray:
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.dilate(mask.view(np.uint8), square).view(bool)


def _cut_off(model: CellModel, patches: Patches, piece: np.ndarray, label: int,
             correlation: Correlation | None) -> Patches:
    """Make the cells that a piece, with half the step around it, fills a patch if it is one."""
    rows, columns = patches.labels.shape
    filled = _grown(piece, BLOCKS // 2).reshape(rows, BLOCKS, columns, BLOCKS).sum(axis=(1, 3))
    labels = np.where((2 * filled >= BLOCKS**2) & (patches.labels == label),
                      len(patches.planes), patches.labels).astype(np.int32)
    members = [(labels.ravel() == k) & model.planar for k in (label, len(patches.planes))]
    fitted = cells.fit_planes(np.array(members, float) @ model.grid.moments)
    if not np.isfinite(fitted).all():
        return patches
    planes = np.append(patches.planes, fitted[1:], axis=0)
    planes[label] = fitted[0]
    split, pair = Patches(labels, planes), np.array([[label], [len(patches.planes)]])
    return split if are_two(model, labels, correlation, *pair)[0] else patches
