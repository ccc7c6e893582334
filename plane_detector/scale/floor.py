# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Scale of a disparity from the floor, whose distance below the camera is known.

Let g be the unit direction of gravity, and 1/z = scale * (D + tau). The floor h below the camera
meets the ray (x, y, 1) at z = h / (g . (x, y, 1)), so that scale = g . (x, y, 1) / (h (D + tau)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.shift_posterior import ShiftEstimate

# Smallest share of the floor in the pixels of all planes; a smaller one is noise, or a table top
# in front of a floor outside the image.
MIN_FLOOR_SHARE = 0.02
# Largest share of the planes' pixels below a floor (noise, reflections), and the margin to it.
MAX_SHARE_BELOW, BELOW_MARGIN = 0.1, 1.1
SAME_HEIGHT = 1.05
# Tolerance of horizontal planes for noise, in addition to that of gravity.
LEVEL_DEG = 6.0


@dataclass(frozen=True)
class FloorFit:
    """1/z = scale * D + shift, determined by the floor."""

    scale: float
    shift: float
    covariance: np.ndarray  # (2, 2) float64, from the errors of the shift and of gravity
    label: int  # index of the floor's plane


def fit_floor(planes: DisparityPlanes, found: ShiftEstimate, down: np.ndarray,
              tolerance_deg: float, height_m: float) -> FloorFit | None:
    """
    Find the floor among planes whose shift is known, and the scale.

    Parameters
    ----------
    planes : DisparityPlanes
    found : ShiftEstimate
        An answer.
    down : (3,) floating
        Unit direction of gravity.
    tolerance_deg : float
        Its largest error.
    height_m : float
        Of the camera above the floor.

    Returns
    -------
    FloorFit or None
        None if no plane can be the floor: it must be horizontal, below the horizon and large
        enough, and have almost nothing below it. A table in front of a floor outside the image
        cannot be distinguished from it.

    """
    level, height = _level_and_height(planes, found.tau, down, LEVEL_DEG + tolerance_deg)
    if not level.any():
        return None
    lowest = np.where(level, height, 0.0).argmax()
    ratio = height / height[lowest]
    floor = level & (ratio < SAME_HEIGHT) & (ratio > 1.0 / SAME_HEIGHT)
    share = planes.pixel_share[floor]
    floor_height = np.average(height[floor], weights=share)
    below = height / floor_height > BELOW_MARGIN
    if (share.sum() < MIN_FLOOR_SHARE or (level & below).any()
            or planes.pixel_share[below].sum() > MAX_SHARE_BELOW):
        return None
    scale = floor_height / height_m
    center = np.append(np.average(planes.centers[floor], axis=0, weights=share), 1.0)
    inverse = center @ np.average(planes.scaled(1.0, found.tau)[floor], axis=0, weights=share)
    by_tau = scale * np.array([-1.0, inverse - found.tau]) / inverse * found.sigma
    sine = np.linalg.norm(np.cross(center, down)) / (center @ down)
    by_gravity = scale * sine * np.radians(tolerance_deg) / 2 * np.array([1.0, found.tau])
    return FloorFit(scale, scale * found.tau,
                    np.outer(by_tau, by_tau) + np.outer(by_gravity, by_gravity),
                    int(planes.labels[lowest]))


def _level_and_height(planes: DisparityPlanes, tau: float, down: np.ndarray,
                      tolerance_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask (N,) of horizontal planes below the camera, and each plane's height."""
    unscaled = planes.scaled(1.0, tau)
    length = np.maximum(np.linalg.norm(unscaled, axis=1), 1e-30)
    level = unscaled @ down / length >= np.cos(np.radians(tolerance_deg))
    rays = np.column_stack([planes.centers, np.ones(len(planes))])
    height = rays @ down / np.maximum((rays * unscaled).sum(1), 1e-30)
    return level & (height > 0), height

