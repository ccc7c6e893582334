# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Common axes of the planes of good depth, as opposed to those of misleading lines.

The lines of stripes, posters and diagonal tiles may agree on axes that no plane has. The planes
decide: if their normals are as accurate as they seem, most are along the true axes within half a
degree, and along false axes only by chance.

1. Every two planes that may be perpendicular propose axes. The most likely proposal is fitted to
   the planes near it, weighted by their errors.
2. Its prior is the posterior of the axes from the lines, with the probability that these are
   wrong. It is the mass of all axes that fit the planes equally well, so that inaccurate planes
   gain nothing from the choice of axes.
3. All planes are oriented with both; their own axes are used if prior times likelihood is larger,
   and if the median error of the normals about them is below that of usual networks. Where own
   axes are right it is at most 6 degrees (rooms with misleading pictures, errors up to 5 %), in
   the 4 of 64 frames through fastdepth that took theirs, 2 to 12 degrees off, 14 to 20.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.directions.prior import held_density
from plane_detector.directions.vanishing import MIN_PROBABILITY, SceneDirections

# Error of the normals of depth that is good enough to contradict lines, whatever its bend allows.
# chosen: between those of smooth noise of .002 and of .008 per metre on large planes.
OWN_SIGMA_RAD = np.radians(1.0)
# Votes of each plane: their errors are not independent. tuned: rooms with misleading pictures,
# even seeds 400 to 410 and 300 to 311: from 0.7 to 1 own axes are right where they are taken; of
# 26 frames through fastdepth none is given its own axes up to 0.85, one wrong ones at 1.
PLANE_VOTE = 0.85
# Probability that the main axis of the lines is wrong although they are sure, as calibrated. The
# true vertical is then that of a camera as it is held, at any azimuth.
WRONG = 0.02
# The largest planes propose axes if they are perpendicular within this angle; the fit moves these.
PROPOSING, PROPOSAL_RAD, FIT_ROUNDS = 8, np.radians(10.0), 3
# derived: for axes whose signs and order have no meaning.
ALL_AZIMUTHS = np.pi / 2


def axes_of_planes(normals: np.ndarray, variances: np.ndarray,
                   lines: SceneDirections) -> tuple[SceneDirections | None, float]:
    """
    Return the axes of planes, and the log of their prior.

    Parameters
    ----------
    normals : (K, 3) float64
        The largest plane first.
    variances : (K,) float64
        Of the normals, rad^2, if the error of the network is OWN_SIGMA_RAD.
    lines : SceneDirections
        From the lines, with a main axis.

    Returns
    -------
    own : SceneDirections or None
        None if no two planes can be perpendicular.
    log_prior : float

    """
    axes = _best_proposal(normals, variances)
    if axes is None:
        return None, -np.inf
    axes, variance = _fitted(axes, normals, variances)
    along = axes @ lines.main_axis
    main = np.abs(along).argmax()
    axis = axes[main] * np.sign(along[main])
    own = replace(lines, **{('open_axis' if lines.gravity_camera is None else
                             'gravity_camera'): axis},
                  covariance=variance * (np.eye(3) - np.outer(axis, axis)),
                  pairs=np.delete(axes, main, axis=0)[None])
    return own, _log_prior(own, variance, lines)


def _best_proposal(normals: np.ndarray, variances: np.ndarray) -> np.ndarray | None:
    """Return the axes (3, 3), among those of two perpendicular planes, with most planes."""
    large = normals[:PROPOSING]
    first, second = np.nonzero(np.abs(large @ large.T) < np.sin(PROPOSAL_RAD))
    if not len(first):
        return None
    x = normals[first]
    y = normals[second] - (normals[second] * x).sum(1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    frames = np.stack([x, y, np.cross(x, y)], axis=1)
    off_rad = _angle_rad(frames @ normals.T).min(1)
    return frames[np.log1p(np.exp(-0.5 * off_rad**2 / variances) / variances).sum(1).argmax()]


def _fitted(axes: np.ndarray, normals: np.ndarray,
            variances: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the axes rotated to the normals near them, and the variance of that rotation."""
    for _ in range(FIT_ROUNDS):
        cosine = normals @ axes.T
        nearest = np.abs(cosine).argmax(1)
        near = np.eye(3)[nearest]
        off_rad = _angle_rad((cosine * near).sum(1))
        weights = np.exp(-0.5 * off_rad**2 / variances) / variances
        # The rotation of the axes with the largest sum of weights times cosines (Kabsch).
        moment = (weights[:, None] * near * np.sign(cosine)).T @ normals
        left, _, right = np.linalg.svd(moment + axes)  # which stay where no plane rotates them
        axes = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return axes, 1 / (1 + weights.sum())


def _log_prior(own: SceneDirections, variance: float, lines: SceneDirections) -> float:
    """Return the log of the prior mass of axes that planes determine with a variance."""
    of_lines = np.trace(lines.covariance) / 2
    sharp = min(1.0, variance / of_lines)
    is_wrong = 1 - lines.main_probability + WRONG
    off_rad = np.arccos(np.clip(own.main_axis @ lines.main_axis, -1, 1))
    right = (1 - is_wrong) * sharp * np.exp(-0.5 * off_rad**2 / of_lines)
    axes = np.vstack([own.main_axis[None], own.pairs[0]])
    possible = (np.concatenate([axes, -axes]) if own.gravity_camera is None else axes[:1])
    held = sum(held_density(down) for down in possible)
    wrong = is_wrong * 2 * np.pi * variance * held
    anywhere = azimuth = np.sqrt(2 * np.pi * variance) / ALL_AZIMUTHS
    if len(lines.pairs):
        off_rad = _angle_rad(own.pairs[0] @ lines.pairs[0, 0]).min()
        azimuth = (MIN_PROBABILITY * np.sqrt(sharp) * np.exp(-0.5 * off_rad**2 / of_lines)
                   + (1 - MIN_PROBABILITY) * anywhere)
    return float(np.log(right * azimuth + wrong * anywhere))


def _angle_rad(cosine: np.ndarray) -> np.ndarray:
    """Return the angles between axes, whose signs have no meaning."""
    return np.arccos(np.clip(np.abs(cosine), 0, 1))
