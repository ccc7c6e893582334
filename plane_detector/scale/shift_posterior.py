# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Posterior of the shift of a disparity, from all its planes and the directions of the scene.

With 1/z proportional to D + tau, the plane D = p x + q y + r of ray slopes has the normal (p, q, r
+ tau) / m. Either the vertical and possibly horizontal axes are known, or axes any of which may be
the vertical.

1. Each plane is level, across a horizontal axis, upright, or arbitrary. The density of its normal
   is a mixture of these: a bell on the sphere about each direction, one about the great circle of
   upright planes, and a uniform density.
2. The error of a normal has three parts: fit, buildings, and network. The last one is unknown and
   therefore summed over several values. It is an error of the slopes of the disparity, so the
   angular error decreases as m grows.
3. Slopes are observed, not normals: the density is that of the normal times w / m^3, with w = D +
   tau at the centre of the plane. This makes flat worlds unlikely: for a large shift all planes
   turn toward the camera, and it would be a coincidence if all slopes were so small.
4. The prior is a prior on the ratio of the farthest to the nearest depth.
5. The vertical is uncertain too: the likelihood is the mean over several verticals about it, each
   with all planes, so that its error is common to them. Where it is undecided which axis of the
   scene it is, these are verticals about each axis.
6. The answer is the median. Its uncertainty grows with the angle by which planes rotate between it
   and the shifts of the posterior, so that a second mode counts as much as the width of the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.geometry.rigid_transform import unit_vectors
from plane_detector.scale.disparity_planes import DisparityPlanes

# Shares of planes that are level, across one of the horizontal axes, upright only, or anything.
# tuned: python -m plane_detector.evaluation.benchmark relative --first-seed 2000, also on kitchens
# and frames of sensors: flat from half to twice each.
LEVEL_SHARE, AXIS_SHARE, UPRIGHT_SHARE, FREE_SHARE = 0.2, 0.25, 0.15, 0.4
# Error of the slopes of the disparity as a share of its spread. tuned: as above; flat without the
# last and without the first.
SLOPE_ERRORS = (0.007, 0.025, 0.09, 0.3)
# Right angles of buildings are accurate to this. tuned: as above, flat from 0.3 to 2.
BUILDING_RAD = np.radians(0.5)
# A plane of this share of the pixels has half a vote. tuned: as above, flat from 0.03 to 0.06; at
# 0.01 the stated uncertainty is too small, at 0.1 a tenth fewer are answered.
HALF_VOTE_SHARE = 0.04
# Power of w / m^3, because the slopes of planes in one image are not independent. tuned: as above;
# at 0 one answer in 40 is a flat world, at 1 shifts are too small by 5 % of the spread.
SLOPE_DENSITY = 0.5
# Prior of the logit of the ratio of inverse depths, of the far to the near tenth of the pixels.
# measured: -0.1 +- 0.6 in 66 rooms; streets have -2.5. tuned: as above, the spread flat from 0.8
# to 1.2.
PRIOR_LOGIT, PRIOR_SPREAD = -0.3, 1.0
# Distances of the shift from its least value, in spreads of the disparity, and points of the grid;
# the second grid refines the remaining part of the first.
REACH, COARSE_POINTS, FINE_POINTS, NEGLIGIBLE = (0.004, 8.0), 48, 64, 1e-3
# Error of angles: this share of the spread of the posterior, which is too wide because planes have
# at most one vote each, and the error that remains without spread. tuned: 241 disparities with the
# errors of networks, true over stated 0.8 to 1.1 in bins from 1 to 5 degrees; 0.4 to 1 with all of
# the spread alone.
SPREAD_SHARE, LEAST_SIGMA_DEG = 0.6, 0.8
# The answer is refused above this uncertainty of angles. chosen: the spread of the posterior is
# then 8 degrees, where walls and floors can still be distinguished.
MAX_ANGLE_SIGMA_DEG = 5.0
# Planes closer to level or upright than this are named in the note. derived: three such errors.
NAMED_DEG = 15.0


@dataclass(frozen=True)
class ShiftEstimate:
    """A shift tau, with 1/z proportional to D + tau."""

    tau: float  # NaN if refused
    sigma: float  # standard deviation of tau
    angle_sigma_deg: float  # error of normals by the shift, root mean square over pixels
    note: str  # planes that determine it
    refusal: str = ''  # why there is no answer; empty if there is one

    @classmethod
    def refused(cls, reason: str) -> ShiftEstimate:
        """Return an estimate without an answer."""
        return cls(np.nan, np.nan, np.nan, '', reason)


def frames_about(down: np.ndarray, sigma_rad: float,
                 level_axes: np.ndarray) -> list[np.ndarray]:
    """
    Return equally likely directions (A, 3), the vertical first, with its mean and variance.

    Parameters
    ----------
    down : (3,) floating
        Unit direction of gravity.
    sigma_rad : float
        Its standard deviation, in each of two directions.
    level_axes : (0, 3) or (2, 3) floating
        Horizontal axes, if known.

    """
    aside = np.linalg.svd(down[None])[2][1:]
    frames = []
    for turn in np.sqrt(2) * sigma_rad * np.vstack([aside, -aside]):
        axes = unit_vectors(down + turn)[None]
        if len(level_axes):
            first = unit_vectors(level_axes[0] - (level_axes[0] @ axes[0]) * axes[0])
            axes = np.vstack([axes, first, np.cross(axes[0], first)])
        frames.append(axes)
    return frames


def estimate_shift(planes: DisparityPlanes, lowest: float, span: tuple[float, float, float],
                   frames: list[np.ndarray]) -> ShiftEstimate:
    """
    Return the shift that the planes determine with known directions, or refuse with a reason.

    Parameters
    ----------
    planes : DisparityPlanes
    lowest : float
        Disparity of the farthest pixels; depth must be positive there.
    span : tuple of float
        Disparity quantiles of 10, 50 and 90 %.
    frames : list of (A, 3) float64
        Equally likely directions: the vertical, then horizontal axes, if any.

    """
    planes = planes.largest()
    spread = span[2] - span[0]
    if not len(planes) or not spread > 0:
        return ShiftEstimate.refused('no plane is large enough')
    offset = spread * np.geomspace(*REACH, COARSE_POINTS)
    mass = _posterior(planes, offset - lowest, span, frames)
    kept = np.flatnonzero(mass > NEGLIGIBLE * mass.max())
    first, last = max(kept[0] - 1, 0), min(kept[-1] + 1, COARSE_POINTS - 1)
    tau = np.geomspace(offset[first], offset[last], FINE_POINTS) - lowest
    mass = _posterior(planes, tau, span, frames)
    estimate = float(np.interp(0.5, np.cumsum(mass) - mass / 2, tau))
    normals = unit_vectors(planes.normals(np.append(tau, estimate)))
    turned_rad = np.arccos((normals[:-1] * normals[-1]).sum(2).clip(-1, 1))
    weights = planes.pixel_share / planes.pixel_share.sum()
    spread_deg = float(np.degrees(np.sqrt(mass @ turned_rad**2 @ weights)))
    angle_sigma_deg = float(np.hypot(SPREAD_SHARE * spread_deg, LEAST_SIGMA_DEG))
    if angle_sigma_deg > MAX_ANGLE_SIGMA_DEG:
        return ShiftEstimate.refused('the planes and the directions leave angles uncertain by '
                                     f'{angle_sigma_deg:.0f} degrees')
    sigma = np.sqrt(mass @ (tau - estimate) ** 2) * angle_sigma_deg / max(spread_deg, 1e-9)
    return ShiftEstimate(estimate, float(sigma), angle_sigma_deg,
                         _what_determines(normals[-1], planes, frames))


def _posterior(planes: DisparityPlanes, tau: np.ndarray, span: tuple[float, float, float],
               frames: list[np.ndarray]) -> np.ndarray:
    """Return the probability (T,) of shifts (T,); their sum is 1."""
    raw = planes.normals(tau)
    length = np.linalg.norm(raw, axis=2)
    normals = raw / length[..., None]
    inverse = np.maximum(raw[..., 2] + (raw[..., :2] * planes.centers).sum(2), 1e-9 * length)
    # Variance of a normal across itself, the mean of two directions.
    covariance = planes.covariance
    along = np.einsum('tni,nij,tnj->tn', normals, covariance, normals, optimize=True)
    fit = (np.trace(covariance, axis1=1, axis2=2) - along) / 2
    known = np.maximum(fit, 0.0) / length**2 + BUILDING_RAD**2
    votes = planes.pixel_share / (planes.pixel_share + HALF_VOTE_SHARE)
    of_slopes = SLOPE_DENSITY * (np.log(inverse) - 3 * np.log(length))
    slope_errors = np.array(SLOPE_ERRORS)[:, None, None] * (span[2] - span[0]) / length
    sharp = 1 / (known + slope_errors**2)
    # One frame at a time, because arrays of all of them do not fit into the cache.
    log_mass = np.concatenate([
        (np.log(_density(normals, axes, sharp)) + of_slopes) @ votes for axes in frames])
    log_mass = np.logaddexp.reduce(log_mass, axis=0) + _log_prior(tau, span)
    mass = np.exp(log_mass - log_mass.max())
    return mass / mass.sum()


def _density(normals: np.ndarray, axes: np.ndarray, sharp: np.ndarray) -> np.ndarray:
    """
    Return the density (E, T, N) of normals relative to a uniform one on the half sphere.

    Parameters are the normals (T, N, 3), axes (A, 3), the first one vertical, and inverse
    variances (E, T, N).
    """
    off = np.arccos(np.abs(axes @ normals.reshape(-1, 3).T).clip(0, 1))
    off = off.reshape(len(axes), *normals.shape[:2])
    level, *across = (np.exp(square * sharp) for square in -0.5 * off**2)
    circle = np.sqrt(2 / np.pi * sharp) * np.exp(-0.5 * (np.pi / 2 - off[0]) ** 2 * sharp)
    along = LEVEL_SHARE * level
    for bell in across:
        along += AXIS_SHARE / len(across) * bell
    upright = UPRIGHT_SHARE if across else UPRIGHT_SHARE + AXIS_SHARE
    return FREE_SHARE + along * sharp + upright * circle


def _log_prior(tau: np.ndarray, span: tuple[float, float, float]) -> np.ndarray:
    """Return the log of the prior (T,) of the points of a grid of shifts."""
    far, near = np.maximum(span[0] + tau, 1e-9 * (span[2] - span[0])), span[2] + tau
    logit = np.log(far) - np.log(near - far)
    return (-0.5 * ((logit - PRIOR_LOGIT) / PRIOR_SPREAD) ** 2
            + np.log(np.maximum(np.gradient(logit), 1e-12)))


def _what_determines(normals: np.ndarray, planes: DisparityPlanes,
                     frames: list[np.ndarray]) -> str:
    """Return a text on level and upright planes for the normals (N, 3) of the answer."""
    downs = np.array([axes[0] for axes in frames])
    if (np.abs(downs @ downs[0]) < np.cos(np.radians(NAMED_DEG))).any():
        off_deg = np.degrees(np.arccos(np.abs(normals @ downs.T).max(axis=1).clip(0, 1)))
        return f'{planes.pixel_share[off_deg < NAMED_DEG].sum():.0%} across one of the axes'
    down = unit_vectors(downs.mean(axis=0))
    rise_deg = np.degrees(np.arcsin(np.abs(normals @ down).clip(0, 1)))
    words = [f'{planes.pixel_share[is_so].sum():.0%} {name}' for is_so, name in (
        (rise_deg > 90 - NAMED_DEG, 'level'),
        (rise_deg < NAMED_DEG, 'upright')) if is_so.any()]
    return ', '.join(words)
