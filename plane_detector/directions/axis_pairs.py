# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Pairs of horizontal axes about a known vertical, from line segments.

A pair has one unknown, its azimuth, which is found by search. It is refused if another pair fits
the lines nearly as well; the first pair also if it depends on a single line. Further pairs about
the same vertical (an Atlanta world, Schindler and Dellaert 2004) are searched for among the
remaining segments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.directions.frames import fit_frame, misalignment, pointing, significance
from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.single_lines import depends_on_one_line

# tuned: python -m plane_detector.evaluation.benchmark orientation, flat from 2 to 4.
TOLERANCE_DEG = 2.5
# Segments within this angle of a direction are explained by it and support no other direction.
REACH_DEG = 4.0
# Significance in standard deviations. With random strokes the best pair reaches 9, because it is
# the best of many. tuned: as MIN_SUM_SIGMAS of the vertical.
MIN_PAIR_SIGMAS = 6.0
# Closer directions are the same direction; a different one with this share of the score is a
# rival. tuned: python -m plane_detector.evaluation.benchmark orientation --only rendered
# --first-seed 300 --scenes 30: at 0.92 three more of 100 images are answered than at 0.85, and no
# error is larger.
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
class Azimuth:
    """
    The best pair of horizontal axes about a vertical.

    Attributes
    ----------
    axes : (2, 3) float64
    sigmas : float
        Their significance, in standard deviations.
    refusal : str
        Why they are not reliable; empty if they are.

    """

    axes: np.ndarray
    sigmas: float
    refusal: str


def find_azimuth(segments: LineSegments, down: np.ndarray,
                 left: np.ndarray | None = None) -> Azimuth:
    """
    Find the horizontal axes that most lines point to.

    Parameters
    ----------
    segments : LineSegments
    down : (3,) float64
        Unit direction of gravity.
    left : (N,) bool, optional
        Segments that support no pair before this one; default: all, it is the first one.

    """
    x = np.cross(down, [0.0, 0.0, 1.0] if abs(down[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    azimuth = np.radians(np.arange(180))[:, None]
    directions = np.cos(azimuth) * x + np.sin(azimuth) * np.cross(down, x)
    weights = segments.lengths * ~points_to(segments, down[None])
    if left is not None:
        weights = weights * left
    points = pointing(misalignment(segments, directions), TOLERANCE_DEG)
    points = points[:, :90] + points[:, 90:]
    sigmas = significance(weights, points.T, TOLERANCE_DEG, 2)
    best = int((weights @ points).argmax())
    is_same = np.abs((np.arange(90) - best + 45) % 90 - 45) <= SAME_DEG
    refusal = _reason_to_refuse(segments, weights[:, None] * points, is_same, left is None)
    if sigmas[best] < MIN_PAIR_SIGMAS:
        refusal = 'hardly more horizontal lines along two axes than expected by chance'
    return Azimuth(directions[[best, best + 90]], float(sigmas[best]), refusal)


def _reason_to_refuse(segments: LineSegments, points: np.ndarray, is_same: np.ndarray,
                      is_first: bool) -> str:
    score = points.sum(0)
    if score[~is_same].max() > RIVAL_SHARE * score.max():
        return 'another pair of horizontal axes fits the lines equally well'
    # A further pair only applies to planes in which other lines confirm it.
    if is_first and depends_on_one_line(segments, points, is_same):
        return 'the horizontal axes depend on a single line'
    return ''


def more_pairs(segments: LineSegments, down: np.ndarray,
               pairs: tuple[AxisPair, ...]) -> tuple[AxisPair, ...]:
    """Return further pairs, each supported by segments that support none before it."""
    more: tuple[AxisPair, ...] = ()
    left = np.ones(len(segments), bool)
    for pair in pairs:
        left &= ~points_to(segments, pair.axes)
    while pairs and len(pairs + more) < MAX_PAIRS:
        found = find_azimuth(segments, down, left)
        if found.refusal:
            break
        axes = fit_frame(segments, np.vstack([down, found.axes]), (0, 1, 2)).axes[1:]
        more += (AxisPair(axes, np.radians(SYSTEMATIC_DEG), support(segments, axes)),)
        left &= ~points_to(segments, axes)
    return more


def points_to(segments: LineSegments, directions: np.ndarray) -> np.ndarray:
    """Return the segments (N,), bool, that one of the directions (D, 3) explains."""
    sine = np.abs(misalignment(segments, directions)).min(1)
    return sine < np.sin(np.radians(REACH_DEG))


def support(segments: LineSegments, directions: np.ndarray) -> float:
    """Return the share of the line length that points to one of the directions (D, 3)."""
    points = pointing(misalignment(segments, directions), TOLERANCE_DEG).max(1) > 0
    return float(segments.lengths @ points / segments.lengths.sum())
