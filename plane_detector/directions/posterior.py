# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Posterior of the vertical and of the azimuth of the scene.

1. A grid contains every frame of three perpendicular axes once; each axis, up or down, may be the
   vertical. The prior consists of the mountings of cameras (upright, on a side, upside down,
   looking straight down) or a coarse direction of gravity, and of the modes of previous views.
2. Each line segment points to one of the axes, with an error that depends on its length, or
   anywhere; the share of the latter is that of the best coarse cell. Segments of one line share
   one vote.
3. Each surface of the depth has a normal along one of the axes, horizontal, or arbitrary, with the
   error for which these normals alone are most likely, and one vote regardless of its size.
4. The evidence of lines is tempered: edges of one object are not independent.
5. The grid is coarse at first; its best cells are subdivided once. The mass of the verticals
   within 5 degrees of an answer is the probability that it is right. The mass of all frames with a
   given axis is the probability of that axis, whichever side is down.

References
----------
Coughlan, Yuille: Manhattan world: compass direction from a single image by Bayesian inference,
ICCV 1999 (maximises such a mixture; here its mass is needed).

"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from plane_detector.directions.likelihood import (
    MIN_IMAGE_LENGTH2,
    NORMAL_DEG,
    STRAY_LINES,
    STRAY_PRIOR_VOTES,
    STRAY_ROUNDS,
    Evidence,
    line_table,
    log_likelihood,
)
from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.prior import (
    HELD_DEG,
    TAKEN_AS_UPRIGHT,
    Expected,
    Modes,
    Mounted,
    mounted_density,
    prior_density,
)
from plane_detector.directions.surfaces import mean_normals
from plane_detector.geometry.rigid_transform import cross, unit

# Values said to be tuned are so on the views of python -m plane_detector.evaluation.benchmark
# orientation --only calibration --first-seed 300 --scenes 12 of commit 671e645, for normals also
# with the depth of fastdepth and of the sensors of the same views.
#
# chosen: the range of the axis closest to the bottom of the image, of any three at right angles.
MAX_PITCH_DEG, MAX_ROLL_DEG, STEP_DEG = 52.5, 45.0, 7.5
# Each step is divided by three in the best cells that are not negligible (log of the posterior).
# tuned: flat from 8 to 1000; at 5 a tenth more answers, and twice as many wrong ones.
DIVIDED_CELLS, DIVISION, NEGLIGIBLE = 40, 3, 10.0
CELL_RAD = np.radians(STEP_DEG / DIVISION)
# Added to all errors for the distance to the next point of the grid. tuned: flat from 2.6 to 3.6,
# and from 0.7 to 1.
COARSE_ERROR_DEG, FINE_ERROR_DEG = 3.1, 0.8
# Verticals within this angle of the answer are the same. chosen: what planes can use.
CLOSE_DEG = 5.0
# Modes that are carried to the next image, and the least mass of one. chosen: the others hold less
# than the required probability leaves.
MOST_MODES, LEAST_MASS = 6, 0.01


def collect_evidence(segments: LineSegments, surface: np.ndarray | None = None,
                     odds_down: float = 0.0,
                     log_turned: Sequence[float] = TAKEN_AS_UPRIGHT,
                     focal_error: float = 0.0) -> Evidence:
    """
    Return the evidence of an image for the posterior.

    Parameters
    ----------
    segments : LineSegments
    surface : (N, 3) floating, optional
        Normals of the depth; those without a direction are 0.
    odds_down : float
        As of :func:`log_odds_down`.
    log_turned : (4,) floating
        Log likelihoods that gravity points to the bottom, right, top and left of the image.
        Default: an upright camera.
    focal_error : float
        Standard deviation of the focal length, as a share of it.

    """
    known = np.zeros((0, 3)) if surface is None else mean_normals(surface)
    return _with_normal_error(Evidence(
        line_table(segments, focal_error), known, log_odds_down=odds_down, log_turned=log_turned,
        focal_error=focal_error))


@dataclass(frozen=True)
class Posterior:
    """Probability of verticals on a grid."""

    downs: np.ndarray  # (V, 3) float64: unit vectors
    masses: np.ndarray  # (V,) float64: their sum is 1
    unsided: np.ndarray  # (V,) float64: masses without the evidence of the sides of the image
    frames: np.ndarray  # (V, 3, 3) float64: the three axes, one of which each vertical is

    def along(self, axis: np.ndarray) -> float:
        """Return the probability of all frames with an axis (3,), whichever side is down."""
        has_axis = (np.abs(self.frames @ axis) > np.cos(np.radians(CLOSE_DEG))).any(axis=1)
        return float(self.masses[has_axis].sum())

    def near(self, down: np.ndarray) -> np.ndarray:
        """Return which verticals (V,), bool, are within CLOSE_DEG of one."""
        return self.downs @ down > np.cos(np.radians(CLOSE_DEG))

    def mean_shifted(self, masses: np.ndarray) -> np.ndarray:
        """Return the mean (3,) of the verticals near it, where most of some masses (V,) are."""
        best = self.downs[np.argsort(-masses)[:DIVIDED_CELLS]]
        near = self.downs @ best.T > np.cos(np.radians(CLOSE_DEG))
        is_near = near[:, (masses @ near).argmax()]
        for _ in range(2):
            down = unit(masses[is_near] @ self.downs[is_near])
            is_near = self.near(down)
        return down

    def modes(self, down: np.ndarray) -> Modes:
        """Return the modes, the first one about a given vertical."""
        left, means, covariances, masses, unsided = self.masses, [], [], [], []
        while True:
            is_near = self.near(down)
            found = left[is_near].sum()
            if means and found < LEAST_MASS:
                break
            across = (self.downs[is_near] - down) * np.sqrt(
                left[is_near] / max(found, 1e-12))[:, None]
            means.append(down)
            covariances.append(across.T @ across + CELL_RAD**2 / 12 * np.eye(3))
            masses.append(found)
            unsided.append(self.unsided[is_near & (left > 0)].sum())
            left = np.where(is_near, 0.0, left)
            if left.sum() < LEAST_MASS or len(means) == MOST_MODES:
                break
            down = self.mean_shifted(left)
        return Modes(np.array(means), np.array(covariances), np.array(masses),
                     np.array(unsided))


def upright_posterior(evidence: Evidence, expected: Expected) -> tuple[np.ndarray, Posterior]:
    """
    Return the posterior of the vertical of an image.

    Returns
    -------
    axes : (3, 3) float64
        Rows: the mean vertical of the main mode, downwards, and the most likely axes about it.
    posterior : Posterior

    """
    grid = _coarse_grid()
    prior = prior_density(grid.axes, expected, evidence.log_mountings, COARSE_ERROR_DEG,
                          grid.mounted)
    of_frames = np.log(prior[0].reshape(-1, 6) @ np.ones(6)).reshape(grid.azimuths.shape)
    score = (grid.log_area + of_frames
             + sum(log_likelihood(grid.bases, np.radians(grid.azimuths), evidence,
                                  np.radians(COARSE_ERROR_DEG))))
    best = np.argpartition(-score, DIVIDED_CELLS, axis=None)[:DIVIDED_CELLS]
    best = best[score.ravel()[best] > score.max() - NEGLIGIBLE]
    best = best[np.argsort(-score.ravel()[best])]
    tilt = best // score.shape[1]
    evidence = _with_stray_share(evidence, grid.bases[tilt[0]],
                                 np.radians(grid.azimuths.ravel()[best[0]]))
    inside = (np.arange(DIVISION) - (DIVISION - 1) / 2) * STEP_DEG / DIVISION
    tilts = (grid.tilts[tilt][:, None] + _grid(inside, inside)).reshape(-1, 2)
    azimuths = (grid.azimuths.ravel()[best, None] + inside).repeat(DIVISION**2, axis=0)
    bases, log_area = _bases(tilts)
    votes = log_area[:, None] + sum(log_likelihood(bases, np.radians(azimuths), evidence,
                                                   np.radians(FINE_ERROR_DEG)))
    kept = np.flatnonzero(votes.ravel() > votes.max() - 2 * NEGLIGIBLE)
    frames = _frames(bases, azimuths).reshape(-1, 3, 3)[kept]
    downs = _both_ways(frames)
    mass = (np.exp(votes.ravel()[kept] - votes.max()).repeat(6)
            * prior_density(downs, expected, evidence.log_mountings, FINE_ERROR_DEG))
    kept = np.flatnonzero(mass[0] > mass[0].max() * math.exp(-NEGLIGIBLE))
    masses, unsided = mass[:, kept]
    posterior = Posterior(downs[kept], masses / masses.sum(), unsided / mass[1].sum(),
                          frames[kept // 6])
    down = posterior.mean_shifted(posterior.masses)
    best = kept[np.where(posterior.near(down), posterior.masses, 0).argmax()]
    x = frames[best // 6, (best % 3 + 1) % 3]
    x = unit(x - (x @ down) * down)
    return np.array([down, x, cross(down, x)]), posterior


def _with_stray_share(evidence: Evidence, base: np.ndarray, azimuth_rad: float) -> Evidence:
    """Return the evidence with the share of lines that are along no axis of a frame."""
    share, lines = STRAY_LINES, evidence.lines
    x = np.cos(azimuth_rad) * base[1] + np.sin(azimuth_rad) * base[2]
    axes = np.array([base[0], x, cross(base[0], x)])
    variance = lines[:, 6] + np.radians(COARSE_ERROR_DEG) ** 2
    off = axes @ lines[:, :3].T
    length2 = sum((axes[:, k, None] - axes[:, 2, None] * lines[:, 3 + k]) ** 2 for k in range(2))
    square = off**2 / ((length2 + MIN_IMAGE_LENGTH2) * variance)
    density = (np.exp(-0.5 * square) * np.pi / (3 * np.sqrt(2 * np.pi * variance))).sum(axis=0)
    votes, all_votes = lines[:, 7], lines[:, 7].sum() + STRAY_PRIOR_VOTES
    for _ in range(STRAY_ROUNDS):
        stray = votes @ (share / (share + (1 - share) * density))
        share = (stray + STRAY_PRIOR_VOTES * STRAY_LINES) / all_votes
    return replace(evidence, stray_share=float(share))


def _with_normal_error(evidence: Evidence) -> Evidence:
    """Return evidence with the error of its normals for which they are most likely."""
    if not len(evidence.normals):
        return evidence
    grid = _sparse_grid()
    log_prior = grid.log_area + np.log(prior_density(
        grid.axes, Expected(), evidence.log_mountings, COARSE_ERROR_DEG, grid.mounted
    )[0].reshape(-1, 6) @ np.ones(6)).reshape(grid.azimuths.shape)
    alone = replace(evidence, lines=evidence.lines[:0])
    bases, azimuths = grid.bases, np.radians(grid.azimuths)
    tried = [replace(alone, normal_rad=np.radians(sigma_deg)) for sigma_deg in NORMAL_DEG]
    peaks = [(log_prior + sum(log_likelihood(bases, azimuths, one, np.radians(COARSE_ERROR_DEG)))
              ).max() for one in tried]
    return replace(evidence, normal_rad=tried[int(np.argmax(peaks))].normal_rad)


@dataclass(frozen=True)
class _CoarseGrid:
    """All frames of three perpendicular axes, each once."""

    tilts: np.ndarray  # (V, 2) float64: pitch and roll, degrees, of the axis closest to the bottom
    azimuths: np.ndarray  # (V, A) float64: of the other two axes, degrees
    bases: np.ndarray  # (V, 3, 3) float64
    log_area: np.ndarray  # (V, A) float64: of the cells; -inf for a frame that is another cell's
    axes: np.ndarray  # (V * A * 6, 3) float64: both directions of the axes of each frame
    mounted: Mounted


@cache
def _coarse_grid() -> _CoarseGrid:
    tilts = _grid(*(np.arange(-most, most + 1, STEP_DEG)
                    for most in (MAX_PITCH_DEG, MAX_ROLL_DEG)))
    bases, log_area = _bases(tilts)
    azimuths = np.tile(np.arange(0, 90, STEP_DEG), (len(tilts), 1))
    frames = _frames(bases, azimuths)
    is_closest = (np.abs(frames[..., 1:, 1]) <= frames[..., :1, 1] + 1e-9).all(axis=2)
    used = is_closest.any(axis=1)
    axes = _both_ways(frames[used].reshape(-1, 3, 3))
    return _CoarseGrid(tilts[used], azimuths[used], bases[used],
                       np.where(is_closest, log_area[:, None], -np.inf)[used],
                       axes, Mounted(mounted_density(axes)))


@cache
def _sparse_grid() -> _CoarseGrid:
    """Return the coarse grid where the prior is, with every other azimuth."""
    grid = _coarse_grid()
    near, (count, azimuths) = np.abs(grid.tilts[:, 1]) < 3 * HELD_DEG[1], grid.azimuths.shape
    return _CoarseGrid(
        grid.tilts[near], grid.azimuths[near, ::2], grid.bases[near], grid.log_area[near, ::2],
        grid.axes.reshape(count, azimuths, 6, 3)[near, ::2].reshape(-1, 3),
        Mounted(grid.mounted.densities.reshape(5, count, azimuths, 6)[:, near, ::2].reshape(
            5, -1)))


def _frames(bases: np.ndarray, azimuths_deg: np.ndarray) -> np.ndarray:
    """Return the axes (V, A, 3, 3) of bases (V, 3, 3) at azimuths (V, A)."""
    angle = np.radians(azimuths_deg)[..., None]
    down, right, ahead = (bases[:, None, k] for k in range(3))
    x, y = (np.cos(angle) * right + np.sin(angle) * ahead,
            np.cos(angle) * ahead - np.sin(angle) * right)
    return np.stack([np.broadcast_to(down, x.shape), x, y], axis=2)


def _both_ways(frames: np.ndarray) -> np.ndarray:
    """Return the axes (6 F, 3) of frames (F, 3, 3): for each its three, then their opposites."""
    return np.concatenate([frames, -frames], axis=1).reshape(-1, 3)


def _grid(*axes: np.ndarray) -> np.ndarray:
    return np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing='ij')], axis=1)


def _bases(tilts_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertical and two horizontal directions (V, 3, 3), and the log area of a cell."""
    pitch, roll = np.radians(tilts_deg.T)
    down = np.stack([-np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch),
                     np.sin(pitch)], axis=1)
    right = np.stack([np.cos(roll), np.sin(roll), np.zeros(len(roll))], axis=1)
    return np.stack([down, right, cross(down, right)], axis=1), np.log(np.cos(pitch))


def turn_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) that takes one unit vector to another."""
    across = cross(first, second)
    length = np.linalg.norm(across)
    angle = np.arctan2(length, first @ second)
    return cv2.Rodrigues(angle * (across / length if length > 1e-9 else np.eye(3)[2]))[0]
