# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Vanishing directions of a calibrated image: the vertical and the horizontal axes.

1. Random triples of segments propose frames of three perpendicular directions (Bazin et al.
   2012); each is scored by the length of the segments that point to its axes.
2. The vertical is the axis of the best frame that is closest to the vertical of the image, or to
   a coarse direction of gravity. Either many lines meet exactly in the axes, or it is significant,
   confirmed by other lines and unambiguous; in both cases without any single line, too. Or it is
   perpendicular to the floor in the depth.
3. The tiles of an inclined floor may outvote the vertical edges: if lines along no horizontal axis
   meet in another point near the vertical, that point is used, and the horizontal axes are
   refused.
4. With a known vertical the azimuths of pairs of horizontal axes are found by search.
5. Vertical and pairs are fitted to their segments by reweighted least squares.

References
----------
Bazin, Seo, Demonceaux, Vasseur, Ikeuchi, Kweon, Pollefeys: Globally optimal line clustering and
vanishing point estimation in Manhattan world, CVPR 2012.

"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.directions.axis_pairs import (
    MIN_PAIR_SIGMAS,
    RIVAL_SHARE,
    SAME_DEG,
    SYSTEMATIC_DEG,
    AxisPair,
    Azimuth,
    find_azimuth,
    more_pairs,
    points_to,
    support,
)
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
from plane_detector.directions.single_lines import depends_on_one_line

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
VERTICAL_TOLERANCE_DEG = 2.5
# Search range and step for a vertical supported by vertical lines only. It replaces that of the
# best frame if it differs by MIN_LEAN_DEG and the latter has at most this share of its score.
# tuned: python -m plane_detector.evaluation.benchmark orientation --only rendered --first-seed 300
# --scenes 30, flat from 0.7 to 0.9: the share is 0.94 and more with the right vertical, 0.64 and
# less with that of a floor that rises by 8 degrees.
MAX_LEAN_DEG, LEAN_STEP_DEG, MIN_LEAN_DEG, MAX_LEAN_SHARE = 14, 2, 3.0, 0.8
# Verticals that are closer do not contradict each other. derived: the error that the directions
# of nine of ten images must not exceed.
CLOSE_DEG = 5.0
# Significance in standard deviations. With random strokes the best vertical reaches 6, the best
# pair 9, because both are the best of many. tuned: as above; the sum is flat from 15 to 25.
MIN_VERTICAL_SIGMAS, MIN_SUM_SIGMAS = 6.0, 20.0
# Tolerance at which lines, however short, count as meeting exactly, and the significance of their
# number at which no other evidence is required. A roof shows as exact a frame as a room, but its
# steepest direction is far from the expected vertical, which therefore counts twice. tuned: as
# above, attics and parts of real images: flat from 28 to 35; at 25 two of 500 parts are wrong by
# more than 5 degrees, at 20 a roof is taken for a wall.
EXACT_DEG, MIN_EXACT_SIGMAS = 1.0, 30.0


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


@dataclass(frozen=True)
class _Upright:
    axes: np.ndarray        # (3, 3), the vertical first
    level: Azimuth          # of the horizontal axes about it
    candidates: np.ndarray  # (C, 3), verticals that lean
    points: np.ndarray      # (N, C), their support by the lines along no horizontal axis
    is_of_frame: bool       # False if the vertical lines contradict the frame


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
    axes, doubt = _best_frame(segments, propose_frames(segments, rng), expected)
    if axes is None:
        return _refused(doubt)
    upright = _upright(segments, fit_frame(segments, axes).axes)
    down, level = upright.axes[0], upright.level
    sigmas = _upright_sigmas(segments, down, level.axes)
    tilt_rad = np.arccos(np.clip(down @ expected, -1, 1))
    rarity = float(np.exp(-0.5 * (tilt_rad / np.radians(TILT_SPREAD_DEG)) ** 2))
    is_exact = _exact_sigmas(segments, down, level.axes) * rarity**2 >= MIN_EXACT_SIGMAS
    reason = '' if is_exact else doubt or _too_few(sigmas, level.sigmas, rarity)
    if not reason and _depends_on_one_line(segments, upright, is_exact):
        reason = 'the vertical depends on a single line'
    if reason and not _floor_confirms(surface, down, sigmas):
        return _refused(reason)
    return _fitted(segments, down, level.axes, level.refusal)


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


def _upright(segments: LineSegments, axes: np.ndarray) -> _Upright:
    """Return the vertical of a frame (3, 3), replaced if the vertical lines contradict it."""
    level = find_azimuth(segments, axes[0])
    candidates, points = _leaning(segments, axes, level.axes)
    score = points.sum(0)
    best, own = candidates[score.argmax()], score[len(score) // 2]
    if (best @ axes[0] > np.cos(np.radians(MIN_LEAN_DEG))
            or own > MAX_LEAN_SHARE * score.max()):
        return _Upright(axes, level, candidates, points, True)
    first = np.cross(best, axes[2])
    first /= np.linalg.norm(first)
    axes = fit_frame(segments, np.stack([best, first, np.cross(best, first)]), (0,)).axes
    level = replace(find_azimuth(segments, axes[0]),
                    refusal='no horizontal axes are perpendicular to the vertical lines')
    return _Upright(axes, level, *_leaning(segments, axes, level.axes), False)


def _leaning(segments: LineSegments, axes: np.ndarray,
             level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return verticals (C, 3) around the first axis, and the support (N, C) of each by lines."""
    lean = np.tan(np.radians(np.arange(-MAX_LEAN_DEG, MAX_LEAN_DEG + 1, LEAN_STEP_DEG)))
    x, y = (lean.reshape(shape + (1,)) for shape in ((1, -1), (-1, 1)))
    candidates = (axes[0] + x * axes[1] + y * axes[2]).reshape(-1, 3)
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    weights = segments.lengths * ~points_to(segments, level)
    points = pointing(misalignment(segments, candidates), VERTICAL_TOLERANCE_DEG)
    return candidates, weights[:, None] * points


def _upright_sigmas(segments: LineSegments, down: np.ndarray, axes: np.ndarray) -> float:
    """Return the significance of the vertical for the lines along no horizontal axis."""
    weights = segments.lengths * ~points_to(segments, axes)
    points = pointing(misalignment(segments, down), VERTICAL_TOLERANCE_DEG)
    return float(significance(weights, points, VERTICAL_TOLERANCE_DEG))


def _exact_sigmas(segments: LineSegments, down: np.ndarray, level: np.ndarray) -> float:
    """Return the significance of the number of lines that meet exactly in the three directions."""
    sigmas = []
    for own, others in ((down[None], level), (level, down[None])):
        weights = 1.0 - points_to(segments, others)
        points = pointing(misalignment(segments, own), EXACT_DEG).sum(1)
        sigmas.append(float(significance(weights, points, EXACT_DEG, len(own))))
    are_significant = sigmas[0] >= MIN_VERTICAL_SIGMAS and sigmas[1] >= MIN_PAIR_SIGMAS
    return sum(sigmas) if are_significant else 0.0


def _too_few(sigmas: float, pair_sigmas: float, rarity: float) -> str:
    if sigmas < MIN_VERTICAL_SIGMAS:
        return 'hardly more vertical lines than expected by chance'
    if pair_sigmas < MIN_PAIR_SIGMAS:
        return 'vertical lines only: no lines perpendicular to them confirm them'
    if (sigmas + pair_sigmas) * rarity < MIN_SUM_SIGMAS:
        return 'hardly more lines along three axes than expected by chance'
    return ''


def _depends_on_one_line(segments: LineSegments, upright: _Upright, is_exact: bool) -> bool:
    """
    Return whether a vertical that leans is supported as well without one of the lines.

    The horizontal lines count only if the frame is exact: those of an object that leans are as
    wrong as its vertical.
    """
    candidates, points = upright.candidates, upright.points
    is_same = candidates @ upright.axes[0] > np.cos(np.radians(CLOSE_DEG))
    if not depends_on_one_line(segments, points, is_same):
        return False
    if not (is_exact and upright.is_of_frame):
        return True
    points = np.maximum(points, _along_leaning(segments, candidates, upright.level.axes))
    return depends_on_one_line(segments, points, is_same)


def _along_leaning(segments: LineSegments, downs: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Return the support (N, C) of verticals (C, 3) by lines along the axes across them."""
    points = np.zeros((len(segments), len(downs)))
    for axis in level:
        across = axis - (downs @ axis)[:, None] * downs
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        points = np.maximum(points, pointing(misalignment(segments, across),
                                             VERTICAL_TOLERANCE_DEG))
    return segments.lengths[:, None] * points


def _floor_confirms(surface: np.ndarray | None, down: np.ndarray, vertical_sigmas: float) -> bool:
    return (surface is not None and vertical_sigmas >= MIN_VERTICAL_SIGMAS
            and shows_floor(surface, down))


def _fitted(segments: LineSegments, down: np.ndarray, axes: np.ndarray,
            pair_refusal: str) -> SceneDirections:
    """Fit the vertical and the first pair to their segments, then search for more pairs."""
    used = (0,) if pair_refusal else (0, 1, 2)
    fit = fit_frame(segments, np.vstack([down, axes]), used)
    down = fit.axes[0]
    covariance = fit.covariance + np.radians(SYSTEMATIC_DEG) ** 2 * np.eye(3)
    turn = np.cross(np.eye(3), down)  # row k: change of the direction by a rotation about axis k
    sigma_rad = float(np.sqrt(down @ covariance @ down))
    first = () if pair_refusal else (
        AxisPair(fit.axes[1:], sigma_rad, support(segments, fit.axes[1:])),)
    return SceneDirections(down, turn.T @ covariance @ turn, support(segments, down[None]),
                           first + more_pairs(segments, down, first), '', pair_refusal)
