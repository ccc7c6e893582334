# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Choice between one curved surface and a few small planes, scored on the same pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.shapes.fitting import shape_misfit
from plane_detector.shapes.refinement import (
    Pixels,
    criterion,
    explained_share,
    plane_residuals,
)
from plane_detector.shapes.surface import DEVIATIONS
from plane_detector.shapes.views import DepthView, FoundShape

# A plane is a facet of a shape if the shape explains this share of its pixels.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 times, at 1.4 times 2 of 197
# fewer are found.
_MIN_FACET_SHARE = 0.7
# Enough pixels to estimate a share.
_FACET_PIXELS = 300


def instead_of_planes(view: DepthView, found: FoundShape) -> FoundShape | None:
    """
    Return the shape together with the planes that it replaces, or None if the planes fit better.

    A plane is replaced completely or not at all. The shape must explain the pixels better than the
    planes by the Bayesian information criterion; unexplained pixels cost the same for both.
    """
    counts = view.label_counts(found.members)[:-1]
    absorbed = found.absorbed.copy()
    for k in np.flatnonzero(counts * view.is_open):
        facet = view.plane_pixels(int(k), _FACET_PIXELS)
        absorbed[k] = explained_share(found.fit, facet) >= _MIN_FACET_SHARE
    pixels, labels = view.free_pixels(found.members, absorbed)
    if not absorbed.any():
        return found if len(pixels.points_m) else None
    better = _shape_cost(found, pixels) < _plane_cost(view, pixels, labels)
    return replace(found, absorbed=absorbed) if better else None


def _shape_cost(found: FoundShape, pixels: Pixels) -> float:
    misfit = shape_misfit(found.fit.shape, pixels.points_m, pixels.noise_m)
    return criterion(misfit, len(found.fit.model.freedoms), pixels.independent)


def _plane_cost(view: DepthView, pixels: Pixels, labels: np.ndarray) -> float:
    """Return the criterion of the planes on the pixels; pixels without a plane are outliers."""
    residual = np.full(len(labels), DEVIATIONS)
    present = np.unique(labels[labels >= 0])
    for k in present:
        own = labels == k
        residual[own] = plane_residuals(view.planes[k], pixels)[own]
    misfit = float(np.minimum(residual**2, DEVIATIONS**2).mean())
    return criterion(misfit, 3 * len(present), pixels.independent)
