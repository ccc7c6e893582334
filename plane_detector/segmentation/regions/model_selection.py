# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether two patches that lie within the noise of each other are two planes all the same.

The smooth part of the noise moves whole patches, but it neither jumps nor bends sharply: from one
cell to the next it changes by far less than its standard deviation. Generalised least squares
(Aitken 1936) makes use of that. Given how the errors of cells go together, it tells how much
better the cells about a border are explained by two planes than by one.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.segmentation.cells.model import CellModel
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.plane_fit import least_squares

# How far from the smaller patch the cells of the larger one are looked at.
REACH_CELLS = 3
# More cells than these, the nearest to the border, only cost time.
MAX_CELLS = 300
# A patch of fewer is no evidence.
MIN_CELLS = 4
# Twice the gain in log-likelihood that blurred noise hardly ever gives, times its power, 2:
# rougher noise has more edges of its own.
MIN_GAIN_TIMES_POWER = 24.0
# A cell that the border cuts anywhere is off by this share of the step, squared, on average.
CUT_VARIANCE = 1 / 12


def are_two(model: CellModel, labels: np.ndarray, correlation: Correlation | None,
            first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """
    Say which pairs of patches a step or a crease along their border keeps apart.

    Parameters
    ----------
    model : CellModel
    labels : (R, C) int32
        Patch of each cell, -1 none.
    correlation : Correlation or None
        None: nothing is kept apart.
    first, second : (P,) int
        The pairs.

    Returns
    -------
    (P,) bool
        False where they do not touch.

    """
    if correlation is None:
        return np.zeros(len(first), bool)
    gain = [_gain(model, labels, correlation, i, j) for i, j in zip(first, second, strict=True)]
    return np.array(gain) > MIN_GAIN_TIMES_POWER / correlation.power


def _gain(model: CellModel, labels: np.ndarray, correlation: Correlation, first: int,
          second: int) -> float:
    """Return twice the gain in log-likelihood of two planes over one."""
    cell, small, cut = _cells_about(model, labels, first, second)
    if min(np.count_nonzero(small), np.count_nonzero(~small)) < MIN_CELLS:
        return 0.0
    x, y, d = (model.grid.mean[cell] - model.grid.mean[cell].mean(axis=0)).T
    plane = np.stack([np.ones_like(x), x, y], axis=1)
    basis = np.column_stack([plane, plane * small[:, None], d])
    solved = np.linalg.solve(correlation.matrix(model, cell),
                             np.hstack([basis, np.eye(len(cell))[:, cut]]))
    weighted, inverse = solved[:, :7], solved[cut, 7:]
    products = basis.T @ weighted
    (one,), _ = least_squares(products[None], 3)
    _, (two_planes,) = least_squares(products[None], 6)
    # Cells that the border cuts have the disparity of neither plane (Woodbury's identity).
    variance = CUT_VARIANCE * (plane[cut] @ two_planes[3:]) ** 2
    scaled = np.eye(len(cut)) + inverse * variance
    projected = weighted[cut]
    products -= projected.T @ (variance[:, None] * np.linalg.solve(scaled, projected))
    (two,), _ = least_squares(products[None], 6)
    return float(one - two - np.linalg.slogdet(scaled)[1])


def _cells_about(model: CellModel, labels: np.ndarray, first: int,
                 second: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return cells (n,), which are in the smaller patch (n,) bool, which are cut (m,) int."""
    sides = labels == first, labels == second
    small, large = sorted(sides, key=np.count_nonzero)
    image = small.view(np.uint8)
    reach = cv2.dilate(image, np.ones((2 * REACH_CELLS + 1,) * 2, np.uint8)).view(bool)
    cell = np.flatnonzero((small | large & reach).ravel() & model.planar)
    if len(cell) > MAX_CELLS:
        to_border = np.where(small, cv2.distanceTransform(image, cv2.DIST_C, 3),
                             cv2.distanceTransform(1 - image, cv2.DIST_C, 3)).ravel()[cell]
        cell = np.sort(cell[np.argsort(to_border, kind='stable')[:MAX_CELLS]])
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    at_border = (small & cv2.dilate(large.view(np.uint8), cross).view(bool)
                 | large & cv2.dilate(image, cross).view(bool)).ravel()[cell]
    return cell, small.ravel()[cell], np.flatnonzero(at_border)
