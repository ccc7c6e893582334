# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Shift of a disparity from known directions: an estimate of one unknown.

A plane (p, q, r) of D = p x + q y + r has a normal proportional to (p, q, r + tau). It is
perpendicular to an axis a if that is a multiple of a: p and q give the multiple, and r the shift,
tau = (p ax + q ay) / (ax^2 + ay^2) az - r. It is vertical if the normal is perpendicular to the
direction of gravity g: tau = -(p gx + q gy) / gz - r. Every plane and axis proposes a shift; the
one for which most pixels are on planes perpendicular to an axis, or vertical, is refined.
"""

from __future__ import annotations

import numpy as np

from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.manhattan import (
    MAX_TOLERANCE_DEG,
    MIN_AXIS_SHARE,
    RIVAL_SHARE,
    ManhattanVote,
    largest,
    turn_deg,
)

# A vertical plane of any azimuth fixes one of two degrees of freedom, so it has less weight.
UPRIGHT_WEIGHT = 0.5
# tuned: simulated relative networks on real frames, and rooms, attics and hexagons of seeds 300 to
# 311: at 0.5 45 of 50 and 29 of 30 answers on Kinect and NYU frames, median error of the
# wall-floor angle 1.3 and 1.1 degrees; at 0.6 28 and 26, 1.1 and 1.1; no room is bent at either.
MIN_EXPLAINED_SHARE = 0.5
# derived: some shift makes any single plane perpendicular to an axis.
MIN_AGREEING = 2
ROUNDS = 5
# Sine of the angle to the optical axis; an axis closer to it does not determine the shift.
MIN_ASLANT = 0.1


def estimate_shift(planes: DisparityPlanes, lowest_disparity: float,
                   axes: np.ndarray) -> ManhattanVote:
    """
    Find the shift that agrees with known directions, or refuse with a reason.

    Parameters
    ----------
    planes : DisparityPlanes
    lowest_disparity : float
        Disparity of the farthest pixels; depth must be positive there.
    axes : (A, 3) float64
        Gravity first, then horizontal axes, if any.

    Returns
    -------
    ManhattanVote

    """
    planes = largest(planes)
    shifts = _proposals(planes.coefficients, axes)
    shifts = shifts[shifts > -lowest_disparity]
    if not len(shifts):
        return ManhattanVote.refused('no plane can lie along the known directions')
    support = _support(planes, shifts, axes)
    score = support.sum((1, 2))
    best = int(score.argmax())
    tau = _refined(planes, shifts[best], axes)
    if not tau > -lowest_disparity:
        tau = shifts[best]
    final = _support(planes, np.array([tau]), axes)[0]
    apart = turn_deg(planes, np.array([tau]), shifts) @ planes.pixel_share > MAX_TOLERANCE_DEG
    objection = _reason_to_refuse(planes, final, score[apart].max(initial=0.0))
    if objection:
        return ManhattanVote.refused(objection)
    return ManhattanVote(tau, _sigma(planes, tau, axes), axes, '')


def _proposals(coefficients: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the shifts (C,) for which some plane is vertical or perpendicular to an axis."""
    p, q, r = coefficients.T[:, :, None]
    x, y, z = axes.T
    aslant = x * x + y * y
    across = np.where(aslant > MIN_ASLANT**2, (p * x + q * y) / np.maximum(aslant, 1e-12) * z - r,
                      np.nan)
    down = axes[0]
    upright = np.full_like(r, np.nan)
    if abs(down[2]) > MIN_ASLANT:
        upright = -(p * down[0] + q * down[1]) / down[2] - r
    shifts = np.concatenate([across.ravel(), upright.ravel()])
    return shifts[np.isfinite(shifts)]


def _support(planes: DisparityPlanes, shifts: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the weights (C, N, 2) of planes perpendicular to an axis, and of vertical ones."""
    raw = planes.coefficients + np.array([0.0, 0.0, 1.0]) * shifts[:, None, None]
    normals = raw / np.maximum(np.linalg.norm(raw, axis=-1, keepdims=True), 1e-30)
    cosine = np.abs(normals @ axes.T)
    along = _fit(np.degrees(np.arccos(cosine.max(-1).clip(0, 1))))
    upright = UPRIGHT_WEIGHT * _fit(np.degrees(np.arcsin(cosine[..., 0].clip(0, 1))))
    best = np.stack([along, np.where(upright > along, upright, 0.0)], -1)
    best[..., 0] = np.where(upright > along, 0.0, along)
    return best * planes.pixel_share[:, None]


def _fit(off_deg: np.ndarray) -> np.ndarray:
    return np.maximum(1.0 - (off_deg / MAX_TOLERANCE_DEG) ** 2, 0.0)


def _refined(planes: DisparityPlanes, tau: float, axes: np.ndarray) -> float:
    """Return the weighted mean of the proposals of the agreeing planes, iterated."""
    for _ in range(ROUNDS):
        axis, weight = _members(planes, tau, axes)
        if not weight.sum() > 0:
            break
        # The component of (p, q, r + tau) perpendicular to its axis must vanish: linear in tau.
        raw = planes.coefficients + [0.0, 0.0, tau]
        across = raw - (raw * axis).sum(1, keepdims=True) * axis
        slope = np.array([0.0, 0.0, 1.0]) - axis[:, 2:] * axis
        length = np.maximum((raw**2).sum(1), 1e-30)
        tau -= ((weight / length * (across * slope).sum(1)).sum()
                / max((weight / length * (slope**2).sum(1)).sum(), 1e-12))
    return float(tau)


def _members(planes: DisparityPlanes, tau: float,
             axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis (N, 3) of each plane and its weight (N,), 0 if it fits none."""
    raw = planes.coefficients + [0.0, 0.0, tau]
    cosine = raw @ axes.T / np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-30)
    nearest = np.abs(cosine).argmax(1)
    off_deg = np.degrees(np.arccos(np.abs(cosine).max(1).clip(0, 1)))
    return axes[nearest], planes.pixel_share * _fit(off_deg)


def _sigma(planes: DisparityPlanes, tau: float, axes: np.ndarray) -> float:
    """Return the standard deviation of the shift from the scatter of the planes' proposals."""
    axis, weight = _members(planes, tau, axes)
    raw = planes.coefficients + [0.0, 0.0, tau]
    across = raw - (raw * axis).sum(1, keepdims=True) * axis
    slope = np.array([0.0, 0.0, 1.0]) - axis[:, 2:] * axis
    length = np.maximum((raw**2).sum(1), 1e-30)
    own = (across * slope).sum(1) / np.maximum((slope**2).sum(1), MIN_ASLANT**2)
    used = weight / length * (slope**2).sum(1)
    variance = (used * own**2).sum() / max(used.sum(), 1e-12)
    return float(np.sqrt(variance / max(np.count_nonzero(used) - 1, 1)))


def _reason_to_refuse(planes: DisparityPlanes, support: np.ndarray, rival: float) -> str:
    # A vertical plane agrees as well as any other; it only tells less of the shift.
    explained = (support / [1, UPRIGHT_WEIGHT]).sum() / planes.pixel_share.sum()
    if explained < MIN_EXPLAINED_SHARE:
        return f'only {explained:.0%} of the planes agree with the known directions'
    if support[:, 0].max() < MIN_AXIS_SHARE:
        return 'no large plane lies across a known direction'
    if np.count_nonzero(support.sum(1)) < MIN_AGREEING:
        return 'one plane lies along the known directions for some shift in any room'
    if rival > RIVAL_SHARE * support.sum():
        return 'another shift agrees as well with the known directions'
    return ''
