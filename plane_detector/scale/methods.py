# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Scale methods: from a disparity of unknown scale and shift to metres, 1/z = scale * D + shift.

A method estimates both, or refuses with a reason. ``auto`` uses the first method that gives
metres, in this order: metres of the network, measured depth, height of the camera above the floor,
the same with a vertical that comes only from the planes, stated numbers. Without a height, planes
together with the vertical, or with axes any of which may be the vertical, determine only the
shift: angles are then true, but the unit is unknown. If no method succeeds, both are unknown:
``relative``. Metres that are too uncertain are not reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from plane_detector.config import ScaleConfig
from plane_detector.geometry.disparity import UNITLESS, sampled_quantiles, to_depth
from plane_detector.geometry.gravity import unit_direction
from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.floor import fit_floor
from plane_detector.scale.right_angles import PerpendicularAxes, find_perpendicular_axes
from plane_detector.scale.sensor_depth import fit_measured_depth
from plane_detector.scale.shift_posterior import ShiftEstimate, estimate_shift, frames_about
from plane_detector.types import METRIC, RELATIVE, ScaleEstimate

# The tolerance of gravity in standard deviations.
COARSE_GRAVITY_DEG, TOLERANCE_SIGMAS = 5.0, 2.0
# Of axes that planes have in common. chosen: twice the error of buildings.
OWN_TOLERANCE_DEG = 2.0
# Metres more uncertain than this, as a share of depth, are not reported. chosen: obstacles a third
# nearer or farther than stated are useless.
MAX_UNCERTAINTY = 0.3
# The farthest pixels are those at this quantile, so that noise at the horizon does not count.
FAR_QUANTILE = 0.01
SPAN_QUANTILES = (0.1, 0.5, 0.9)
# Depths beyond this multiple of the arbitrary unit are invalid if metres are unknown.
MAX_RELATIVE_DEPTH = 1000.0


@dataclass(frozen=True)
class ScaleEvidence:
    """Observations that may determine the scale and shift of a disparity."""

    disparity: np.ndarray  # (H, W) floating: affine in 1/z; not finite where invalid
    find_planes: Callable[[], DisparityPlanes]  # of it; called when needed, at most once
    output: str = 'relative_disparity'  # kind, as in `plane_detector.types.Prediction`
    # (3,) in the optical frame, of any length; None or 0: unknown.
    gravity_camera: np.ndarray | None = None
    down_tolerance_deg: float = 0.0  # largest error of gravity
    # (A, 3) float64: known horizontal directions parallel and perpendicular to the walls.
    level_axes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    # (A, 3) float64: known perpendicular axes of which any may be the vertical.
    open_axes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
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

    @cached_property
    def own_axes(self) -> PerpendicularAxes:
        """Perpendicular axes of the planes, the one closest to gravity or to downwards first."""
        return find_perpendicular_axes(self.planes, self.lowest, self.down,
                                       self.down_tolerance_deg)

    @cached_property
    def shift(self) -> ShiftEstimate:
        """Shift from the planes and known directions, or from the planes; depth has none."""
        if self.output == 'relative_depth':
            return ShiftEstimate(0.0, 0.0, np.nan, 'depth of the network')
        if self.knows_gravity_well:
            down, tolerance_deg, axes = self.down, self.down_tolerance_deg, self.level_axes
        elif len(self.open_axes):
            return estimate_shift(self.planes, self.lowest, self.span, [
                frame for k, axis in enumerate(self.open_axes) for frame in frames_about(
                    axis, np.radians(OWN_TOLERANCE_DEG / TOLERANCE_SIGMAS),
                    np.delete(self.open_axes, k, axis=0))])
        elif self.own_axes.refusal:
            return ShiftEstimate.refused(self.own_axes.refusal)
        else:
            (down, *axes), tolerance_deg = self.own_axes.axes, OWN_TOLERANCE_DEG
        return estimate_shift(self.planes, self.lowest, self.span, frames_about(
            down, np.radians(tolerance_deg / TOLERANCE_SIGMAS), np.reshape(axes, (-1, 3))))

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
        return tuple(sampled_quantiles(self.disparity, (FAR_QUANTILE, *SPAN_QUANTILES)))


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
    >>> evidence = ScaleEvidence(np.full((30, 40), 0.5), find_planes=lambda: None)
    >>> print(estimate_scale(evidence, ScaleConfig(method='fixed')))
    relative, unit unknown: fixed: scale.disparity_scale is not given
    >>> given = ScaleConfig(method='fixed', disparity_scale=0.8)
    >>> estimate_scale(evidence, given).unit_method
    'fixed'

    """
    config = config or ScaleConfig()
    refusals, unitless = [], None
    asked = (tuple(METHODS) if config.method == 'auto' else
             () if config.method == 'none' else (config.method,))
    for method in asked:
        estimate = METHODS[method](evidence, config)
        if isinstance(estimate, str):
            refusals.append(f'{method}: {estimate}')
        elif estimate.is_metric:
            return estimate
        else:
            unitless = unitless or estimate
    return unitless or _relative(evidence, '; '.join(refusals) or 'requested by scale.method')


def _relative(evidence: ScaleEvidence, note: str) -> ScaleEstimate:
    """
    Return the scale 1, with the smallest shift that makes the disparity positive.

    Depth up to scale has no shift, and true angles.
    """
    tau = max(0.0, -1.01 * evidence.lowest)
    scale = _unit_scale(evidence, tau)
    return ScaleEstimate(scale, scale * tau, RELATIVE, False,
                         evidence.output == 'relative_depth', np.nan, note, evidence.span)


def _unitless(evidence: ScaleEvidence, found: ShiftEstimate, note: str) -> ScaleEstimate:
    scale = _unit_scale(evidence, found.tau)
    estimate = ScaleEstimate(scale, scale * found.tau, 'manhattan', False, True, np.nan, note,
                             evidence.span, found.angle_sigma_deg)
    return estimate.with_covariance(np.diag([0.0, (scale * found.sigma) ** 2]))


def _unit_scale(evidence: ScaleEvidence, tau: float) -> float:
    """Return the scale for which the median depth of the image is 1."""
    middle = evidence.span[1] + tau
    return 1.0 / middle if middle > 0 else 1.0


def _metric(evidence: ScaleEvidence, _config: ScaleConfig) -> ScaleEstimate | str:
    if evidence.output in UNITLESS:
        return 'the network does not give metres'
    return replace(METRIC, note='metres of the network')


def _depth_topic(evidence: ScaleEvidence, _config: ScaleConfig) -> ScaleEstimate | str:
    if evidence.sensor_depth_m is None:
        return 'no measured depth'
    fit = fit_measured_depth(evidence.disparity, evidence.sensor_depth_m,
                             has_shift=evidence.output != 'relative_depth')
    if fit.refusal:
        return fit.refusal
    estimate = ScaleEstimate(fit.scale, fit.shift, 'depth_topic', True, True, np.nan,
                             f'{fit.point_count} points of measured depth', evidence.span)
    return _if_certain(estimate.with_covariance(fit.covariance))


def _camera_height(evidence: ScaleEvidence, config: ScaleConfig) -> ScaleEstimate | str:
    if config.camera_height == 0 or evidence.down is None:
        return 'scale.camera_height and the direction of gravity are not both known'
    if not evidence.knows_gravity_well:
        return 'the direction of gravity is too inaccurate'
    if evidence.shift.refusal:
        return evidence.shift.refusal
    return _by_floor(evidence, 'camera_height', evidence.down, evidence.down_tolerance_deg,
                     config.camera_height)


def _by_floor(evidence: ScaleEvidence, method: str, down: np.ndarray, tolerance_deg: float,
              height_m: float) -> ScaleEstimate | str:
    found = evidence.shift
    fit = fit_floor(evidence.planes, found, down, tolerance_deg, height_m)
    if fit is None:
        return 'no plane can be the floor'
    estimate = ScaleEstimate(fit.scale, fit.shift, method, True, True, np.nan,
                             f'floor {height_m:.4g} m below, {found.note}', evidence.span,
                             found.angle_sigma_deg).with_covariance(fit.covariance)
    return _if_certain(estimate)


def _if_certain(estimate: ScaleEstimate) -> ScaleEstimate | str:
    """Return an estimate in metres, or why it is not accurate enough."""
    if estimate.uncertainty <= MAX_UNCERTAINTY:
        return estimate
    return f'metres are uncertain by {estimate.uncertainty:.0%}'


def _manhattan(evidence: ScaleEvidence, config: ScaleConfig) -> ScaleEstimate | str:
    found, reason = evidence.shift, ''
    if found.refusal:
        return found.refusal
    if config.camera_height and evidence.down is not None:
        metric = (_camera_height(evidence, config) if evidence.knows_gravity_well else
                  evidence.own_axes.refusal or
                  _by_floor(evidence, 'manhattan', evidence.own_axes.axes[0], OWN_TOLERANCE_DEG,
                            config.camera_height))
        if not isinstance(metric, str):
            return replace(metric, method='manhattan')
        reason = f'; {metric}'
    if evidence.output == 'relative_depth':
        return f'the angles of the network are used{reason}'
    source = ('planes and the vertical' if evidence.knows_gravity_well else
              'planes and the axes of the scene' if len(evidence.open_axes) else
              'right angles between the planes')
    return _unitless(evidence, found, f'{source}: {found.note}{reason}')


def _fixed(evidence: ScaleEvidence, config: ScaleConfig) -> ScaleEstimate | str:
    if config.disparity_scale == 0:
        return 'scale.disparity_scale is not given'
    return ScaleEstimate(config.disparity_scale, config.disparity_shift, 'fixed', True, True,
                         np.nan, 'scale and shift as given', evidence.span)


# In the order of auto.
METHODS: dict[str, Callable[[ScaleEvidence, ScaleConfig], ScaleEstimate | str]] = {
    'metric': _metric, 'depth_topic': _depth_topic, 'camera_height': _camera_height,
    'manhattan': _manhattan, 'fixed': _fixed}


def apply_scale(disparity: np.ndarray, estimate: ScaleEstimate,
                max_depth_m: float = np.inf) -> np.ndarray:
    """
    Return the depth (H, W) float32 of a disparity (H, W), NaN where invalid.

    Depth beyond ``max_depth_m`` is invalid if the unit is the metre.
    """
    farthest = max_depth_m if estimate.is_metric else MAX_RELATIVE_DEPTH
    inverse = np.float32(estimate.scale) * disparity + np.float32(estimate.shift)
    return to_depth(inverse, farthest)
