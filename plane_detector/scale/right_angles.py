# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Perpendicular axes of the planes of a disparity of unknown shift, without any other knowledge.

The normal of a plane (p, q, r) of D = p x + q y + r is proportional to (p, q, r + tau).

1. Every two planes propose the shifts for which they are perpendicular, the roots of
   tau^2 + (r1 + r2) tau + p1 p2 + q1 q2 + r1 r2 = 0, and with them three axes: the Manhattan world
   of Coughlan and Yuille (1999).
2. Each proposal is scored by the pixels of all planes perpendicular to its axes.
3. The best one is fitted to its planes: the shift, and a rotation of the axes.
4. A room without right angles leaves many planes off the axes, or has several shifts with similar
   scores; then there is no answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.geometry.rigid_transform import unit_vectors
from plane_detector.scale.disparity_planes import DisparityPlanes

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
# It is also ambiguous if another shift makes as many planes horizontal or vertical, within this
# share of the pixels: a low camera in a hexagonal room sees a floor that is horizontal for any
# shift.
UPRIGHT_MARGIN = 0.03
ROUNDS = 6


@dataclass(frozen=True)
class PerpendicularAxes:
    """Axes that planes have in common."""

    # (3, 3) float64: rows: unit axes in the camera frame, that of the vertical first, downwards
    axes: np.ndarray
    refusal: str  # why there is no answer; empty if there is one


@dataclass(frozen=True)
class _ScoredShifts:
    """C shifts, each with A axes, and how well N planes fit them: 1 exactly, 0 not at all."""

    tau: np.ndarray          # (C,)
    axes: np.ndarray         # (C, A, 3)
    along: np.ndarray        # (C, N, A) normals along the axes
    across: np.ndarray       # (C, N, A) normals across the axes
    weight: np.ndarray       # (C, N) pixel share, less where the normal is poorly known

    def take(self, index: np.ndarray) -> _ScoredShifts:
        return _ScoredShifts(self.tau[index], self.axes[index], self.along[index],
                             self.across[index], self.weight[index])


def find_perpendicular_axes(planes: DisparityPlanes, lowest_disparity: float,
                            down: np.ndarray | None = None,
                            tolerance_deg: float = 0.0) -> PerpendicularAxes:
    """
    Find three perpendicular axes with which the planes are aligned at some shift, or refuse.

    Parameters
    ----------
    planes : DisparityPlanes
    lowest_disparity : float
        Disparity of the farthest pixels; depth must be positive there.
    down : (3,) floating, optional
        Unit direction of gravity; one of the axes must agree with it. Without it, the first axis
        is the one closest to that of a camera held upright.
    tolerance_deg : float
        Largest angle between them.

    """
    planes = planes.largest()
    tau, axes = _shifts_of_pairs(planes.coefficients, -lowest_disparity)
    if down is not None:
        off_deg = np.degrees(np.arccos(np.abs(axes @ down).max(1).clip(0, 1)))
        upright = off_deg <= tolerance_deg + MAX_TOLERANCE_DEG
        tau, axes = tau[upright], axes[upright]
    if len(planes) < MIN_DISTINCT_PLANES or not len(tau):
        return _refused('fewer than three planes, or none of them can be perpendicular')
    shifts = _score(planes, tau, axes)
    best, sigma = _refined(planes, shifts.take([_votes(shifts).argmax()]))
    objection = _objection(planes, best, shifts, sigma)
    if objection:
        return _refused(objection)
    upright = best.axes[0] @ ([0.0, 1.0, 0.0] if down is None else down)
    order = np.argsort(-np.abs(upright))
    return PerpendicularAxes(best.axes[0][order] * np.sign(upright[order[0]]), '')


def _refused(reason: str) -> PerpendicularAxes:
    return PerpendicularAxes(np.full((3, 3), np.nan), reason)


def _shifts_of_pairs(coefficients: np.ndarray,
                     lowest_tau: float) -> tuple[np.ndarray, np.ndarray]:
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
    x = unit_vectors(first)
    y = second - (second * x).sum(1, keepdims=True) * x
    possible = (tau > lowest_tau) & (np.linalg.norm(y, axis=1) > 1e-9)
    y = unit_vectors(y)
    return tau[possible], np.stack([x, y, np.cross(x, y)], axis=1)[possible]


def _normals(planes: DisparityPlanes, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (C, N, 3), not of unit length, and their errors in degrees (C, N)."""
    raw = planes.normals(tau)
    normals, covariance = unit_vectors(raw), planes.covariance
    along = np.einsum('cni,nij,cnj->cn', normals, covariance, normals)
    across = np.maximum(np.trace(covariance, axis1=1, axis2=2) - along, 0.0) / 2
    return raw, np.degrees(np.arctan2(np.sqrt(across), np.linalg.norm(raw, axis=-1)))


def _score(planes: DisparityPlanes, tau: np.ndarray, axes: np.ndarray) -> _ScoredShifts:
    """Return how well the planes fit shifts (C,) and axes (C, A, 3)."""
    raw, sigma_deg = _normals(planes, tau)
    cosine = np.abs(np.einsum('cni,cki->cnk', unit_vectors(raw), axes))
    off_deg = np.degrees(np.arccos(cosine.clip(0, 1)))
    tolerance_deg = np.clip(3 * sigma_deg, MIN_TOLERANCE_DEG, MAX_TOLERANCE_DEG)[..., None]
    along, across = (np.where(off <= tolerance_deg, 1.0 - 0.5 * (off / tolerance_deg) ** 2, 0.0)
                     for off in (off_deg, 90.0 - off_deg))
    return _ScoredShifts(tau, axes, along, across,
                         planes.pixel_share / (1.0 + (sigma_deg / POORLY_KNOWN_DEG) ** 2))


def _votes(scored: _ScoredShifts) -> np.ndarray:
    """Return the weight (C,) of the planes along an axis."""
    return (scored.along.max(2) * scored.weight).sum(1)


def _refined(planes: DisparityPlanes, best: _ScoredShifts) -> tuple[_ScoredShifts, float]:
    """Fit a shift to the planes along its axes, which rotate with them; with its sigma."""
    for _ in range(ROUNDS):
        raw, sigma_deg = _normals(planes, best.tau)
        length, normals = np.linalg.norm(raw[0], axis=1)[:, None], unit_vectors(raw[0])
        axes = best.axes[0]
        near = axes[best.along[0].argmax(1)]
        near = near * np.sign((near * normals).sum(1, keepdims=True))
        weight = (best.along[0].max(1) / (sigma_deg[0] ** 2 + SYSTEMATIC_DEG**2))[:, None]
        # Derivatives of normal - axis by a share of the shift, and by a rotation of the axes.
        reach = length.max()
        by_shift = reach / length * ([0.0, 0.0, 1.0] - normals[:, 2:] * normals)
        by_turn = np.stack([np.cross(near, one) for one in np.eye(3)], axis=2)
        design = np.concatenate([by_shift[..., None], by_turn], axis=2)
        root = np.degrees(np.sqrt(weight))
        design, misfit = (root[..., None] * design).reshape(-1, design.shape[2]), root * (
            normals - near)
        step = np.linalg.lstsq(design, -misfit.ravel(), rcond=1e-9)[0]
        tau = best.tau + reach * step[:1]
        axes = axes @ cv2.Rodrigues(step[1:])[0].T
        best = _score(planes, tau, axes[None])
    variance = np.linalg.pinv(design.T @ design, rcond=1e-12)[0, 0]
    return best, float(reach * np.sqrt(variance))


def _turn_deg(planes: DisparityPlanes, tau: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the rotation of each plane between a shift (1,) and others, (C, N) degrees."""
    here, there = (unit_vectors(planes.normals(one)) for one in (tau, other))
    return np.degrees(np.arccos((here * there).sum(-1).clip(-1, 1)))


def _objection(planes: DisparityPlanes, best: _ScoredShifts, shifts: _ScoredShifts,
               sigma: float) -> str:
    """Return why the best shift of three perpendicular axes is not reliable; empty if it is."""
    along, share = best.along[0], best.weight[0] / best.weight[0].sum()
    is_aligned = along.max(1) > 0
    aligned = share[is_aligned].sum()
    if aligned < MIN_ALIGNED_SHARE:
        return f'only {aligned:.0%} of the planes lie along three perpendicular axes'
    of_axis = np.bincount(along.argmax(1)[is_aligned], share[is_aligned], 3)
    if np.count_nonzero(of_axis >= MIN_AXIS_SHARE) < 2 or _distinct(
            planes.take(np.flatnonzero(is_aligned))) < MIN_DISTINCT_PLANES:
        return 'two planes are perpendicular for some shift in any room; a third must agree'
    large = planes.pixel_share >= MIN_AXIS_SHARE
    unsure_deg = _turn_deg(planes, best.tau, best.tau + sigma)[0, large].max(initial=0.0)
    if unsure_deg > MAX_UNSURE_DEG:
        return f'the right angles leave the angle of a plane uncertain by {unsure_deg:.0f} degrees'
    # Shifts that rotate the planes too far to count as the same.
    apart = _turn_deg(planes, best.tau, shifts.tau) @ planes.pixel_share > MAX_TOLERANCE_DEG
    if _votes(shifts)[apart].max(initial=0.0) > RIVAL_SHARE * _votes(best)[0]:
        return 'another shift gives as many right angles'
    if _upright(shifts)[apart].max(initial=0.0) > _upright(best)[0] - UPRIGHT_MARGIN:
        return 'another shift makes as many planes vertical, with other angles between them'
    return ''


def _upright(scored: _ScoredShifts) -> np.ndarray:
    """Return the weight (C,) of the planes along or across the best single axis."""
    fit = np.maximum(scored.along, scored.across)
    return (fit * scored.weight[..., None]).sum(1).max(1)


def _distinct(planes: DisparityPlanes) -> int:
    """Count the planes, without those that continue a larger one."""
    centers = np.column_stack([planes.centers, np.ones(len(planes))])
    predicted = planes.coefficients @ centers.T
    spread = np.ptp(predicted.diagonal()) + 1e-30
    same = np.abs(predicted - predicted.diagonal()[None, :]) < 0.03 * spread
    coplanar = np.triu(same & same.T, 1)
    return int((~coplanar.any(0)).sum())
