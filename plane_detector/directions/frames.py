# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of three directions at right angles, proposed by line segments, scored and fitted."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.directions.line_segments import LineSegments

# derived: with an axis that has a fifth of the length each, 3 % of the triples are good ones.
HYPOTHESES = 600
# A segment points to a direction within this at first, and within this once it is fitted.
# tuned: evaluation.benchmark.orientation directions, flat from 2 to 4 and from 1.5 to 2.5.
SEARCH_TOLERANCE_DEG, FIT_TOLERANCE_DEG = 3.0, 2.0
SEARCH_ROUNDS, FIT_ROUNDS = 2, 6
# Two segments nearer to parallel than this, as sines, propose nothing.
MIN_CROSS, MIN_RIGHT_CROSS = 0.02, 0.05


@dataclass(frozen=True)
class FrameFit:
    """
    Directions fitted to their segments.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: unit directions in the camera frame.
    covariance : (3, 3) float64
        Of a small rotation of all of them, in the camera frame, rad^2.

    """

    axes: np.ndarray
    covariance: np.ndarray


def misalignment(segments: LineSegments, directions: np.ndarray) -> np.ndarray:
    """
    Return the sine of the angle (N, ...) between segments and the images of directions (..., 3).

    At the midpoint (x, y, 1) the image of the direction d runs along (dx - x dz, dy - y dz).
    """
    flat = directions.reshape(-1, 3)
    x = flat[:, 0] - segments.midpoints[:, :1] * flat[:, 2]
    y = flat[:, 1] - segments.midpoints[:, 1:2] * flat[:, 2]
    sine = (segments.normals @ flat.T) / np.sqrt(x * x + y * y + 1e-12)
    return sine.reshape(len(segments), *directions.shape[:-1])


def pointing(sine: np.ndarray, tolerance_deg: float) -> np.ndarray:
    """Return 1 for segments that point exactly there and 0 from the tolerance on."""
    return np.maximum(1.0 - (sine / np.sin(np.radians(tolerance_deg))) ** 2, 0.0)


def significance(weights: np.ndarray, points: np.ndarray, tolerance_deg: float,
                 directions: int = 1) -> np.ndarray:
    """
    Return by how many standard deviations segments point to directions more than by chance.

    Parameters
    ----------
    weights : (N,) float
        Lengths of the segments that are asked.
    points : (..., N) float
        What :func:`pointing` says, summed over the directions.
    tolerance_deg : float
    directions : int
        How many directions a segment may point to.

    Notes
    -----
    By chance the angle is uniform in 0 to 90 degrees, so that the mean of 1 - (a / t)^2 below t
    is 2/3 t / 90 and that of its square 8/15 t / 90.

    """
    share = directions * tolerance_deg / 90.0
    mean, square = 2.0 / 3.0 * share, 8.0 / 15.0 * share
    spread = np.sqrt((square - mean**2) * (weights**2).sum())
    return (points @ weights - mean * weights.sum()) / max(spread, 1e-12)


def propose_frames(segments: LineSegments, rng: np.random.Generator) -> np.ndarray:
    """
    Return frames (C, 3, 3) of random triples, rows are axes.

    Two segments propose a direction, d1 = n_i x n_j; the third one the direction at right angles
    that it may point to, d2 = d1 x n_k.
    """
    normals = segments.normals / np.linalg.norm(segments.normals, axis=1, keepdims=True)
    chosen = rng.choice(len(normals), (3, HYPOTHESES), p=segments.lengths / segments.lengths.sum())
    first, second, third = normals[chosen]
    x = np.cross(first, second)
    y = np.cross(x, third)
    length_x, length_y = np.linalg.norm(x, axis=1), np.linalg.norm(y, axis=1)
    possible = (length_x > MIN_CROSS) & (length_y > MIN_RIGHT_CROSS * length_x)
    x, y = x[possible] / length_x[possible, None], y[possible] / length_y[possible, None]
    return np.stack([x, y, np.cross(x, y)], axis=1)


def score_frames(segments: LineSegments, frames: np.ndarray) -> np.ndarray:
    """Return the share (C,) of the length that points to one of the three axes."""
    sine = np.abs(misalignment(segments, frames)).min(-1)
    return segments.lengths @ pointing(sine, SEARCH_TOLERANCE_DEG) / segments.lengths.sum()


def fit_frame(segments: LineSegments, axes: np.ndarray, used: tuple[int, ...] = (0, 1, 2)
              ) -> FrameFit:
    """
    Turn axes so that their segments point to them, by reweighted least squares (Tukey).

    Parameters
    ----------
    segments : LineSegments
    axes : (3, 3) float64
    used : tuple of int
        The axes that segments may point to; the others are carried along.

    """
    weight = np.zeros(len(segments))
    moment, squares = np.eye(3), 0.0
    for k in range(SEARCH_ROUNDS + FIT_ROUNDS):
        directions = axes[list(used)]
        sine = misalignment(segments, directions)
        nearest = np.abs(sine).argmin(1)
        sine = sine[np.arange(len(sine)), nearest]
        tolerance_deg = SEARCH_TOLERANCE_DEG if k < SEARCH_ROUNDS else FIT_TOLERANCE_DEG
        weight = segments.lengths * pointing(sine, tolerance_deg) ** 2
        jacobian = _by_rotation(segments, directions[nearest])
        moment = (jacobian.T * weight) @ jacobian + 1e-6 * weight.sum() * np.eye(3)
        squares = weight @ sine**2
        axes = axes @ cv2.Rodrigues(-np.linalg.solve(
            moment + 1e-12 * np.eye(3), jacobian.T @ (weight * sine)))[0].T
    independent = weight.sum() ** 2 / max(weight @ weight, 1e-12)
    # The covariance of weighted means: moment^-1 times the variance over the independent ones.
    variance = squares / max(independent - len(used), 1.0)
    return FrameFit(axes, np.linalg.inv(moment + 1e-12 * np.eye(3)) * variance)


def _by_rotation(segments: LineSegments, directions: np.ndarray) -> np.ndarray:
    """Return the derivative (N, 3) of the misalignment by a small rotation."""
    across = directions[:, :2] - segments.midpoints[:, :2] * directions[:, 2:]
    return np.cross(directions, segments.normals) / (
        np.linalg.norm(across, axis=1, keepdims=True) + 1e-12)
