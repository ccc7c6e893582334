# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Scale and shift of a disparity from the floor, whose distance below the camera is known.

Let g be the unit direction of gravity. The ray (x, y, 1) meets a floor h below the camera where
1/z = g . (x, y, 1) / h. There D = alpha / z + beta is linear in alpha and beta, so the
least-squares solution over the pixels of the floor has a closed form; scale = 1 / alpha, shift =
-beta / alpha.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.right_angles import ShiftVote

# Smallest share of the floor in the pixels of all planes; a smaller one is noise, or a table top
# in front of a floor outside the image.
MIN_FLOOR_SHARE = 0.02
# Largest share of the planes' pixels below a floor (noise, reflections), and the margin to it.
MAX_SHARE_BELOW, BELOW_MARGIN = 0.1, 1.1
SAME_HEIGHT = 1.05
# Tolerances of horizontal and vertical planes for noise, in addition to that of gravity.
LEVEL_DEG = 3.0
UPRIGHT_DEG = 6.0
MAX_INNOVATION_SIGMAS = 3.0


@dataclass(frozen=True)
class FloorFit:
    """1/z = scale * D + shift, determined by the floor."""

    scale: float
    shift: float
    covariance: np.ndarray  # (2, 2) float64, by the noise of D and the tolerance of gravity
    upright_share: float  # of the pixels in planes that are then horizontal or vertical
    label: int  # index of the floor's plane


def fit_floor(planes: DisparityPlanes, lowest_disparity: float, gravity_camera: np.ndarray,
              height_m: float, down_tolerance_deg: float) -> FloorFit | None:
    """
    Find the floor with an accurate direction of gravity, and fit scale and shift to it.

    Parameters
    ----------
    planes : DisparityPlanes
    lowest_disparity : float
        Disparity of the farthest pixels; depth must be positive there.
    gravity_camera : (3,) floating
        Unit direction of gravity.
    height_m : float
        Of the camera above the floor.
    down_tolerance_deg : float
        Largest error of gravity.

    Returns
    -------
    FloorFit or None
        None if no plane can be the floor: it must be horizontal, below the horizon and large
        enough, give positive depth everywhere and have almost nothing below it. A table in front
        of a floor outside the image cannot be distinguished from it.

    """
    fits = [_fit_as_floor(planes, k, lowest_disparity, gravity_camera, height_m,
                          down_tolerance_deg)
            for k in range(len(planes))]
    return max((fit for fit in fits if fit), key=lambda fit: fit.upright_share, default=None)


def _fit_as_floor(planes: DisparityPlanes, k: int, lowest_disparity: float,
                  gravity_camera: np.ndarray, height_m: float,
                  down_tolerance_deg: float) -> FloorFit | None:
    """Fit to plane k as the floor, together with all planes at its height."""
    first = _solve(planes.take([k]), gravity_camera, height_m)
    if first is None:
        return None
    level_deg = LEVEL_DEG + down_tolerance_deg
    level, height = _level_and_height(planes, first, gravity_camera, level_deg)
    members = np.flatnonzero(level & _near(height / height_m))
    floor = planes.take(members)
    solved = _solve(floor, gravity_camera, height_m) if k in members else None
    if solved is None or floor.pixel_share.sum() < MIN_FLOOR_SHARE:
        return None
    scale, shift, covariance = solved
    level, height = _level_and_height(planes, solved, gravity_camera, level_deg)
    if (scale * lowest_disparity + shift <= 0
            or _anything_below(planes, level, height / height_m)):
        return None
    metric = planes.scaled(scale, shift)
    covariance = covariance + _gravity_covariance(floor, gravity_camera, height_m,
                                                  down_tolerance_deg, (scale, shift))
    return FloorFit(scale, shift, covariance, _upright_share(planes, metric, gravity_camera),
                    int(planes.labels[k]))


def _near(ratio: np.ndarray) -> np.ndarray:
    return (ratio < SAME_HEIGHT) & (ratio > 1.0 / SAME_HEIGHT)


def _solve(floor: DisparityPlanes, gravity_camera: np.ndarray, height_m: float):
    """Return scale, shift and their covariance; None if the planes do not determine them."""
    design = np.stack([gravity_camera / height_m, [0.0, 0.0, 1.0]], axis=1)
    normal_matrix = design.T @ floor.information.sum(0) @ design
    if np.linalg.cond(normal_matrix) > 1e12:
        return None
    weighted = (floor.information @ floor.coefficients[..., None])[..., 0].sum(0)
    alpha, beta = np.linalg.solve(normal_matrix, design.T @ weighted)
    covariance = np.linalg.inv(normal_matrix)
    if alpha <= 3.0 * np.sqrt(covariance[0, 0]):
        return None
    jacobian = np.array([[-1.0, 0.0], [beta, -alpha]]) / alpha**2
    return 1.0 / alpha, -beta / alpha, jacobian @ covariance @ jacobian.T


def _gravity_covariance(floor: DisparityPlanes, gravity_camera: np.ndarray, height_m: float,
                        tolerance_deg: float, solution: tuple[float, float]) -> np.ndarray:
    """Return the covariance (2, 2) of scale and shift due to the tolerance of gravity."""
    covariance = np.zeros((2, 2))
    for direction in np.linalg.svd(gravity_camera[None])[2][1:]:
        tilted = gravity_camera + np.tan(np.radians(tolerance_deg)) * direction
        solved = _solve(floor, tilted / np.linalg.norm(tilted), height_m)
        if solved is not None:
            change = np.array(solved[:2]) - solution
            covariance += np.outer(change, change)
    return covariance


def fit_floor_of_frame(planes: DisparityPlanes, vote: ShiftVote, gravity_camera: np.ndarray,
                       height_m: float) -> FloorFit | None:
    """
    Find the floor with right angles and a coarse direction of gravity.

    Parameters
    ----------
    planes : DisparityPlanes
    vote : ShiftVote
        Shift and axes from the right angles.
    gravity_camera : (3,) floating
        Coarse unit direction of gravity, which selects the axis.
    height_m : float

    Returns
    -------
    FloorFit or None
        None if no plane is horizontal and below the camera.

    """
    cosines, tau = vote.axes @ gravity_camera, vote.tau
    down = vote.axes[np.abs(cosines).argmax()] * np.sign(cosines[np.abs(cosines).argmax()])
    level, height = _level_and_height(planes, (1.0, tau), down, UPRIGHT_DEG)
    if not level.any():
        return None
    lowest = np.where(level, height, 0.0).argmax()
    floor = level & _near(height / height[lowest])
    share = planes.pixel_share[floor]
    floor_height = np.average(height[floor], weights=share)
    if share.sum() < MIN_FLOOR_SHARE or _anything_below(planes, level, height / floor_height):
        return None
    scale = floor_height / height_m
    return FloorFit(scale, scale * tau, np.diag([0.0, (scale * vote.sigma) ** 2]),
                    _upright_share(planes, planes.scaled(scale, scale * tau), down),
                    int(planes.labels[lowest]))


def with_right_angles(fit: FloorFit, tau: float, tau_sigma: float) -> FloorFit:
    """
    Combine a fit to the floor with the shift from right angles, weighted by their uncertainties.

    An error of gravity tilts the floor and all walls, but not the right angles between them. One
    step of an extended Kalman filter combines both. Unchanged if they contradict each other.

    Parameters
    ----------
    fit : FloorFit
    tau, tau_sigma : float
        Shift / scale from the right angles, and its standard deviation.

    Returns
    -------
    FloorFit

    """
    jacobian = np.array([-fit.shift / fit.scale, 1.0]) / fit.scale
    variance = jacobian @ fit.covariance @ jacobian + tau_sigma**2
    innovation = tau - fit.shift / fit.scale
    if not innovation**2 <= MAX_INNOVATION_SIGMAS**2 * variance:
        return fit
    gain = fit.covariance @ jacobian / variance
    scale, shift = np.array([fit.scale, fit.shift]) + gain * innovation
    if scale <= 0:
        return fit
    covariance = (np.eye(2) - np.outer(gain, jacobian)) @ fit.covariance
    return replace(fit, scale=float(scale), shift=float(shift), covariance=covariance)


def _level_and_height(planes: DisparityPlanes, solution: tuple, gravity_camera: np.ndarray,
                      tolerance_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask (N,) of horizontal planes below the camera, and each plane's height."""
    metric = planes.scaled(*solution[:2])
    length = np.maximum(np.linalg.norm(metric, axis=1), 1e-30)
    level = metric @ gravity_camera / length >= np.cos(np.radians(tolerance_deg))
    rays = np.column_stack([planes.centers, np.ones(len(planes))])
    height = rays @ gravity_camera / np.maximum((rays * metric).sum(1), 1e-30)
    return level & (height > 0), height


def _anything_below(planes: DisparityPlanes, level: np.ndarray, ratio: np.ndarray) -> bool:
    """Return whether a horizontal plane, or many pixels of other planes, lie below the floor."""
    below = ratio > BELOW_MARGIN
    return bool((level & below).any() or planes.pixel_share[below].sum() > MAX_SHARE_BELOW)


def _upright_share(planes: DisparityPlanes, metric: np.ndarray,
                   gravity_camera: np.ndarray) -> float:
    cosine = np.abs(metric @ gravity_camera) / np.maximum(np.linalg.norm(metric, axis=1), 1e-30)
    upright = (cosine <= np.sin(np.radians(UPRIGHT_DEG))) | (
        cosine >= np.cos(np.radians(UPRIGHT_DEG)))
    return float(planes.pixel_share[upright].sum())
