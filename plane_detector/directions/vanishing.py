# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Vanishing directions of a calibrated image: the vertical and the horizontal axes.

1. Random triples of segments propose frames of three perpendicular directions (Bazin et al.
   2012); each is scored by the length of the segments that point to its axes.
2. The vertical is the axis of the best frame that is closest to the vertical of the image, or to
   a coarse direction of gravity; it must be significant, and either confirmed by other lines and
   unambiguous, or perpendicular to the floor in the depth.
3. The tiles of an inclined floor may outvote the vertical edges: if lines along no horizontal axis
   meet in another point near the vertical, that point is used, and the horizontal axes are
   refused.
4. With a known vertical a pair of horizontal axes has one unknown, its azimuth, which is found by
   search. Further pairs about the same vertical (an Atlanta world, Schindler and Dellaert 2004)
   are searched for among the remaining segments.
5. Vertical and pairs are fitted to their segments by reweighted least squares.

References
----------
Bazin, Seo, Demonceaux, Vasseur, Ikeuchi, Kweon, Pollefeys: Globally optimal line clustering and
vanishing point estimation in Manhattan world, CVPR 2012.
Schindler, Dellaert: Atlanta world, CVPR 2004.

"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.directions.floor_evidence import shows_floor
from plane_detector.directions.frames import (
    fit_frame,
    misalignment,
    pointing,
    propose_frames,
    score_frames,
    significance,
)
from plane_detector.directions.line_segments import LineSegments

IMAGE_DOWN = (0.0, 1.0, 0.0)
# derived: fewer segments cannot be distinguished from chance.
MIN_SEGMENTS = 10
# Prior for horizontal cameras: of two frames that explain the lines equally well, the one whose
# vertical is closer to the expected one is chosen. tuned: python -m
# plane_detector.evaluation.benchmark directions, flat from 30 to 45.
TILT_SPREAD_DEG = 30.0
# derived: beyond half a right angle another axis of the frame is closer.
MAX_TILT_DEG = 45.0
# tuned: as above, flat from 2 to 4.
VERTICAL_TOLERANCE_DEG, AZIMUTH_TOLERANCE_DEG = 2.5, 2.5
# Segments within this angle of a direction are explained by it and support no other direction.
REACH_DEG = 4.0
# Search range and step for a vertical supported by vertical lines only. It replaces that of the
# best frame if it differs by MIN_LEAN_DEG and the latter has at most this share of its score.
# tuned: python -m plane_detector.evaluation.benchmark orientation --only rendered --first-seed 300
# --scenes 30, flat from 0.7 to 0.9: the share is 0.94 and more with the right vertical, 0.64 and
# less with that of a floor that rises by 8 degrees.
MAX_LEAN_DEG, LEAN_STEP_DEG, MIN_LEAN_DEG, MAX_LEAN_SHARE = 14, 2, 3.0, 0.8
# Significance in standard deviations. With random strokes the best vertical reaches 6, the best
# pair 9, because both are the best of many. tuned: as above; the sum is flat from 15 to 25.
MIN_VERTICAL_SIGMAS, MIN_PAIR_SIGMAS, MIN_SUM_SIGMAS = 6.0, 6.0, 20.0
# Closer directions are the same direction; a different one with this share of the score is a
# rival. tuned: as above with --first-seed 300: at 0.92 three more of 100 images are answered than
# at 0.85, and no error is larger.
SAME_DEG, RIVAL_SHARE = 10.0, 0.92
# tuned: as MIN_PAIR_SHARE of the line evidence; a third pair does not change any plane.
MAX_PAIRS = 2
# Accuracy of building edges and lens calibrations. tuned: as above; on real images nine of ten
# directions of gravity are within twice this value.
SYSTEMATIC_DEG = 1.0


@dataclass(frozen=True)
class AxisPair:
    """
    Two horizontal directions at right angles.

    Attributes
    ----------
    axes : (2, 3) float64
        Unit directions in the camera frame; their signs have no meaning.
    sigma_rad : float
        Standard deviation of the azimuth.
    support : float
        Share of the line length that points to one of them.

    """

    axes: np.ndarray
    sigma_rad: float
    support: float


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


def find_directions(segments: LineSegments, rng: np.random.Generator,
                    coarse_down: np.ndarray | None = None,
                    surface: np.ndarray | None = None) -> SceneDirections:
    """
    Find the directions of gravity and of horizontal lines, or refuse.

    Parameters
    ----------
    segments : LineSegments
    rng : numpy.random.Generator
        For the triples.
    coarse_down : (3,) floating, optional
        Approximate unit direction of gravity; default: that of an upright camera.
    surface : (N, 3) floating, optional
        Normals of a depth image. A floor in it confirms a vertical that lines leave uncertain.

    """
    if len(segments) < MIN_SEGMENTS:
        return _refused(f'only {len(segments)} straight lines')
    expected = np.asarray(IMAGE_DOWN if coarse_down is None else coarse_down, float)
    axes, reason = _best_frame(segments, propose_frames(segments, rng), expected)
    if axes is None:
        return _refused(reason)
    axes = fit_frame(segments, axes).axes
    every = np.ones(len(segments), bool)
    alone = _uprights_alone(segments, axes, _azimuth(segments, axes[0], every)[0])
    azimuth, pair_sigmas, pair_refusal = _azimuth(segments, alone[0], every)
    if alone is not axes:
        axes, pair_refusal = alone, 'no horizontal axes are perpendicular to the vertical lines'
    tilt_rad = np.arccos(np.clip(axes[0] @ expected, -1, 1))
    vertical_sigmas = _upright_sigmas(segments, axes[0], azimuth)
    reason = reason or _reason_to_refuse(vertical_sigmas, pair_sigmas, tilt_rad)
    if reason and not _floor_confirms(surface, axes[0], vertical_sigmas):
        return _refused(reason)
    return _fitted(segments, axes[0], azimuth, pair_refusal)


def _refused(reason: str) -> SceneDirections:
    return SceneDirections(None, np.full((3, 3), np.nan), 0.0, (), reason, reason)


def _best_frame(segments: LineSegments, frames: np.ndarray,
                expected: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Return the best frame with its vertical first, and the reason against it."""
    cosine = frames @ expected
    vertical = np.abs(cosine).argmax(1)
    every = np.arange(len(frames))
    downs = frames[every, vertical] * np.sign(cosine[every, vertical])[:, None]
    tilt_deg = np.degrees(np.arccos(np.clip(downs @ expected, -1, 1)))
    if not (tilt_deg <= MAX_TILT_DEG).any():
        return None, 'no lines near the vertical of the image'
    score = score_frames(segments, frames) * np.exp(-0.5 * (tilt_deg / TILT_SPREAD_DEG) ** 2)
    score[tilt_deg > MAX_TILT_DEG] = 0.0
    best = int(score.argmax())
    apart = downs @ downs[best] < np.cos(np.radians(SAME_DEG))
    rival = score[apart].max(initial=0.0)
    is_rivalled = rival > RIVAL_SHARE * score[best]
    x = frames[best, (vertical[best] + 1) % 3]
    return np.stack([downs[best], x, np.cross(downs[best], x)]), (
        'another vertical fits the lines equally well' if is_rivalled else '')


def _uprights_alone(segments: LineSegments, axes: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Return axes (3, 3); the first is replaced if the vertical lines contradict it."""
    lean = np.tan(np.radians(np.arange(-MAX_LEAN_DEG, MAX_LEAN_DEG + 1, LEAN_STEP_DEG)))
    x, y = (lean.reshape(shape + (1,)) for shape in ((1, -1), (-1, 1)))
    candidates = (axes[0] + x * axes[1] + y * axes[2]).reshape(-1, 3)
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    weights = segments.lengths * ~_points_to(segments, level)
    score = weights @ pointing(misalignment(segments, candidates), VERTICAL_TOLERANCE_DEG)
    best, own = candidates[score.argmax()], score[len(score) // 2]
    if (best @ axes[0] > np.cos(np.radians(MIN_LEAN_DEG))
            or own > MAX_LEAN_SHARE * score.max()):
        return axes
    first = np.cross(best, axes[2])
    first /= np.linalg.norm(first)
    return fit_frame(segments, np.stack([best, first, np.cross(best, first)]), (0,)).axes


def _upright_sigmas(segments: LineSegments, down: np.ndarray, axes: np.ndarray) -> float:
    """Return the significance of the vertical for the lines along no horizontal axis."""
    weights = segments.lengths * ~_points_to(segments, axes)
    points = pointing(misalignment(segments, down), VERTICAL_TOLERANCE_DEG)
    return float(significance(weights, points, VERTICAL_TOLERANCE_DEG))


def _points_to(segments: LineSegments, directions: np.ndarray) -> np.ndarray:
    sine = np.abs(misalignment(segments, directions)).min(1)
    return sine < np.sin(np.radians(REACH_DEG))


def _reason_to_refuse(vertical_sigmas: float, pair_sigmas: float, tilt_rad: float) -> str:
    if vertical_sigmas < MIN_VERTICAL_SIGMAS:
        return 'hardly more vertical lines than expected by chance'
    if pair_sigmas < MIN_PAIR_SIGMAS:
        return 'vertical lines only: no lines perpendicular to them confirm them'
    rarity = np.exp(-0.5 * (tilt_rad / np.radians(TILT_SPREAD_DEG)) ** 2)
    if (vertical_sigmas + pair_sigmas) * rarity < MIN_SUM_SIGMAS:
        return 'hardly more lines along three axes than expected by chance'
    return ''


def _floor_confirms(surface: np.ndarray | None, down: np.ndarray, vertical_sigmas: float) -> bool:
    return (surface is not None and vertical_sigmas >= MIN_VERTICAL_SIGMAS
            and shows_floor(surface, down))


def _azimuth(segments: LineSegments, down: np.ndarray,
             left: np.ndarray) -> tuple[np.ndarray, float, str]:
    """Return the best horizontal axes (2, 3), their significance and the reason against them."""
    x = np.cross(down, [0.0, 0.0, 1.0] if abs(down[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    azimuth = np.radians(np.arange(180))[:, None]
    directions = np.cos(azimuth) * x + np.sin(azimuth) * np.cross(down, x)
    weights = segments.lengths * (left & ~_points_to(segments, down[None]))
    points = pointing(misalignment(segments, directions), AZIMUTH_TOLERANCE_DEG)
    pairs = (points[:, :90] + points[:, 90:]).T
    sigmas = significance(weights, pairs, AZIMUTH_TOLERANCE_DEG, 2)
    score = pairs @ weights
    best = int(score.argmax())
    away = np.abs((np.arange(90) - best + 45) % 90 - 45)
    reason = ''
    if sigmas[best] < MIN_PAIR_SIGMAS:
        reason = 'hardly more horizontal lines along two axes than expected by chance'
    elif score[away > SAME_DEG].max() > RIVAL_SHARE * score[best]:
        reason = 'another pair of horizontal axes fits the lines equally well'
    return directions[[best, best + 90]], float(sigmas[best]), reason


def _fitted(segments: LineSegments, down: np.ndarray, axes: np.ndarray,
            pair_refusal: str) -> SceneDirections:
    """Fit the vertical and the first pair to their segments, then search for more pairs."""
    used = (0,) if pair_refusal else (0, 1, 2)
    fit = fit_frame(segments, np.vstack([down, axes]), used)
    down = fit.axes[0]
    covariance = fit.covariance + np.radians(SYSTEMATIC_DEG) ** 2 * np.eye(3)
    turn = np.cross(np.eye(3), down)  # row k: change of the direction by a rotation about axis k
    first = () if pair_refusal else (_pair(segments, fit.axes[1:], down, covariance),)
    return SceneDirections(down, turn.T @ covariance @ turn, _support(segments, down[None]),
                           first + _more_pairs(segments, down, first), '', pair_refusal)


def _pair(segments: LineSegments, axes: np.ndarray, down: np.ndarray,
          covariance: np.ndarray) -> AxisPair:
    return AxisPair(axes, float(np.sqrt(down @ covariance @ down)), _support(segments, axes))


def _support(segments: LineSegments, directions: np.ndarray) -> float:
    points = pointing(misalignment(segments, directions), VERTICAL_TOLERANCE_DEG).max(1) > 0
    return float(segments.lengths @ points / segments.lengths.sum())


def _more_pairs(segments: LineSegments, down: np.ndarray,
                pairs: tuple[AxisPair, ...]) -> tuple[AxisPair, ...]:
    """Return further pairs, each supported by segments that support none before it."""
    more: tuple[AxisPair, ...] = ()
    left = np.ones(len(segments), bool)
    for pair in pairs:
        left &= ~_points_to(segments, pair.axes)
    while pairs and len(pairs + more) < MAX_PAIRS:
        axes, _, reason = _azimuth(segments, down, left)
        if reason:
            break
        axes = fit_frame(segments, np.vstack([down, axes]), (0, 1, 2)).axes[1:]
        more += (AxisPair(axes, np.radians(SYSTEMATIC_DEG), _support(segments, axes)),)
        left &= ~_points_to(segments, axes)
    return more
