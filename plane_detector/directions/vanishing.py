# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Directions of a calibrated image: the vertical and pairs of horizontal axes.

1. The main mode of the posterior is fitted to its segments; the probability is that of the
   verticals near this answer, less that of a roof.
2. Its level lines may be those of an inclined floor: then only the upright lines decide.
3. Its upright lines may be those of a leaning object, such as a ladder or a fence: then everything
   else decides. What remains is the probability of the vertical.
4. The azimuth of horizontal axes about it has a posterior of the same kind. Further pairs (an
   Atlanta world, Schindler and Dellaert 2004) come from the segments that no previous direction
   explains, unless these are outliers.
5. Vertical and first pair are fitted once more, and averaged with those of the previous images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.directions.frames import FrameFit, fit_frame, misalignment
from plane_detector.directions.likelihood import STRAY_LINES, Evidence, log_likelihood
from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.posterior import (
    CLOSE_DEG,
    FINE_ERROR_DEG,
    collect_evidence,
    turn_between,
    upright_posterior,
)
from plane_detector.directions.prior import Expected, Modes, prior_density
from plane_detector.geometry.rigid_transform import cross, unit

# An answer is given if it is right with this probability.
MIN_PROBABILITY = 0.9
# Share of the images whose level lines are those of an inclined floor, by up to these angles, and
# the angle up to which a floor counts as level. tuned: rooms whose floor rises by 8 degrees, seeds
# 300 to 311: at 0.05 three of 11 answers are wrong, at 0.1 one of 10.
RISING, RISES_DEG, LEVEL_DEG = 0.1, np.arange(-14.0, 15.0, 2.0), 3.0
# Share of the images under a roof, with the ridge and the two slopes as axes, and the angles of
# slopes. tuned: attics with exact depth, seeds 300 to 323, whose ridge is else taken for the
# vertical of a camera that looks down between two walls: all 5 wrong answers are refused, one just
# so. Of 56 real frames 38 are answered, 41 without, 36 at 0.025.
ROOF, ROOF_DEG = 0.02, np.arange(30.0, 61.0, 7.5)
# Share of the images whose upright lines are those of a leaning object. derived: above what the
# probability of an answer leaves, so that upright lines alone are not enough; with other lines
# flat from 0.05 to 0.3.
LEANING = 0.15
# Modes within this angle of another axis of the answer are that axis, mistaken for the vertical.
# derived: two steps of the coarse grid.
SAME_AXIS_DEG = 15.0
# Odds that the azimuth of the previous image is that of this one.
HELD_AXES_ODDS = 100.0
# Azimuths within this angle are the same before the fit. tuned: at 5 degrees axes of 2 of 5 Kinect
# frames are given, at 9 of 3; none is wrong.
CLOSE_AZIMUTH_DEG = 9
# Segments within this angle of a direction are explained by it and support no other direction.
# derived: beyond three standard deviations of a long line.
REACH_DEG = 4.0
# chosen: a third pair does not change any plane.
MAX_PAIRS = 2
# Accuracy of building edges and lens calibrations. tuned: on real images nine of ten directions of
# gravity are within twice this value.
SYSTEMATIC_DEG = 1.0
# Random error of the directions of one image, and least weight of a new image in the average.
# tuned: flat from 0.1 to 0.3, flicker of a still camera below half a degree.
RANDOM_RAD, MIN_GAIN = np.radians(0.5), 0.2
NO_PAIRS = np.zeros((0, 2, 3))


@dataclass(frozen=True)
class SceneDirections:
    """Directions of an image."""

    # (3,) float64 or None: unit direction of gravity in the optical frame
    gravity_camera: np.ndarray | None
    covariance: np.ndarray  # (3, 3) float64: of the main axis, rad^2; singular along it
    # (P, 2, 3) float64: pairs of unit directions at right angles to each other and to the main
    # axis, horizontal if that is the vertical, the best supported first; their signs have no
    # meaning
    pairs: np.ndarray
    refusal: str = ''  # why there is no direction of gravity; empty if there is one
    pair_refusal: str = ''  # why there are no horizontal axes; empty if there are
    probability: float = 1.0  # that the direction of gravity is right within 5 degrees
    modes: Modes | None = None  # of the posterior, for the next image
    # (3,) float64 or None: without a direction of gravity, an axis of the scene that is certain
    # although it may be vertical or horizontal, and the probability of this axis
    open_axis: np.ndarray | None = None
    open_probability: float = 0.0

    @property
    def main_axis(self) -> np.ndarray | None:
        """Unit axis (3,) that planes are along or across: of gravity, or the open one."""
        return self.open_axis if self.gravity_camera is None else self.gravity_camera

    @property
    def main_probability(self) -> float:
        """Probability that the main axis is right."""
        return self.open_probability if self.gravity_camera is None else self.probability


def find_directions(segments: LineSegments, evidence: Evidence | None = None,
                    expected: Expected | None = None) -> SceneDirections:
    """
    Find the directions of gravity and of horizontal lines, or refuse.

    Parameters
    ----------
    segments : LineSegments
    evidence : Evidence, optional
        Of them and of the depth; default: of the segments alone.
    expected : Expected, optional
        Default: a camera held upright.

    """
    evidence = evidence or collect_evidence(segments)
    expected = expected or Expected()
    axes, posterior = upright_posterior(evidence, expected)
    axes = _fitted(segments, axes, (0, 1, 2)).axes
    modes = posterior.modes(axes[0])
    roof_share = _share_under_roof(axes, evidence, expected)
    level_share, axes, rises = _if_it_rises(axes, evidence)
    gain = _gain(segments, axes, evidence, expected)
    share = ((1 - roof_share) * level_share
             * (1 - LEANING) / (1 - LEANING + LEANING * np.exp(-gain)))
    pairs, fit = _about_the_first(segments, axes, evidence, expected, rises)
    down, covariance = _averaged(fit, modes.covariances[0], expected)
    modes = replace(
        modes, downs=np.vstack([down, modes.downs[1:]]),
        covariances=np.concatenate([covariance[None], modes.covariances[1:]]),
        masses=np.concatenate([share * modes.masses[:1], modes.masses[1:]]),
        unsided=np.concatenate([share * modes.unsided[:1], modes.unsided[1:]]), gain=gain)
    probability = float(modes.masses[0])
    if probability < MIN_PROBABILITY:
        # Planes can be oriented by axes even if it is undecided which is the vertical: about the
        # most certain one.
        along = [posterior.along(axis) for axis in axes]
        open_probability, surest = float(share) * max(along), int(np.argmax(along))
        reason = (f'{len(segments)} straight lines and the depth leave the vertical open: the '
                  f'most likely one is right with probability {probability:.2f}')
        if open_probability < MIN_PROBABILITY:
            return SceneDirections(None, np.full((3, 3), np.nan), NO_PAIRS, reason, reason,
                                   probability, modes)
        if surest:
            axes = np.roll(axes, -surest, axis=0)
            pairs, fit = _about_the_first(segments, axes, evidence, Expected(), rises)
            down, covariance = _averaged(fit, covariance, Expected())
    if len(pairs):
        pairs = np.stack([_level(pair, down) for pair in (fit.axes[1:], *pairs[1:])])
    across = np.eye(3) - np.outer(down, down)
    refusal = ('no horizontal axes are perpendicular to the upright lines' if rises else
               'the lines and the depth leave the azimuth of the horizontal axes open')
    # A wrong focal length tilts a direction toward or away from the optical axis.
    tilt = across[:, 2:] * evidence.focal_error * down[2]
    covariance = (across @ covariance @ across + np.radians(SYSTEMATIC_DEG) ** 2 * across
                  + tilt @ tilt.T)
    if probability < MIN_PROBABILITY:
        reason += ('; its axes are known: state directions.mounting: upright if the camera is '
                   'never on its side')
        return SceneDirections(None, covariance, pairs, reason, reason, probability, modes, down,
                               open_probability)
    return SceneDirections(down, covariance, pairs, '', '' if len(pairs) else refusal,
                           probability, modes)


def _about_the_first(segments: LineSegments, axes: np.ndarray, evidence: Evidence,
                     expected: Expected, rises: bool) -> tuple[np.ndarray, FrameFit]:
    """Return pairs (P, 2, 3) about the first of the axes (3, 3), and the fit of all to lines."""
    pairs = NO_PAIRS if rises else _pairs(segments, evidence, axes[0], expected)
    if len(pairs):
        return pairs, _fitted(segments, np.vstack([axes[:1], pairs[0]]), (0, 1, 2))
    return pairs, _fitted(segments, axes, (0,))


def _share_under_roof(axes: np.ndarray, evidence: Evidence, expected: Expected) -> float:
    """Return the probability that two of the axes (3, 3) are the slopes of a roof."""
    if expected.down is not None or not len(evidence.normals):
        return 0.0
    slope = np.radians(ROOF_DEG)[:, None]
    under_roof = np.concatenate([
        first * np.cos(slope) * axes[k] + second * np.sin(slope) * axes[k - 1]
        for k in range(3) for first in (1, -1) for second in (1, -1)])
    density = prior_density(np.concatenate([axes, -axes, under_roof]), expected,
                            evidence.log_mountings, FINE_ERROR_DEG)[0]
    mass = density[6:].sum() * ROOF / len(slope)
    return float(mass / (density[:6].sum() + mass))


def _fitted(segments: LineSegments, axes: np.ndarray, used: tuple[int, ...]) -> FrameFit:
    """Return axes fitted to their segments; unchanged if too few hold them."""
    fit = fit_frame(segments, axes, used)
    is_held = fit.axes[0] @ axes[0] > np.cos(np.radians(CLOSE_DEG))
    return fit if is_held else FrameFit(axes, np.full((3, 3), np.inf))


def _if_it_rises(axes: np.ndarray, evidence: Evidence) -> tuple[float, np.ndarray, bool]:
    """Return a probability, the axes that have it, and whether they differ from those given."""
    rises = np.radians(RISES_DEG)[:, None]
    cosine, sine = np.cos(rises), np.sin(rises)
    turned = np.concatenate([
        np.stack([cosine * axes[0] + sine * level, cosine * level - sine * axes[0],
                  np.broadcast_to(other, (len(rises), 3))], axis=1)
        for level, other in (axes[1:], axes[:0:-1])])
    downs = turned[:, 0]
    bases = np.concatenate([downs[:, None], np.broadcast_to(axes[1:], (len(downs), 2, 3))], axis=1)
    upright = _log_likelihood(bases, replace(evidence, normals=evidence.normals[:0]))[0]
    # The normals decide too: those of an inclined floor are along no axis then.
    upright += _log_likelihood(turned, replace(evidence, lines=evidence.lines[:0]))[1]
    mass = np.exp(upright - upright.max())
    is_level = downs @ axes[0] > np.cos(np.radians(LEVEL_DEG))
    level = (1 - RISING) * mass[is_level].max()
    mass *= RISING / len(mass)
    downs, mass = np.vstack([axes[:1], downs]), np.concatenate([[level], mass])
    down = downs[mass.argmax()]
    share = mass[downs @ down > np.cos(np.radians(CLOSE_DEG))].sum() / mass.sum()
    rises = bool(down @ axes[0] < np.cos(np.radians(LEVEL_DEG)))
    return float(share), axes @ turn_between(axes[0], down).T if rises else axes, rises


def _log_likelihood(frames: np.ndarray, evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Return the log likelihoods (C,) of frames (C, 3, 3): of the upright lines, of all else."""
    upright, others = log_likelihood(frames, np.zeros((len(frames), 1)), evidence,
                                     np.radians(FINE_ERROR_DEG))
    return upright[:, 0], others[:, 0]


def _gain(segments: LineSegments, axes: np.ndarray, evidence: Evidence,
          expected: Expected) -> float:
    """Return the log likelihood of everything except upright lines, in this image and before."""
    others = replace(evidence, lines=evidence.lines[_is_off(segments, axes[:1])])
    gain = _log_likelihood(axes[None], others)[1].item()
    before = expected.before
    if before is not None and before.downs[0] @ axes[0] > np.cos(np.radians(CLOSE_DEG)):
        gain += expected.kept * before.gain
    return gain


def _is_off(segments: LineSegments, directions: np.ndarray) -> np.ndarray:
    """Return the segments (N,), bool, that none of the directions (D, 3) explains."""
    return np.abs(misalignment(segments, directions)).min(1) > np.sin(np.radians(REACH_DEG))


def _pairs(segments: LineSegments, evidence: Evidence, down: np.ndarray,
           expected: Expected) -> np.ndarray:
    """Return pairs (P, 2, 3) of horizontal axes about a vertical."""
    x = unit(cross(down, np.eye(3)[2 if abs(down[2]) < 0.9 else 0]))
    basis = np.array([down, x, cross(down, x)])
    angle = np.radians(np.arange(90))
    axes = (np.cos(angle)[:, None, None] * basis[1:]
            + np.sin(angle)[:, None, None] * np.stack([basis[2], -basis[1]]))
    left = _is_off(segments, down[None])
    pairs, used = NO_PAIRS, evidence
    if not left.any() and expected.pair is None:
        return pairs  # axes from normals alone would rotate planes to what their own depth says
    while len(pairs) < MAX_PAIRS:
        used = replace(used, lines=evidence.lines[left])
        score = log_likelihood(basis[None], angle[None], used, np.radians(FINE_ERROR_DEG))[1][0]
        mass, none = np.exp(score - score.max()), 0.0
        if len(pairs):  # or all other lines are outliers
            none = len(angle) * np.exp(-used.lines[:, 7].sum() * np.log(STRAY_LINES) - score.max())
        elif expected.pair is not None:
            off_rad = np.arccos(np.clip(np.abs(axes[:, 0] @ expected.pair.T).max(1), 0, 1))
            seen = np.exp(-0.5 * off_rad**2 / (expected.pair_rad**2 + RANDOM_RAD**2))
            mass *= 1 + HELD_AXES_ODDS * len(angle) * seen / seen.sum()
        best = mass.argmax()
        off = (np.arange(90) - best + 45) % 90 - 45
        near = np.abs(off) <= CLOSE_AZIMUTH_DEG
        if mass[near].sum() < MIN_PROBABILITY * (mass.sum() + none):
            break
        mean = round(best + mass[near] @ off[near] / mass[near].sum()) % 90
        pairs = np.concatenate([pairs, axes[mean][None]])
        left &= _is_off(segments, axes[mean])
        used = replace(used, normals=np.zeros((0, 3)))
    return pairs


def _averaged(fit: FrameFit, mode: np.ndarray,
              expected: Expected) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertical of a fit and its covariance, averaged with previous images."""
    down = fit.axes[0]
    turn = cross(np.eye(3), down)
    covariance = mode
    if np.isfinite(fit.covariance).all():
        of_lines = turn.T @ fit.covariance @ turn + RANDOM_RAD**2 * np.eye(3)
        covariance = np.linalg.inv(np.linalg.inv(of_lines) + np.linalg.inv(mode))
    before = expected.last
    if before is None or before.downs[0] @ down < np.cos(np.radians(CLOSE_DEG)):
        return down, covariance
    known = before.covariances[0] + MIN_GAIN / (1 - MIN_GAIN) * covariance
    gain = known @ np.linalg.inv(known + covariance)
    return (unit(before.downs[0] + gain @ (down - before.downs[0])),
            (np.eye(3) - gain) @ known)


def _level(axes: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return two axes perpendicular to each other and to the vertical, keeping the first."""
    first = unit(axes[0] - (axes[0] @ down) * down)
    return np.array([first, cross(down, first)])
