# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Depth from a point map whose shift along the optical axis is unknown.

With known intrinsics, the point p = (x, y, z) of a pixel with ray (r, 1) must satisfy
(x, y) = (z + t) r for one shift t of the whole map. This is linear in t:

1. weight each pixel by 1 / (z + t)**2, which turns its error into one in the image;
2. t = sum w (r . (x, y) - |r|**2 z) / sum w |r|**2;
3. repeat from 1 with the new t until convergence.

References
----------
Wang et al., MoGe-2: Accurate Monocular Geometry with Metric Scale and Sharp Details, 2025, which
minimises the same error with a general solver.

"""

from __future__ import annotations

import numpy as np

_ROUNDS = 20
_SETTLED = 1e-6  # of the depth: below the precision of float32
_SAMPLED_SIDE = 64  # derived: 4096 pixels determine one unknown with more than enough precision
_MIN_DEPTH_SHARE = 0.01  # of the typical depth; nearer pixels would dominate the weights


def depth_from_point_map(points: np.ndarray, is_valid: np.ndarray,
                         rays: np.ndarray) -> np.ndarray:
    """
    Return the shifted z of a point map.

    Parameters
    ----------
    points : (h, w, 3) float32
        In any unit.
    is_valid : (h, w) bool
    rays : (h, w, 2) float32
        x / z and y / z of each pixel.

    Returns
    -------
    (h, w) float32
        z + t, in the unit of the points; NaN where invalid.

    """
    is_valid = is_valid & np.isfinite(points).all(axis=-1)
    step = tuple(max(1, side // _SAMPLED_SIDE) for side in points.shape[:2])
    sample = is_valid[::step[0], ::step[1]]
    shift = _shift(points[::step[0], ::step[1]][sample].astype(float),
                   rays[::step[0], ::step[1]][sample].astype(float))
    return np.where(is_valid, points[..., 2] + np.float32(shift), np.float32(np.nan))


def _shift(points: np.ndarray, rays: np.ndarray) -> float:
    """Return t for points (n, 3) on rays (n, 2); 0 if it cannot be determined."""
    square = (rays**2).sum(axis=1)
    if not square.any():
        return 0.0
    z = points[:, 2]
    difference = (rays * points[:, :2]).sum(axis=1) - square * z
    shift = float(difference.sum() / square.sum())
    for _ in range(_ROUNDS):
        depth = z + shift
        typical = np.median(np.abs(depth))
        weight = 1 / np.maximum(depth, _MIN_DEPTH_SHARE * typical + 1e-12) ** 2
        before, shift = shift, float((weight * difference).sum() / (weight * square).sum())
        if abs(shift - before) < _SETTLED * typical:
            break
    return shift
