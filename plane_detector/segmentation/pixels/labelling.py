# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Labels of cells to labels of pixels.

A cell whose whole neighbourhood agrees hands its label to its pixels. In the cells along borders
every pixel chooses among the planes nearby: where two planes meet in a crease, by the side of the
crease that it lies on, which no noise blurs; at a step, by its own residual.
"""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np

from plane_detector.segmentation.cells.grid import (
    around,
    block_coordinates,
    median,
    pixels_of_cells,
)
from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.pixels.creases import find_creases

# Grain over this many times the floor is smoothed before pixels are told apart.
SMOOTHED_GRAIN = 2.0
MEDIAN_SIDE_PX = 5
# The median of 25 pixels has about 1.25 / 5 of their standard deviation.
MEDIAN_NOISE_SHARE = 0.25
# A pixel among those of a plane may stray this much more than the cells that found it.
RELEASE = 1.3


def label_pixels(disparity: np.ndarray, valid: np.ndarray, model: CellModel, patches: Patches,
                 noise: Noise, threshold: float) -> np.ndarray:
    """
    Label every pixel.

    Parameters
    ----------
    disparity : (H, W) float32
    valid : (H, W) bool
    model : CellModel
    patches : Patches
    noise : Noise
    threshold : float
        A pixel within this many standard deviations of a plane may belong to it.

    Returns
    -------
    (H, W) int32
        Index into the planes, -1 for none and where not valid.

    """
    size, (rows, columns) = model.grid.size_px, patches.labels.shape
    certain = _certain_cells(model, patches, threshold)
    canvas = np.where(certain, patches.labels, -1).astype(np.int32)
    canvas = canvas.repeat(size, axis=1).repeat(size, axis=0)
    near = cv2.dilate((patches.labels + 1).astype(np.uint16), _square(1)) > 0
    at_row, at_column = np.nonzero(near & ~certain)
    if len(at_row):
        smooth, grain = _smoothed(disparity, noise)
        cells = canvas.reshape(rows, size, columns, size)
        cells[at_row, :, at_column, :] = _choose(
            smooth, model, patches, noise, grain, threshold, at_row, at_column)
    labels = canvas[:disparity.shape[0], :disparity.shape[1]]
    if not valid.all():
        labels = np.where(valid, labels, -1)
    return np.ascontiguousarray(labels)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _certain_cells(model: CellModel, patches: Patches, threshold: float) -> np.ndarray:
    """Return the flat cells (R, C) whose eight neighbours all have the same plane."""
    label = (patches.labels + 1).astype(np.uint16)
    same = (cv2.dilate(label, _square(1)) == cv2.erode(label, _square(1))) & (label > 0)
    return same & model.planar.reshape(label.shape)


def _smoothed(disparity: np.ndarray, noise: Noise) -> tuple[np.ndarray, float]:
    """Return the disparity with less grain, edges kept, and the grain that is left."""
    if not noise.grain:
        return disparity, 0.0
    typical = median(disparity[::7, ::7].ravel())
    if noise.grain <= SMOOTHED_GRAIN * np.sqrt(noise.floor(typical)):
        return disparity, noise.grain
    return cv2.medianBlur(disparity, MEDIAN_SIDE_PX), MEDIAN_NOISE_SHARE * noise.grain


def _choose(disparity: np.ndarray, model: CellModel, patches: Patches, noise: Noise,
            grain: float, threshold: float, at_row: np.ndarray, at_column: np.ndarray):
    """Return the labels (n, s, s) of the pixels of some cells, by least residual."""
    size = model.grid.size_px
    x, y = (values.astype(np.float32) for values in
            block_coordinates(model.grid, at_row, at_column))
    d = pixels_of_cells(disparity, size, at_row, at_column)
    candidates = _candidates(patches.labels, at_row, at_column)
    planes = patches.planes.astype(np.float32)
    # Every cell here has a first candidate, few have more.
    a, b, c = planes[candidates[:, 0]].T[..., None, None]
    best = (d - c - a * x - b * y) ** 2
    chosen = np.repeat(candidates[:, :1], size**2, axis=1).reshape(d.shape)
    for rank in candidates.T[1:]:
        active = np.flatnonzero(rank >= 0)
        a, b, c = planes[rank[active]].T[..., None, None]
        error = (d[active] - c - a * x[active] - b * y[active]) ** 2
        better = error < best[active]
        best[active] = np.where(better, error, best[active])
        chosen[active] = np.where(better, rank[active, None, None], chosen[active])
    variance = noise.mean**2 + grain**2 + noise.floor(d)
    chosen[best > (RELEASE * threshold) ** 2 * variance] = -1
    if noise.is_exact(model.grid.typical_disparity):
        return chosen  # residuals as exact as that draw the creases themselves
    return _by_side(chosen, candidates, model, patches, x, y, threshold**2 * variance)


def _by_side(chosen: np.ndarray, candidates: np.ndarray, model: CellModel, patches: Patches,
             x: np.ndarray, y: np.ndarray, unclear: np.ndarray) -> np.ndarray:
    """Correct the pixels near creases, where the planes' square difference is unclear."""
    signs, planes = find_creases(model, patches), patches.planes.astype(np.float32)
    for i, j in combinations(range(candidates.shape[1]), 2):
        first, second = candidates[:, i], candidates[:, j]
        active = np.flatnonzero((second >= 0) & (signs[first, second] != 0))
        first, second = first[active, None, None], second[active, None, None]
        a, b, c = np.moveaxis(planes[first] - planes[second], -1, 0)
        difference = c + a * x[active] + b * y[active]
        side = np.where(signs[first, second] * difference > 0, first, second)
        own = chosen[active]
        close = ((own == first) | (own == second)) & (difference**2 < unclear[active])
        chosen[active] = np.where(close, side, own)
    return chosen


def _candidates(labels: np.ndarray, at_row: np.ndarray, at_column: np.ndarray) -> np.ndarray:
    """Return the different labels around each cell, (n, m), filled up with -1."""
    found = around(labels, at_row * labels.shape[1] + at_column)
    found.sort(axis=1)
    found[:, 1:][found[:, 1:] == found[:, :-1]] = -1
    ordered = -np.sort(-found, axis=1)
    return ordered[:, :int((ordered >= 0).sum(axis=1).max(initial=1))]
