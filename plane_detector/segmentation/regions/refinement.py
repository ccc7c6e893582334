# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Ragged borders between patches, smoothed where the errors of the cells allow it.

Taken one by one, the cells between two planes that differ by little more than the noise say what
the noise says, and its blobs cross the border. But around a cell with the wrong label the
residuals jump, and smooth noise does not jump. Iterated conditional modes (Besag 1986) lower the
energy of the residuals under their correlation and a Potts term.
"""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.grid import around
from plane_detector.segmentation.cells.labels import without
from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.noise_correlation import Correlation, residuals
from plane_detector.segmentation.regions.merging import memberships

# Of the filter that undoes the correlation.
REACH_CELLS = 4
SWEEPS = 3
# Of a cell's three by three cells all but itself, and those whose label it may take.
OTHERS = [0, 1, 2, 3, 5, 6, 7, 8]
CROSS = [1, 3, 4, 5, 7]
# What one neighbour's agreement is worth, in log-likelihood.
AGREEMENT = 3.0
# Residuals are cut off at this many deviations.
MAX_RESIDUAL = 4.0


def refine_borders(model: CellModel, patches: Patches, noise: Noise) -> Patches:
    """
    Move the borders between patches cell by cell.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    noise : Noise
        On exact depth and on that of a network nothing moves.

    Returns
    -------
    Patches
        Planes refitted; patches that lost all their cells are gone.

    """
    correlation = Correlation.of(model, patches, noise)
    if correlation is None or len(patches.planes) < 2:
        return patches
    precision, labels = correlation.precision(REACH_CELLS), patches.labels.copy()
    limit = MAX_RESIDUAL * np.sqrt(correlation.smooth + correlation.own)
    residual = residuals(model, patches.planes, np.arange(labels.size), labels.ravel(), limit)
    row, column = np.indices(labels.shape)
    # No two cells of one turn are neighbours.
    turns = 2 * (row % 2) + column % 2
    for turn in SWEEPS * [0, 1, 2, 3]:
        cell = np.flatnonzero((turns == turn) & _at_border(labels))
        _move(model, patches.planes, labels, residual, cell, precision, limit)
    return _refitted(model, Patches(labels, patches.planes))


def _at_border(labels: np.ndarray) -> np.ndarray:
    """Return the cells (R, C) of a patch that have a neighbour of another."""
    square, known = np.ones((3, 3), np.uint8), (labels + 1).astype(np.uint16)
    return (labels >= 0) & (cv2.dilate(known, square) != cv2.erode(known, square))


def _move(model: CellModel, planes: np.ndarray, labels: np.ndarray, residual: np.ndarray,
          cell: np.ndarray, precision: np.ndarray, limit: float) -> None:
    """Give some cells (n,) the label among their neighbours' that lowers the energy most."""
    pull = cv2.filter2D(residual.reshape(labels.shape), -1, precision,
                        borderType=cv2.BORDER_REFLECT).ravel()[cell, None]
    every = around(labels, cell)
    near = every[:, CROSS]
    moved = residuals(model, planes, cell[:, None], near, limit)
    change = moved - residual[cell, None]
    misfit = change * pull + change**2 * precision[REACH_CELLS, REACH_CELLS] / 2
    votes = (near[:, :, None] == every[:, None, OTHERS]).sum(axis=2)
    best = np.where(near >= 0, misfit - AGREEMENT * votes, np.inf).argmin(axis=1)[:, None]
    labels.ravel()[cell] = np.take_along_axis(near, best, axis=1)[:, 0]
    residual[cell] = np.take_along_axis(moved, best, axis=1)[:, 0]


def _refitted(model: CellModel, patches: Patches) -> Patches:
    planes = cells.fit_planes(memberships(model, patches) @ model.grid.moments)
    fitted = np.isfinite(planes).all(axis=1)
    planes = np.where(fitted[:, None], planes, patches.planes)
    empty = np.bincount(patches.labels.ravel() + 1, minlength=len(planes) + 1)[1:] == 0
    return Patches(*without(patches.labels, planes, np.flatnonzero(empty)))
