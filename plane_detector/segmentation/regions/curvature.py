# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What is curved is no plane, however thin the slabs that one can cut it into.

Within the tolerance of any method a curtain or a cushion is a row of narrow planes. On exact depth
the cells of such a slab show the curve that a real plane does not have: a quadratic surface fits
them far better than a plane (F-test), and their normal turns from one end to the other.
"""

from __future__ import annotations

import numpy as np

from plane_detector.segmentation.cells import grid as cells
from plane_detector.segmentation.cells.labels import without
from plane_detector.segmentation.cells.model import CellModel, Patches
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import least_squares, quadratic_products
from plane_detector.segmentation.regions.merging import memberships

# Of the F-statistic: how much better the quadratic fits, as a multiple of the noise.
MIN_GAIN = 8.0
MIN_TURN_DEG = 2.0
# Fewer cells fit a quadratic by chance.
MIN_CELLS = 9
# A common lens: focal length over the width of the picture. Only the angle of the turn needs it.
TYPICAL_FOCAL_SHARE = 0.8
# A slab that turns by so little as above, and is but a few cells wide, strays by more than this.
MIN_RELATIVE_RMS = 1e-5
# Rounding in float32, relative to the disparity.
ROUNDING = 1e-6
# A uniform spread is this many standard deviations wide.
WIDTH_PER_DEVIATION = 12**0.5


def drop_curved(model: CellModel, patches: Patches, noise: Noise) -> Patches:
    """
    Give up the patches that are curved, where depth is exact enough to tell.

    Parameters
    ----------
    model : CellModel
    patches : Patches
    noise : Noise

    Returns
    -------
    Patches

    """
    if not len(patches.planes) or not noise.is_exact(model.grid.typical_disparity):
        return patches
    members = memberships(model, patches)
    suspects = _not_exact(model, members, patches.planes)
    if not len(suspects):
        return patches
    curved = suspects[_is_curved(model, members[suspects], noise)]
    return Patches(*without(patches.labels, patches.planes, curved))


def _not_exact(model: CellModel, members: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Return the patches whose cells stray from their plane by more than rounding."""
    moments = members @ model.grid.mean_moments
    count = np.maximum(moments[:, cells.N], 1)
    relative = cells.squared_error(planes, moments) * count / moments[:, cells.D] ** 2
    return np.flatnonzero((count >= MIN_CELLS) & (relative > MIN_RELATIVE_RMS**2))


def _least_variance(noise: Noise, disparity: np.ndarray) -> np.ndarray:
    return np.maximum(noise.mean**2, (ROUNDING * disparity) ** 2)


def _is_curved(model: CellModel, members: np.ndarray, noise: Noise) -> np.ndarray:
    """Say of each patch (S,), whose cells (S, R * C) are given, whether it is curved."""
    used = members.any(axis=0)
    members, values = members[:, used], model.grid.mean[used]
    count = members.sum(axis=1)
    mean = members @ values / count[:, None]
    x, y, d = (values - mean[members.argmax(axis=0)]).T
    products = quadratic_products(members, x, y, d)
    flat, _ = least_squares(products, 3)
    curved, quadratic = least_squares(products, 6)
    variance = np.maximum(curved / (count - 6), _least_variance(noise, mean[:, 2]))
    gain = (flat - curved) / 3 / variance
    spread = products[:, 1:3, 1:3] / count[:, None, None]
    turn_deg = _turn_deg(quadratic, spread, mean[:, 2])
    return (gain > MIN_GAIN) & (turn_deg > MIN_TURN_DEG)


def _turn_deg(quadratic: np.ndarray, spread: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Return the angle by which the normal turns from end to end of each patch, about (K,)."""
    xx, xy, yy = 2 * quadratic[:, 3], quadratic[:, 4], 2 * quadratic[:, 5]
    bend = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
    # The bend over the width of the patch along each direction: its squares have this trace.
    change = np.sqrt(np.maximum(np.einsum('kij,kjl,kil->k', bend, spread, bend), 0))
    slope = WIDTH_PER_DEVIATION * change * TYPICAL_FOCAL_SHARE
    return np.degrees(np.arctan2(slope, np.maximum(disparity, np.finfo(float).tiny)))
