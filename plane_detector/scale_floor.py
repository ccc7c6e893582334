# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Scale and shift of a disparity by the floor, whose height under the camera is known.

On a floor h below the camera, with down the unit vector g, the ray (x, y, 1) meets it where
1/z = g . (x, y, 1) / h. There D = alpha / z + beta is linear in alpha and beta, so the least
squares over the floor's pixels has a closed form; scale = 1 / alpha, shift = -beta / alpha.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.disparity_planes import DisparityPlanes

MIN_FLOOR_SHARE = 0.01
# Of the planes' pixels, how many may lie below a floor (noise, reflections), and how far.
MAX_SHARE_BELOW, BELOW_MARGIN = 0.1, 1.1
LEVEL_DEG = 3.0
UPRIGHT_DEG = 6.0


@dataclass(frozen=True)
class FloorFit:
    """
    1/z = scale * D + shift by the floor.

    Attributes
    ----------
    scale, shift : float
    covariance : (2, 2) float64
        Of scale and shift, by the noise of the disparity and the tolerance of gravity.
    upright_share : float
        Share of the pixels in planes that are then level or upright.
    label : int
        The floor's.

    """

    scale: float
    shift: float
    covariance: np.ndarray
    upright_share: float
    label: int


def fit_floor(planes: DisparityPlanes, lowest_disparity: float, down_camera: np.ndarray,
              height_m: float, down_tolerance_deg: float) -> FloorFit | None:
    """
    Find the floor by a direction of gravity that is known well, and fit scale and shift to it.

    Parameters
    ----------
    planes : DisparityPlanes
    lowest_disparity : float
        Disparity of the farthest pixels; depth must be positive there.
    down_camera : (3,) floating
        Unit direction of gravity.
    height_m : float
        Of the camera above the floor.
    down_tolerance_deg : float
        How far gravity may be off.

    Returns
    -------
    FloorFit or None
        None where no plane can be the floor: none is level, lies below the horizon, leaves all
        depths positive and has hardly anything below it.

    """
    fits = [_fit_as_floor(planes, k, lowest_disparity, down_camera, height_m, down_tolerance_deg)
            for k in np.flatnonzero(planes.pixel_share >= MIN_FLOOR_SHARE)]
    return max((fit for fit in fits if fit), key=lambda fit: fit.upright_share, default=None)


def _fit_as_floor(planes: DisparityPlanes, k: int, lowest_disparity: float,
                  down_camera: np.ndarray, height_m: float,
                  down_tolerance_deg: float) -> FloorFit | None:
    solved = _solve(planes, k, down_camera, height_m)
    if solved is None or planes.centers[k] @ down_camera[:2] + down_camera[2] <= 0:
        return None
    scale, shift, covariance = solved
    metric = planes.scaled(scale, shift)
    level_deg = _angle_deg(metric[k], down_camera)
    if (scale * lowest_disparity + shift <= 0 or level_deg > LEVEL_DEG + down_tolerance_deg
            or _share_below(planes, metric, down_camera, height_m) > MAX_SHARE_BELOW):
        return None
    covariance = covariance + _gravity_covariance(planes, k, down_camera, height_m,
                                                  down_tolerance_deg, (scale, shift))
    return FloorFit(scale, shift, covariance, _upright_share(planes, metric, down_camera),
                    int(planes.labels[k]))


def _solve(planes: DisparityPlanes, k: int, down_camera: np.ndarray, height_m: float):
    """Return scale, shift and their covariance; None if the plane cannot fix them."""
    design = np.stack([down_camera / height_m, [0.0, 0.0, 1.0]], axis=1)
    normal_matrix = design.T @ planes.information[k] @ design
    if np.linalg.cond(normal_matrix) > 1e12:
        return None
    alpha, beta = np.linalg.solve(
        normal_matrix, design.T @ planes.information[k] @ planes.coefficients[k])
    covariance = np.linalg.inv(normal_matrix)
    if alpha <= 3.0 * np.sqrt(covariance[0, 0]):
        return None
    jacobian = np.array([[-1.0, 0.0], [beta, -alpha]]) / alpha**2
    return 1.0 / alpha, -beta / alpha, jacobian @ covariance @ jacobian.T


def _gravity_covariance(planes: DisparityPlanes, k: int, down_camera: np.ndarray,
                        height_m: float, tolerance_deg: float, solution) -> np.ndarray:
    """Return what an error of gravity of one tolerance does to scale and shift, (2, 2)."""
    covariance = np.zeros((2, 2))
    for direction in np.linalg.svd(down_camera[None])[2][1:]:
        tilted = down_camera + np.tan(np.radians(tolerance_deg)) * direction
        solved = _solve(planes, k, tilted / np.linalg.norm(tilted), height_m)
        if solved is not None:
            change = np.array(solved[:2]) - solution
            covariance += np.outer(change, change)
    return covariance


def fit_floor_of_frame(planes: DisparityPlanes, tau: float, tau_sigma: float, axes: np.ndarray,
                       down_camera: np.ndarray, height_m: float) -> FloorFit | None:
    """
    Find the floor by right angles and a coarse direction of gravity.

    Parameters
    ----------
    planes : DisparityPlanes
    tau, tau_sigma : float
        Shift by the right angles, 1/z proportional to D + tau, and its standard deviation.
    axes : (3, 3) float64
        Rows: the axes of the Manhattan frame.
    down_camera : (3,) floating
        Coarse unit direction of gravity: picks the axis.
    height_m : float

    Returns
    -------
    FloorFit or None
        None where no plane is level and below the camera.

    """
    cosines = axes @ down_camera
    down = axes[np.abs(cosines).argmax()] * np.sign(cosines[np.abs(cosines).argmax()])
    shifted = planes.scaled(1.0, tau)
    level = [k for k in np.flatnonzero(planes.pixel_share >= MIN_FLOOR_SHARE)
             if _angle_deg(shifted[k], down) <= UPRIGHT_DEG]
    if not level:
        return None
    lowest = min(level, key=lambda k: np.linalg.norm(shifted[k]))
    scale = 1.0 / (height_m * np.linalg.norm(shifted[lowest]))
    metric = planes.scaled(scale, scale * tau)
    if _share_below(planes, metric, down, height_m) > MAX_SHARE_BELOW:
        return None
    return FloorFit(scale, scale * tau, np.diag([0.0, (scale * tau_sigma) ** 2]),
                    _upright_share(planes, metric, down), int(planes.labels[lowest]))


def _angle_deg(vector: np.ndarray, direction: np.ndarray) -> float:
    cosine = vector @ direction / max(np.linalg.norm(vector), 1e-30)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _share_below(planes: DisparityPlanes, metric: np.ndarray, down_camera: np.ndarray,
                 height_m: float) -> float:
    """Return the pixel share of the planes whose middle lies below the floor."""
    rays = np.column_stack([planes.centers, np.ones(len(planes))])
    inverse_depth = (rays * metric).sum(1)
    below = rays @ down_camera > BELOW_MARGIN * height_m * inverse_depth
    return float(planes.pixel_share[below].sum())


def _upright_share(planes: DisparityPlanes, metric: np.ndarray, down_camera: np.ndarray) -> float:
    cosine = np.abs(metric @ down_camera) / np.maximum(np.linalg.norm(metric, axis=1), 1e-30)
    upright = (cosine <= np.sin(np.radians(UPRIGHT_DEG))) | (
        cosine >= np.cos(np.radians(UPRIGHT_DEG)))
    return float(planes.pixel_share[upright].sum())
