# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From a disparity of unknown scale and shift to metres: 1/z = scale * disparity + shift.

A method finds both, or refuses with a reason. ``auto`` uses the first method that gives metres, in
this order: the network's own metres, measured depth, the camera's height above the floor, right
angles with that height, the given numbers. Right angles alone determine the shift only: angles
are then true, and the unit stays unknown. If no method succeeds, both are unknown: ``relative``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.config import ScaleConfig
from plane_detector.geometry.gravity import unit_direction
from plane_detector.scale.disparity_planes import DisparityPlanes, fit_disparity_planes
from plane_detector.scale.estimate import RELATIVE, ScaleEstimate
from plane_detector.scale.floor import FloorFit, fit_floor, fit_floor_of_frame, with_right_angles
from plane_detector.scale.known_axes import estimate_shift
from plane_detector.scale.manhattan import ManhattanVote, estimate_manhattan_shift
from plane_detector.scale.sensor_depth import fit_measured_depth
from plane_detector.types import CameraIntrinsics

COARSE_GRAVITY_DEG = 5.0
# The farthest pixels are judged by this quantile, so that noise at the horizon does not count.
FAR_QUANTILE = 0.01
SPAN_QUANTILES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class _Evidence:
    """Inputs of the methods."""

    disparity: np.ndarray
    labels: np.ndarray
    intrinsics: CameraIntrinsics
    config: ScaleConfig
    output: str
    down_camera: np.ndarray | None
    level_axes: np.ndarray
    sensor_depth_m: np.ndarray | None
    lowest: float
    span: tuple[float, float, float]

    @cached_property
    def planes(self) -> DisparityPlanes:
        return fit_disparity_planes(self.disparity, self.labels, self.intrinsics)


def estimate_scale(disparity: np.ndarray, labels: np.ndarray, intrinsics: CameraIntrinsics,
                   config: ScaleConfig | None = None, *, output: str = 'relative_disparity',
                   gravity_camera: np.ndarray | None = None,
                   level_axes: np.ndarray | None = None,
                   sensor_depth_m: np.ndarray | None = None) -> ScaleEstimate:
    """
    Find scale and shift of one image by the configured method.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/z; not finite where invalid.
    labels : (H, W) int
        Plane of each pixel, -1 none; the same at any scale and shift.
    intrinsics : CameraIntrinsics
    config : ScaleConfig, optional
    output : str
        Output of the network: ``metric_depth``, ``disparity`` or ``relative_disparity``.
    gravity_camera : (3,) floating, optional
        Direction down in the optical frame; by default ``config.gravity``.
    level_axes : (A, 3) float64, optional
        Horizontal directions parallel and perpendicular to the walls, if known.
    sensor_depth_m : (H, W) floating, optional
        Measured depth, sparse or dense.

    Returns
    -------
    ScaleEstimate
        ``relative`` if no method succeeds; its note gives the reasons.

    Examples
    --------
    >>> camera = CameraIntrinsics(30.0, 30.0, 19.5, 14.5, 40, 30)
    >>> disparity, labels = np.full((30, 40), 0.5), np.zeros((30, 40), int)
    >>> print(estimate_scale(disparity, labels, camera, ScaleConfig(method='fixed')))
    relative, unit unknown: fixed: scale.disparity_scale is not given
    >>> given = ScaleConfig(method='fixed', disparity_scale=0.8)
    >>> estimate_scale(disparity, labels, camera, given).unit_method
    'fixed'

    """
    config = config or ScaleConfig()
    evidence = _evidence(disparity, labels, intrinsics, config, output, gravity_camera,
                         level_axes, sensor_depth_m)
    refusals, unitless = [], None
    for method in _methods(config):
        estimate = METHODS[method](evidence)
        if isinstance(estimate, str):
            refusals.append(f'{method}: {estimate}')
        elif estimate.is_metric:
            return estimate
        else:
            unitless = unitless or estimate
    return unitless or _relative(evidence, '; '.join(refusals) or 'asked for by scale.method')


def _methods(config: ScaleConfig) -> tuple[str, ...]:
    if config.method == 'auto':
        return tuple(METHODS)
    return () if config.method == 'none' else (config.method,)


def _evidence(disparity, labels, intrinsics, config, output, gravity_camera, level_axes,
              sensor_depth_m) -> _Evidence:
    finite = disparity[::4, ::4]
    finite = finite[np.isfinite(finite)]
    lowest, *span = (np.quantile(finite, (FAR_QUANTILE, *SPAN_QUANTILES)) if finite.size
                     else (0.0, 0.0, 0.0, 0.0))
    gravity = config.gravity if gravity_camera is None else gravity_camera
    level_axes = np.zeros((0, 3)) if level_axes is None else level_axes
    return _Evidence(disparity, labels, intrinsics, config, output, unit_direction(gravity),
                     level_axes, sensor_depth_m, float(lowest),
                     tuple(float(value) for value in span))


def _relative(evidence: _Evidence, note: str) -> ScaleEstimate:
    """Return no shift, or the smallest that makes the disparity positive."""
    return _unitless(evidence, max(0.0, -1.01 * evidence.lowest), RELATIVE, False, np.nan, note)


def _unitless(evidence: _Evidence, tau: float, method: str, has_true_angles: bool,
              tau_sigma: float, note: str) -> ScaleEstimate:
    """Choose the unit so that the median depth of the image is 1."""
    middle = evidence.span[1] + tau
    scale = 1.0 / middle if middle > 0 else 1.0
    estimate = ScaleEstimate(scale, scale * tau, method, False, has_true_angles, np.nan, note,
                             evidence.span)
    return estimate.with_covariance(np.diag([0.0, (scale * tau_sigma) ** 2]))


def _metric(evidence: _Evidence) -> ScaleEstimate | str:
    if evidence.output == 'relative_disparity':
        return 'the network gives no metres'
    return ScaleEstimate(1.0, 0.0, 'metric', True, True, np.nan, 'the network\'s metres',
                         evidence.span)


def _depth_topic(evidence: _Evidence) -> ScaleEstimate | str:
    if evidence.sensor_depth_m is None:
        return 'no measured depth'
    fit = fit_measured_depth(evidence.disparity, evidence.sensor_depth_m)
    if fit.refusal:
        return fit.refusal
    estimate = ScaleEstimate(fit.scale, fit.shift, 'depth_topic', True, True, np.nan,
                             f'{fit.point_count} points of measured depth', evidence.span)
    return estimate.with_covariance(fit.covariance)


def _camera_height(evidence: _Evidence) -> ScaleEstimate | str:
    config, down = evidence.config, evidence.down_camera
    if config.camera_height == 0 or down is None:
        return 'scale.camera_height and the direction of gravity are not both known'
    if config.gravity_tolerance > COARSE_GRAVITY_DEG:
        return 'gravity is known too coarsely'
    fit = fit_floor(evidence.planes, evidence.lowest, down, config.camera_height,
                    config.gravity_tolerance)
    if fit is None:
        return 'no plane can be the floor'
    note = f'floor {config.camera_height:.4g} m below'
    vote = _vote(evidence)
    if not vote.refusal:
        fit, note = with_right_angles(fit, vote.tau, vote.sigma), f'{note}, right angles'
    return _from_floor(evidence, fit, 'camera_height', note)


def _from_floor(evidence: _Evidence, fit: FloorFit, method: str, note: str) -> ScaleEstimate:
    estimate = ScaleEstimate(fit.scale, fit.shift, method, True, True, np.nan, note, evidence.span)
    return estimate.with_covariance(fit.covariance)


def _manhattan(evidence: _Evidence) -> ScaleEstimate | str:
    vote = _vote(evidence)
    if vote.refusal:
        return vote.refusal
    return _manhattan_metric(evidence, vote) or _unitless(
        evidence, vote.tau, 'manhattan', True, vote.sigma, 'right angles between the planes')


def _vote(evidence: _Evidence) -> ManhattanVote:
    """Return the shift by gravity, by gravity and level axes, or by right angles alone."""
    config, down = evidence.config, evidence.down_camera
    if down is not None and config.gravity_tolerance <= COARSE_GRAVITY_DEG:
        axes = np.vstack([down, evidence.level_axes])
        for count in sorted({1, len(axes)}):
            found = estimate_shift(evidence.planes, evidence.lowest, axes[:count])
            if not found.refusal:
                return found
    return estimate_manhattan_shift(evidence.planes, evidence.lowest, down,
                                    config.gravity_tolerance)


def _manhattan_metric(evidence: _Evidence, vote: ManhattanVote) -> ScaleEstimate | None:
    height_m, down = evidence.config.camera_height, evidence.down_camera
    if height_m == 0 or down is None:
        return None
    fit = fit_floor_of_frame(evidence.planes, vote.tau, vote.sigma, vote.axes, down, height_m)
    if fit is None:
        return None
    return _from_floor(evidence, fit, 'manhattan',
                       f'right angles between the planes, floor {height_m:.4g} m below')


def _fixed(evidence: _Evidence) -> ScaleEstimate | str:
    config = evidence.config
    if config.disparity_scale == 0:
        return 'scale.disparity_scale is not given'
    return ScaleEstimate(config.disparity_scale, config.disparity_shift, 'fixed', True, True,
                         np.nan, 'scale and shift as given', evidence.span)


# In the order of auto.
METHODS: dict[str, Callable[[_Evidence], ScaleEstimate | str]] = {
    'metric': _metric, 'depth_topic': _depth_topic, 'camera_height': _camera_height,
    'manhattan': _manhattan, 'fixed': _fixed}
