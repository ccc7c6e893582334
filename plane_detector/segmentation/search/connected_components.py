# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes that are plain to see: connected cells each of which goes on where its neighbour ends.

On depth with little noise every cell knows its plane, and all planes of the picture come out of
one pass, however many they are, as in Trevor, Gedikli, Rusu and Christensen, "Efficient Organized
Point Cloud Segmentation with Connected Components" (2013). Under noise cells link across creases;
a component that is not flat is given up here and left to the search by hypotheses.
"""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.model import MIN_VARIANCE, CellModel
from plane_detector.segmentation.search.dbscan import NEIGHBOURS, linked_components

MAX_VARIANCES = 3.0


def flat_components(model: CellModel, min_pixels: float,
                    threshold: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Find the connected components of cells that are planes.

    Parameters
    ----------
    model : CellModel
    min_pixels : float
        Smallest plane.
    threshold : float
        Neighbours link up to this many standard deviations.

    Returns
    -------
    list of (plane, members)
        1/z = a x + b y + c, (3,) float64, and its cells, (R * C,) bool; the largest first.

    """
    right, down = _links(model, threshold)
    components = linked_components(model.planar.reshape(model.grid.shape), right, down).ravel()
    pixels = np.bincount(components + 1, model.grid.moments[:, cells.N])[1:]
    large = np.flatnonzero(pixels >= max(min_pixels, 1))
    large = large[np.argsort(-pixels[large], kind='stable')].astype(components.dtype)
    members = components == large[:, None]
    one_hot = members.astype(float)
    planes = cells.fit_planes(one_hot @ model.grid.moments)
    error = cells.squared_error(planes, one_hot @ model.grid.mean_moments)
    flat = error < MAX_VARIANCES * (one_hot @ model.variances.mean)
    return [(planes[k], members[k]) for k in np.flatnonzero(flat)]


def _links(model: CellModel, threshold: float) -> list[np.ndarray]:
    """Say of each cell whether it and the next one, right and down, have one plane."""
    x, y, d, slope_x, slope_y, planar = (
        values.reshape(model.grid.shape)
        for values in (*model.grid.mean.T, *model.grid.slope.T, model.planar))
    of_mean, of_slope = (np.maximum(variance, MIN_VARIANCE).reshape(model.grid.shape)
                         for variance in (model.variances.mean, model.variances.slope))
    links = []
    for near, far in NEIGHBOURS:
        # Planes are one when they meet half-way, at one slope.
        step = (d[far] - d[near] - (slope_x[near] + slope_x[far]) * (x[far] - x[near]) / 2
                - (slope_y[near] + slope_y[far]) * (y[far] - y[near]) / 2)
        bend = (slope_x[far] - slope_x[near]) ** 2 + (slope_y[far] - slope_y[near]) ** 2
        chi_square = (step * step / (of_mean[near] + of_mean[far])
                      + bend / (of_slope[near] + of_slope[far]))
        links.append((chi_square < threshold**2) & planar[near] & planar[far])
    return links
