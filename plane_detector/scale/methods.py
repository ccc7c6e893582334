# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Scale methods: from a disparity of unknown scale and shift to metres, 1/z = scale * D + shift.

A method estimates both, or refuses with a reason. ``auto`` uses the first method that gives
metres, in this order: metres of the network, measured depth, height of the camera above the floor,
right angles with that height, given numbers. Right angles alone determine only the shift: angles
are then true, but the unit is unknown. If no method succeeds, both are unknown: ``relative``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from plane_detector.config import ScaleConfig
from plane_detector.geometry.gravity import unit_direction
from plane_detector.geometry.robust import quantiles
from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.estimate import RELATIVE, ScaleEstimate
from plane_detector.scale.floor import FloorFit, fit_floor, fit_floor_of_frame, with_right_angles
from plane_detector.scale.right_angles import (
    ShiftVote,
    estimate_manhattan_shift,
    estimate_shift,
)
from plane_detector.scale.sensor_depth import fit_measured_depth

COARSE_GRAVITY_DEG = 5.0
# The farthest pixels are those at this quantile, so that noise at the horizon does not count.
FAR_QUANTILE = 0.01
SPAN_QUANTILES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class ScaleEvidence:
    """Observations that may determine the scale and shift of a disparity."""

    disparity: np.ndarray  # (H, W) floating: affine in 1/z; not finite where invalid
    find_planes: Callable[[], DisparityPlanes]  # of it; called when needed, at most once
    output: str = 'relative_disparity'  # of the network, or metric_depth or disparity
    is_measured: bool = False  # by a sensor, in 1/metres
    # (3,) in the optical frame, of any length; None or 0: unknown.
    gravity_camera: np.ndarray | None = None
    down_tolerance_deg: float = 0.0  # largest error of gravity
    # (A, 3) float64: known horizontal directions parallel and perpendicular to the walls.
    level_axes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    sensor_depth_m: np.ndarray | None = None  # (H, W) floating, sparse or dense; NaN invalid

    @cached_property
    def planes(self) -> DisparityPlanes:
        """Planes of this disparity."""
        return self.find_planes()

    @cached_property
    def down(self) -> np.ndarray | None:
        """Unit direction of gravity; None if unknown."""
        return None if self.gravity_camera is None else unit_direction(self.gravity_camera)

    @property
    def knows_gravity_well(self) -> bool:
        """Whether gravity is accurate enough for angles."""
        return self.down is not None and self.down_tolerance_deg <= COARSE_GRAVITY_DEG

    @property
    def lowest(self) -> float:
        """Disparity of the farthest pixels."""
        return self._quantiles[0]

    @property
    def span(self) -> tuple[float, float, float]:
        """Disparity quantiles of 10, 50 and 90 %."""
        return self._quantiles[1:]

    @cached_property
    def _quantiles(self) -> tuple[float, ...]:
        sample = self.disparity[::4, ::4]
        sample = sample[np.isfinite(sample)]
        wanted = (FAR_QUANTILE, *SPAN_QUANTILES)
        return tuple(quantiles(sample, wanted)) if sample.size else (0.0,) * 4


def estimate_scale(evidence: ScaleEvidence, config: ScaleConfig | None = None) -> ScaleEstimate:
    """
    Estimate scale and shift of one image by the configured method.

    Parameters
    ----------
    evidence : ScaleEvidence
    config : ScaleConfig, optional

    Returns
    -------
    ScaleEstimate
        ``relative`` if no method succeeds; its note gives the reasons.

    Examples
    --------
    >>> evidence = ScaleEvidence(np.full((30, 40), 0.5), DisparityPlanes.none)
    >>> print(estimate_scale(evidence, ScaleConfig(method='fixed')))
    relative, unit unknown: fixed: scale.disparity_scale is not given
    >>> given = ScaleConfig(method='fixed', disparity_scale=0.8)
    >>> estimate_scale(evidence, given).unit_method
    'fixed'

    """
    config = config or ScaleConfig()
    refusals, unitless = [], None
    for method in ('metric',) if evidence.is_measured else _methods(config):
        estimate = METHODS[method](evidence, config)
        if isinstance(estimate, str):
            refusals.append(f'{method}: {estimate}')
        elif estimate.is_metric:
            return estimate
        else:
            unitless = unitless or estimate
    return unitless or _relative(evidence, '; '.join(refusals) or 'requested by scale.method')


def _methods(config: ScaleConfig) -> tuple[str, ...]:
    if config.method == 'auto':
        return tuple(METHODS)
    return () if config.method == 'none' else (config.method,)


def _relative(evidence: ScaleEvidence, note: str) -> ScaleEstimate:
    """Return the scale 1, with the smallest shift that makes the disparity positive."""
    return _unitless(evidence, max(0.0, -1.01 * evidence.lowest), RELATIVE, False, np.nan, note)


def _unitless(evidence: ScaleEvidence, tau: float, method: str, has_true_angles: bool,
              tau_sigma: float, note: str) -> ScaleEstimate:
    """Return an estimate in the unit that makes the median depth of the image 1."""
    middle = evidence.span[1] + tau
    scale = 1.0 / middle if middle > 0 else 1.0
    estimate = ScaleEstimate(scale, scale * tau, method, False, has_true_angles, np.nan, note,
                             evidence.span)
    return estimate.with_covariance(np.diag([0.0, (scale * tau_sigma) ** 2]))


def _metric(evidence: ScaleEvidence, _config: ScaleConfig) -> ScaleEstimate | str:
    if evidence.output == 'relative_disparity':
        return 'the network does not give metres'
    note = 'measured depth' if evidence.is_measured else 'metres of the network'
    return ScaleEstimate(1.0, 0.0, 'metric', True, True, np.nan, note, (np.nan,) * 3)


def _depth_topic(evidence: ScaleEvidence, _config: ScaleConfig) -> ScaleEstimate | str:
    if evidence.sensor_depth_m is None:
        return 'no measured depth'
    fit = fit_measured_depth(evidence.disparity, evidence.sensor_depth_m)
    if fit.refusal:
        return fit.refusal
    estimate = ScaleEstimate(fit.scale, fit.shift, 'depth_topic', True, True, np.nan,
                             f'{fit.point_count} points of measured depth', evidence.span)
    return estimate.with_covariance(fit.covariance)


def _camera_height(evidence: ScaleEvidence, config: ScaleConfig) -> ScaleEstimate | str:
    if config.camera_height == 0 or evidence.down is None:
        return 'scale.camera_height and the direction of gravity are not both known'
    if not evidence.knows_gravity_well:
        return 'the direction of gravity is too inaccurate'
    fit = fit_floor(evidence.planes, evidence.lowest, evidence.down, config.camera_height,
                    evidence.down_tolerance_deg)
    if fit is None:
        return 'no plane can be the floor'
    note = f'floor {config.camera_height:.4g} m below'
    vote = _vote(evidence)
    if not vote.refusal:
        fit, note = with_right_angles(fit, vote.tau, vote.sigma), f'{note}, right angles'
    return _from_floor(evidence, fit, 'camera_height', note)


def _from_floor(evidence: ScaleEvidence, fit: FloorFit, method: str, note: str) -> ScaleEstimate:
    estimate = ScaleEstimate(fit.scale, fit.shift, method, True, True, np.nan, note, evidence.span)
    return estimate.with_covariance(fit.covariance)


def _manhattan(evidence: ScaleEvidence, config: ScaleConfig) -> ScaleEstimate | str:
    vote = _vote(evidence)
    if vote.refusal:
        return vote.refusal
    return _manhattan_metric(evidence, vote, config.camera_height) or _unitless(
        evidence, vote.tau, 'manhattan', True, vote.sigma, 'right angles between the planes')


def _vote(evidence: ScaleEvidence) -> ShiftVote:
    """Return the shift from gravity, from gravity and axes, or from right angles alone."""
    if evidence.knows_gravity_well:
        axes = np.vstack([evidence.down, evidence.level_axes])
        for count in sorted({1, len(axes)}):
            found = estimate_shift(evidence.planes, evidence.lowest, axes[:count])
            if not found.refusal:
                return found
    return estimate_manhattan_shift(evidence.planes, evidence.lowest, evidence.down,
                                    evidence.down_tolerance_deg)


def _manhattan_metric(evidence: ScaleEvidence, vote: ShiftVote,
                      height_m: float) -> ScaleEstimate | None:
    if height_m == 0 or evidence.down is None:
        return None
    fit = fit_floor_of_frame(evidence.planes, vote, evidence.down, height_m)
    if fit is None:
        return None
    return _from_floor(evidence, fit, 'manhattan',
                       f'right angles between the planes, floor {height_m:.4g} m below')


def _fixed(evidence: ScaleEvidence, config: ScaleConfig) -> ScaleEstimate | str:
    if config.disparity_scale == 0:
        return 'scale.disparity_scale is not given'
    return ScaleEstimate(config.disparity_scale, config.disparity_shift, 'fixed', True, True,
                         np.nan, 'scale and shift as given', evidence.span)


# In the order of auto.
METHODS: dict[str, Callable[[ScaleEvidence, ScaleConfig], ScaleEstimate | str]] = {
    'metric': _metric, 'depth_topic': _depth_topic, 'camera_height': _camera_height,
    'manhattan': _manhattan, 'fixed': _fixed}
