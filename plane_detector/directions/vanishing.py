# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Vanishing directions of a calibrated image: the vertical and the horizontal axes.

1. The posterior of pitch, roll and azimuth has a main mode; the probability of its vertical
   decides whether there is an answer.
2. The tiles of an inclined floor may outvote the vertical edges: if lines along no horizontal axis
   meet in another point near the vertical, that point is used, and the horizontal axes are
   refused.
3. With a known vertical the azimuths of pairs of horizontal axes are found by search.
4. Vertical and pairs are fitted to their segments by reweighted least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.directions.axis_pairs import (
    SYSTEMATIC_DEG,
    AxisPair,
    Azimuth,
    find_azimuth,
    more_pairs,
    points_to,
    support,
)
from plane_detector.directions.frames import (
    fit_frame,
    misalignment,
    pointing,
    significance,
)
from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.posterior import (
    CLOSE_DEG,
    NETWORK_NORMAL_DEG,
    upright_posterior,
)

# An answer is given if its vertical is right with this probability.
MIN_PROBABILITY = 0.9
# tuned: python -m plane_detector.evaluation.benchmark orientation, flat from 2 to 4.
VERTICAL_TOLERANCE_DEG = 2.5
# Search range and step for a vertical supported by vertical lines only. It replaces that of the
# best frame if it differs by MIN_LEAN_DEG and the latter has at most this share of its score.
# tuned: python -m plane_detector.evaluation.benchmark orientation --only rendered --first-seed 300
# --scenes 30, flat from 0.7 to 0.9: the share is 0.94 and more with the right vertical, 0.64 and
# less with that of a floor that rises by 8 degrees.
MAX_LEAN_DEG, LEAN_STEP_DEG, MIN_LEAN_DEG, MAX_LEAN_SHARE = 14, 2, 3.0, 0.8
# Its significance in standard deviations: 19 and more in rooms with a ramp, at most 12 for the
# clutter of a kitchen.
MIN_LEAN_SIGMAS = 15.0


@dataclass(frozen=True)
class SceneDirections:
    """
    Directions estimated from the lines of an image.

    Attributes
    ----------
    gravity_camera : (3,) float64 or None
        Unit direction of gravity in the optical frame.
    covariance : (3, 3) float64
        Of that direction, rad^2; singular along it.
    support : float
        Share of the line length that points to it.
    pairs : tuple of AxisPair
        Horizontal axes, the best supported first; empty if none is reliable.
    probability : float
        That the direction of gravity is right within 5 degrees.
    refusal : str
        Why there is no direction of gravity; empty if there is one.
    pair_refusal : str
        Why there are no horizontal axes; empty if there are.

    """

    gravity_camera: np.ndarray | None
    covariance: np.ndarray
    support: float
    pairs: tuple[AxisPair, ...]
    refusal: str
    pair_refusal: str
    probability: float = 1.0


def find_directions(segments: LineSegments, coarse_down: np.ndarray | None = None,
                    surface: np.ndarray | None = None,
                    normal_deg: float = NETWORK_NORMAL_DEG) -> SceneDirections:
    """
    Find the directions of gravity and of horizontal lines, or refuse.

    Parameters
    ----------
    segments : LineSegments
    coarse_down : (3,) floating, optional
        Approximate unit direction of gravity; default: that of an upright camera.
    surface : (N, 3) floating, optional
        Normals of the depth.
    normal_deg : float
        Their error.

    """
    found = upright_posterior(segments, surface, coarse_down, normal_deg)
    if found.probability < MIN_PROBABILITY:
        reason = (f'{len(segments)} straight lines and the depth leave the vertical open: the '
                  f'most likely one is right with probability {found.probability:.2f}')
        return SceneDirections(None, np.full((3, 3), np.nan), 0.0, (), reason, reason,
                               found.probability)
    axes = fit_frame(segments, found.axes).axes
    if axes[0] @ found.axes[0] < np.cos(np.radians(CLOSE_DEG)):
        axes = found.axes  # too few lines for a fit
    down, level = _upright(segments, axes)
    return _fitted(segments, down, level, found.probability)


def _upright(segments: LineSegments, axes: np.ndarray) -> tuple[np.ndarray, Azimuth]:
    """Return the vertical of a frame (3, 3), replaced if the vertical lines contradict it."""
    level = find_azimuth(segments, axes[0])
    candidates, weights, points = _leaning(segments, axes, level.axes)
    score = weights @ points
    best, own = candidates[score.argmax()], score[len(score) // 2]
    sigmas = significance(weights, points[:, score.argmax()], VERTICAL_TOLERANCE_DEG)
    if (best @ axes[0] > np.cos(np.radians(MIN_LEAN_DEG))
            or own > MAX_LEAN_SHARE * score.max() or sigmas < MIN_LEAN_SIGMAS):
        return axes[0], level
    first = np.cross(best, axes[2])
    first /= np.linalg.norm(first)
    down = fit_frame(segments, np.stack([best, first, np.cross(best, first)]), (0,)).axes[0]
    return down, replace(find_azimuth(segments, down),
                         refusal='no horizontal axes are perpendicular to the vertical lines')


def _leaning(segments: LineSegments, axes: np.ndarray,
             level: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return verticals (C, 3) around the first axis, weights (N,) of lines, and what points."""
    lean = np.tan(np.radians(np.arange(-MAX_LEAN_DEG, MAX_LEAN_DEG + 1, LEAN_STEP_DEG)))
    x, y = (lean.reshape(shape + (1,)) for shape in ((1, -1), (-1, 1)))
    candidates = (axes[0] + x * axes[1] + y * axes[2]).reshape(-1, 3)
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    return (candidates, segments.lengths * ~points_to(segments, level),
            pointing(misalignment(segments, candidates), VERTICAL_TOLERANCE_DEG))


def _fitted(segments: LineSegments, down: np.ndarray, level: Azimuth,
            probability: float) -> SceneDirections:
    """Fit the vertical and the first pair to their segments, then search for more pairs."""
    used = (0,) if level.refusal else (0, 1, 2)
    fit = fit_frame(segments, np.vstack([down, level.axes]), used)
    if fit.axes[0] @ down > np.cos(np.radians(CLOSE_DEG)):
        down = fit.axes[0]
    covariance = fit.covariance + np.radians(SYSTEMATIC_DEG) ** 2 * np.eye(3)
    turn = np.cross(np.eye(3), down)  # row k: change of the direction by a rotation about axis k
    sigma_rad = float(np.sqrt(down @ covariance @ down))
    first = () if level.refusal else (
        AxisPair(fit.axes[1:], sigma_rad, support(segments, fit.axes[1:])),)
    return SceneDirections(down, turn.T @ covariance @ turn, support(segments, down[None]),
                           first + more_pairs(segments, down, first), '', level.refusal,
                           probability)
