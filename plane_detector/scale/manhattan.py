# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Shift of a disparity from right angles: the Manhattan world of Coughlan and Yuille (1999).

The normal of a plane (p, q, r) of D = p x + q y + r is proportional to (p, q, r + tau). Two planes
are perpendicular if tau is a root of tau^2 + (r1 + r2) tau + p1 p2 + q1 q2 + r1 r2 = 0. Every pair
of planes proposes its roots; each is scored by the pixels of all planes along three perpendicular
axes. A room without right angles leaves many planes off the axes, or has several shifts with
similar scores; the vote then refuses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.scale.disparity_planes import DisparityPlanes

MAX_PLANES = 16
MIN_PIXEL_SHARE = 0.004
# A normal is off its axis beyond 3 sigma of its fit, limited to this range.
MIN_TOLERANCE_DEG, MAX_TOLERANCE_DEG = 2.0, 5.0
SYSTEMATIC_DEG = 1.0
POORLY_KNOWN_DEG = 4.0
MIN_ALIGNED_SHARE = 0.68
MIN_AXIS_SHARE = 0.04
MIN_DISTINCT_PLANES = 3
# A shift is not determined if its standard deviation turns a large plane by more.
MAX_UNSURE_DEG = 5.0
# The answer is ambiguous if another shift has this share of the votes.
RIVAL_SHARE = 0.85
# Also if another one has as many planes horizontal or vertical, within this share of the pixels: a
# low camera in a hexagonal room sees a floor that is horizontal for any shift.
UPRIGHT_MARGIN = 0.03


@dataclass(frozen=True)
class ManhattanVote:
    """
    Shift estimated from right angles.

    Attributes
    ----------
    tau : float
        1/z is proportional to D + tau; NaN if the vote refuses.
    sigma : float
        Standard deviation of tau.
    axes : (3, 3) float64
        Rows: unit axes in the camera frame.
    refusal : str
        Why there is no answer; empty if there is one.

    """

    tau: float
    sigma: float
    axes: np.ndarray
    refusal: str

    @classmethod
    def refused(cls, reason: str) -> ManhattanVote:
        """Return a vote without an answer."""
        return cls(np.nan, np.nan, np.full((3, 3), np.nan), reason)


@dataclass(frozen=True)
class _Frames:
    """C shifts, each with a frame of axes, scored on N planes."""

    tau: np.ndarray          # (C,)
    axes: np.ndarray         # (C, 3, 3), rows are axes
    axis: np.ndarray         # (C, N) int, index of the axis that each plane is aligned with, or -1
    weight: np.ndarray       # (C, N) pixel share, less where the normal is poorly known
    votes: np.ndarray        # (C,) weight of the aligned planes, less if barely aligned
    upright: np.ndarray      # (C,) the same for planes along or across the best single axis


def estimate_manhattan_shift(planes: DisparityPlanes, lowest_disparity: float,
               gravity_camera: np.ndarray | None = None,
               down_tolerance_deg: float = 0.0) -> ManhattanVote:
    """
    Find the shift that aligns the planes with three perpendicular axes, or refuse.

    Parameters
    ----------
    planes : DisparityPlanes
    lowest_disparity : float
        Disparity of the farthest pixels; depth must be positive there.
    gravity_camera : (3,) floating, optional
        Unit direction of gravity; one of the axes must agree with it.
    down_tolerance_deg : float
        Largest angle between them.

    Returns
    -------
    ManhattanVote

    """
    planes = largest(planes)
    tau, axes = _proposals(planes.coefficients, -lowest_disparity)
    if gravity_camera is not None:
        off_deg = np.degrees(np.arccos(np.abs(axes @ gravity_camera).max(1).clip(0, 1)))
        upright = off_deg <= down_tolerance_deg + MAX_TOLERANCE_DEG
        tau, axes = tau[upright], axes[upright]
    if len(planes) < MIN_DISTINCT_PLANES or not len(tau):
        return ManhattanVote.refused(
            'fewer than three planes, or none of them can be perpendicular')
    frames = _judge(planes, tau, axes)
    best = int(frames.votes.argmax())
    tau, sigma, axes = _refine(planes, frames, best, -lowest_disparity)
    winner = _judge(planes, np.array([tau]), axes[None])
    objection = _reason_to_refuse(planes, winner, frames, sigma)
    if objection:
        return ManhattanVote.refused(objection)
    return ManhattanVote(tau, sigma, axes, '')


def largest(planes: DisparityPlanes) -> DisparityPlanes:
    """Return the planes that may vote, the largest first."""
    order = np.argsort(-planes.pixel_share)[:MAX_PLANES]
    return planes.take(order[planes.pixel_share[order] >= MIN_PIXEL_SHARE])


def _proposals(coefficients: np.ndarray, lowest_tau: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the shifts (C,) that make some pair perpendicular, and the axes of these pairs."""
    i, j = np.triu_indices(len(coefficients), 1)
    first, second = coefficients[i], coefficients[j]
    middle = -0.5 * (first[:, 2] + second[:, 2])
    # Noise may make a double root complex (both planes contain the direction of the axis).
    reach = np.sqrt(np.maximum(middle**2 - (first * second).sum(1), 0.0))
    tau = np.concatenate([middle - reach, middle + reach])
    first, second = np.tile(first, (2, 1)), np.tile(second, (2, 1))
    first[:, 2] += tau
    second[:, 2] += tau
    x = _unit(first)
    y = second - (second * x).sum(1, keepdims=True) * x
    possible = (tau > lowest_tau) & (np.linalg.norm(y, axis=1) > 1e-9)
    y = _unit(y)
    return tau[possible], np.stack([x, y, np.cross(x, y)], axis=1)[possible]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def _normals(planes: DisparityPlanes, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals (C, N, 3) and their standard deviation in degrees (C, N)."""
    raw = np.repeat(planes.coefficients[None], len(tau), axis=0)
    raw[..., 2] += tau[:, None]
    normals = _unit(raw)
    covariance = planes.covariance
    along = np.einsum('cni,nij,cnj->cn', normals, covariance, normals)
    across = np.maximum(np.trace(covariance, axis1=1, axis2=2) - along, 0.0) / 2
    length = np.linalg.norm(raw, axis=-1)
    return normals, np.degrees(np.arctan2(np.sqrt(across), length))


def _judge(planes: DisparityPlanes, tau: np.ndarray, axes: np.ndarray) -> _Frames:
    """Sum the pixels of the planes along the axes of each frame."""
    normals, sigma_deg = _normals(planes, tau)
    cosine = np.abs(np.einsum('cni,cki->cnk', normals, axes))
    angle_deg = np.degrees(np.arccos(cosine.clip(0, 1)))
    tolerance_deg = np.clip(3 * sigma_deg, MIN_TOLERANCE_DEG, MAX_TOLERANCE_DEG)[..., None]
    weight = planes.pixel_share / (1.0 + (sigma_deg / POORLY_KNOWN_DEG) ** 2)
    along = _fit(angle_deg, tolerance_deg)
    across = _fit(90.0 - angle_deg, tolerance_deg)
    best = along.max(-1)
    return _Frames(tau, axes, np.where(best > 0, along.argmax(-1), -1), weight,
                   (best * weight).sum(1),
                   (np.maximum(along, across) * weight[..., None]).sum(1).max(1))


def _fit(off_deg: np.ndarray, tolerance_deg: np.ndarray) -> np.ndarray:
    """Return 1 at no deviation, one half at the tolerance and 0 beyond."""
    return np.where(off_deg <= tolerance_deg, 1.0 - 0.5 * (off_deg / tolerance_deg) ** 2, 0.0)


def _refine(planes: DisparityPlanes, frames: _Frames, best: int, lowest_tau: float):
    """Return the shift, its standard deviation and the axes that best fit the aligned planes."""
    aligned = frames.axis[best] >= 0
    members, axis = planes.take(np.flatnonzero(aligned)), frames.axis[best][aligned]
    start, axes = frames.tau[best], frames.axes[best]
    _, sigma_deg = _normals(members, np.array([start]))
    weights = 1.0 / (sigma_deg[0] ** 2 + SYSTEMATIC_DEG**2)

    # Here, because a node with measured depth does not need it: scipy takes 46 MB.
    from scipy.optimize import minimize_scalar

    def misfit(tau: float) -> float:
        return _align(members, tau, axes, axis, weights)[0]

    reach = np.linalg.norm(members.coefficients + [0, 0, start], axis=1).max()
    found = minimize_scalar(misfit, bounds=(max(start - reach / 4, lowest_tau),
                                            start + reach / 4), method='bounded',
                            options={'xatol': 1e-5 * reach})
    step = 0.01 * reach
    curvature = (misfit(found.x + step) - 2 * found.fun + misfit(found.x - step)) / step**2
    return (found.x, float(np.sqrt(2.0 / max(curvature, 1e-12))),
            _align(members, found.x, axes, axis, weights)[1])


def _align(planes: DisparityPlanes, tau: float, axes: np.ndarray, axis: np.ndarray,
           weights: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the weighted squared angle (deg^2) to the best rotated axes, and these axes."""
    normals = _normals(planes, np.array([tau]))[0][0]
    for _ in range(3):
        signs = np.sign((normals * axes[axis]).sum(1, keepdims=True))
        correlation = np.zeros((3, 3))
        np.add.at(correlation, axis, weights[:, None] * signs * normals)
        left, _, right = np.linalg.svd(correlation)
        axes = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    sine2 = 1.0 - (normals * axes[axis]).sum(1) ** 2
    return float(np.degrees(1) ** 2 * (weights * sine2).sum()), axes


def _reason_to_refuse(planes: DisparityPlanes, winner: _Frames, frames: _Frames,
                      sigma: float) -> str:
    """Return why the best shift is not reliable; empty if it is."""
    axis, share = winner.axis[0], winner.weight[0] / winner.weight[0].sum()
    aligned = share[axis >= 0].sum()
    if aligned < MIN_ALIGNED_SHARE:
        return f'only {aligned:.0%} of the planes lie along three perpendicular axes'
    supported = [share[axis == k].sum() >= MIN_AXIS_SHARE for k in range(3)]
    if sum(supported) < 2 or _distinct(
            planes.take(np.flatnonzero(axis >= 0))) < MIN_DISTINCT_PLANES:
        return 'two planes are perpendicular for some shift in any room; a third must agree'
    large = planes.pixel_share >= MIN_AXIS_SHARE
    unsure_deg = turn_deg(planes, winner.tau, winner.tau + sigma)[0, large].max(initial=0.0)
    if unsure_deg > MAX_UNSURE_DEG:
        return f'the right angles leave the angle of a plane uncertain by {unsure_deg:.0f} degrees'
    apart = turn_deg(planes, winner.tau, frames.tau) @ planes.pixel_share > MAX_TOLERANCE_DEG
    rival = frames.votes[apart].max(initial=0.0)
    if rival > RIVAL_SHARE * winner.votes[0]:
        return 'another shift gives as many right angles'
    if frames.upright[apart].max(initial=0.0) > winner.upright[0] - UPRIGHT_MARGIN:
        return 'another shift makes as many planes vertical, with other angles between them'
    return ''


def turn_deg(planes: DisparityPlanes, tau: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angle by which each plane turns from a shift (1,) to others, (C, N) degrees."""
    here, there = _normals(planes, tau)[0], _normals(planes, other)[0]
    return np.degrees(np.arccos((here * there).sum(-1).clip(-1, 1)))


def _distinct(planes: DisparityPlanes) -> int:
    """Count the planes, without those that continue a larger one."""
    centers = np.column_stack([planes.centers, np.ones(len(planes))])
    predicted = planes.coefficients @ centers.T
    spread = np.ptp(predicted.diagonal()) + 1e-30
    same = np.abs(predicted - predicted.diagonal()[None, :]) < 0.03 * spread
    coplanar = np.triu(same & same.T, 1)
    return int((~coplanar.any(0)).sum())
