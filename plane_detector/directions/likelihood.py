# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Likelihood of frames of three perpendicular axes, from lines of the image and normals of its depth.

Each line points to one of the axes, or anywhere; each normal is along one of them, horizontal, or
arbitrary.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.prior import TAKEN_AS_UPRIGHT

# Values said to be tuned are so as those of posterior.py.
#
# Error of a segment: of edges and lens, and of its ends over its length at unit focal length.
# tuned: flat from 0.7 to 1.2; at 1.3 more answers are wrong. derived: 0.7 pixels of 525.
LINE_DEG, END_ERROR = 1.0, 0.0013
# Lines closer than this, seen from the camera, are one. tuned: 14 pixels of 640; at 1 degree
# twice as many answers from parts of images are wrong, at 2.1 a tenth fewer are given.
SAME_LINE_DEG = 1.5
# Votes of a line of this length (60 pixels of 525), growing with the root of the length.
# tuned: of those said to be right with .8 to .9, .86 to .97 are at 0.35, .82 to .89 at 0.5, .74
# to .93 at 0.7.
LINE_VOTE, FULL_LENGTH = 0.5, 0.114
# Share of the lines that are along no axis, a priori and in the best coarse cell: its prior counts
# as much as this many votes. tuned: flat from 1 to 5 votes and from 0.4 to 0.5. With a fixed share
# 3 of 60 images of random strokes are answered, with this none.
STRAY_LINES, STRAY_PRIOR_VOTES, STRAY_ROUNDS = 0.4, 5.0, 10
# Errors of normals, of which the most likely one is used. measured: with finer steps 1.5 degrees
# in exact depth, 1.5 to 4 with noise of .002 per metre, 4 to 14 with .008, of sensors 1.5 to 10,
# of fastdepth mostly 10 to 20.
NORMAL_DEG = (3.5, 7.0, 14.0)
# Shares of normals that are along no axis, and of those that are only horizontal. tuned: flat
# from 0.2 to 0.42 and from 0.1 to 0.28.
STRAY_NORMALS, OTHER_WALLS = 0.3, 0.2
# Errors beyond three standard deviations do not count.
MOST_VARIANCES = 9.0
# Keeps the direction of a line defined where it passes through the vanishing point. chosen: the
# square of two degrees.
MIN_IMAGE_LENGTH2 = 1e-3
# The natural logarithm of 2, and that of 1 to 2 in powers from 0 to 5 within 1e-5: derived, least
# squares at Chebyshev's points. Votes are known to a few percent.
LOG_2 = math.log(2)
LOG = (-1.93675974, 3.51408730, -2.44002976, 1.11609003, -0.28382685, 0.03044900)


@dataclass(frozen=True)
class Evidence:
    """Lines and normals of an image."""

    # (N, 8) float64: normals of planes through the camera, midpoints, variances and votes of
    # segments
    lines: np.ndarray
    normals: np.ndarray  # (M, 3) float64: of the surfaces of the depth
    normal_rad: float = np.radians(NORMAL_DEG[-1])  # their error
    stray_share: float = STRAY_LINES  # share of the lines that are along no axis
    log_odds_down: float = 0.0  # of a camera that looks straight down
    # four log likelihoods that gravity points to the bottom, right, top and left of the image
    log_turned: Sequence[float] = TAKEN_AS_UPRIGHT
    focal_error: float = 0.0  # share of the focal length, of lines and normals together

    @property
    def log_mountings(self) -> list[float]:
        """Log likelihoods of the five mountings."""
        return [*self.log_turned, self.log_odds_down]


def line_table(segments: LineSegments, focal_error: float) -> np.ndarray:
    """Return the lines of :class:`Evidence`; the error of the focal length is a share of it."""
    normals, unit = segments.normals, segments.unit_normals
    in_line = (np.abs(unit @ unit.T) > np.cos(np.radians(SAME_LINE_DEG))).sum(axis=1)
    variance = np.radians(LINE_DEG) ** 2 + (END_ERROR / segments.lengths) ** 2
    # The image of a direction moves toward the centre by this share, and the line past it.
    variance += (focal_error * np.linalg.norm(segments.midpoints[:, :2], axis=1)) ** 2
    votes = LINE_VOTE * np.sqrt(segments.lengths / FULL_LENGTH) / in_line
    return np.column_stack([normals, segments.midpoints, variance, votes])


def log_likelihood(bases: np.ndarray, azimuths_rad: np.ndarray, evidence: Evidence,
                   error_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the tempered log likelihoods of upright lines and of everything else, both (V, A).

    Parameters
    ----------
    bases : (V, 3, 3) float64
        Rows: a vertical and two horizontal directions.
    azimuths_rad : (V, A) float64
        Of the first horizontal axis, from the second row of the basis towards the third.
    evidence : Evidence
    error_rad : float
        Added to all errors.

    """
    return _log_likelihood(np.ascontiguousarray(bases), np.cos(azimuths_rad),
                           np.sin(azimuths_rad),
                           np.ascontiguousarray(evidence.lines.T, np.float32),
                           evidence.normals, error_rad, evidence.normal_rad, evidence.stray_share)


@kernel('float64(float64)')
def _bell(square):
    """Return nearly exp(-square / 2), 0 beyond three standard deviations, without its cost."""
    inside = max(1 - square * (1 / MOST_VARIANCES), 0.0)
    return inside * inside * inside * inside


@kernel('float32(float32, float32, float32, float32)')
def _near(cross, x, y, sharp):
    """
    Return how near a line points to a direction, 1 exactly, by the image of that direction.

    This is the bell above of cross^2 / (x^2 + y^2) over the variance; sharp is 1 / (9 variance).
    """
    inside = max(np.float32(1) - cross * cross * sharp / (
        x * x + y * y + np.float32(MIN_IMAGE_LENGTH2)), np.float32(0))
    square = inside * inside
    return square * square


@kernel('float32(float32[::1], float32[::1], float32[::1])')
def _sum_of_logs(votes, values, fractions):
    """Return the sum of votes times the logarithms of values above 0, each to 1e-5."""
    bits, fraction_bits = values.view(np.int32), fractions.view(np.int32)
    for i in range(len(values)):
        fraction_bits[i] = bits[i] & np.int32(0x7fffff) | np.int32(0x3f800000)
    total = np.float32(0)
    for i in range(len(values)):
        x, exponent = fractions[i], (bits[i] >> np.int32(23)) - np.int32(127)
        log = np.float32(exponent) * np.float32(LOG_2) + np.float32(LOG[0]) + x * (
            np.float32(LOG[1]) + x * (np.float32(LOG[2]) + x * (
                np.float32(LOG[3]) + x * (np.float32(LOG[4]) + x * np.float32(LOG[5])))))
        total += votes[i] * log
    return total


@kernel('void(float64[:, ::1], float64[::1], float64[::1], float64[:, ::1], '
        'UniTuple(float64, 2), float64[::1])')
def _add_normals(basis, cosines, sines, normals, errors_rad, sums):
    """Add the log likelihoods (A,) of normals."""
    variance = errors_rad[0] * errors_rad[0] + errors_rad[1] * errors_rad[1]
    sharp = 1 / variance  # a division takes as long as everything else in the loop over azimuths
    # Densities relative to a uniform one: of six directions and of a circle on the sphere.
    of_axis = (1 - OTHER_WALLS) * 4 * np.pi / (6 * 2 * np.pi * variance)
    of_circle = OTHER_WALLS * 4 * np.pi / (2 * np.pi * np.sqrt(2 * np.pi * variance))
    product, along = np.ones(len(sums)), np.empty(3)  # of at most 20 factors between 0.3 and 100
    for i in range(len(normals)):
        for k in range(3):
            along[k] = (normals[i, 0] * basis[k, 0] + normals[i, 1] * basis[k, 1]
                        + normals[i, 2] * basis[k, 2])
        square = along[0] * along[0]
        fixed = STRAY_NORMALS + (1 - STRAY_NORMALS) * (
            of_axis * _bell((1 - square) * sharp) + of_circle * _bell(square * sharp))
        for z in range(len(sums)):
            x = cosines[z] * along[1] + sines[z] * along[2]
            y = 1 - square - x * x
            product[z] *= fixed + (1 - STRAY_NORMALS) * of_axis * (
                _bell((1 - x * x) * sharp) + _bell((1 - y) * sharp))
    for z in range(len(sums)):
        sums[z] += np.log(product[z])


@kernel('Tuple((float64[:, ::1], float64[:, ::1]))(float64[:, :, ::1], float64[:, ::1], '
        'float64[:, ::1], float32[:, ::1], float64[:, ::1], float64, float64, float64)')
def _log_likelihood(bases, cosines, sines, lines, normals, error_rad, normal_rad,
                    stray_share):
    count, azimuths = cosines.shape
    upright, others = np.zeros((count, azimuths)), np.zeros((count, azimuths))
    for v in range(count):
        _add_normals(bases[v], cosines[v], sines[v], normals, (error_rad, normal_rad), others[v])
    if not lines.shape[1]:
        return upright, others
    # In loops over lines, so that eight or more are computed at once. Of each line: the density
    # of one that points to the vertical, the weight of a direction, and 1 / (9 variance); the
    # numbers of _near for the three directions of a basis; and what the sums of logs take.
    line = np.empty((3, lines.shape[1]), np.float32)
    near, logs = np.empty((9, lines.shape[1]), np.float32), np.empty_like(line)
    for i in range(lines.shape[1]):
        spread = lines[6, i] + error_rad * error_rad
        line[1, i] = (1 / stray_share - 1) * np.pi / (3 * np.sqrt(2 * np.pi * spread))
        line[2, i] = 1 / (MOST_VARIANCES * spread)
    for v in range(count):
        for k in range(3):
            x, y, z = (np.float32(bases[v, k, 0]), np.float32(bases[v, k, 1]),
                       np.float32(bases[v, k, 2]))
            for i in range(lines.shape[1]):
                near[k, i] = lines[0, i] * x + lines[1, i] * y + lines[2, i] * z
                near[k + 3, i] = x - lines[3, i] * z
                near[k + 6, i] = y - lines[4, i] * z
        for i in range(lines.shape[1]):
            line[0, i] = line[1, i] * _near(near[0, i], near[3, i], near[6, i], line[2, i])
        for azimuth in range(azimuths):
            c, s = np.float32(cosines[v, azimuth]), np.float32(sines[v, azimuth])
            for i in range(lines.shape[1]):
                level = np.float32(1) + line[1, i] * (
                    _near(c * near[1, i] + s * near[2, i], c * near[4, i] + s * near[5, i],
                          c * near[7, i] + s * near[8, i], line[2, i])
                    + _near(c * near[2, i] - s * near[1, i], c * near[5, i] - s * near[4, i],
                            c * near[8, i] - s * near[7, i], line[2, i]))
                logs[0, i], logs[1, i] = level, np.float32(1) + line[0, i] / level
            others[v, azimuth] += _sum_of_logs(lines[7], logs[0], logs[2])
            upright[v, azimuth] = _sum_of_logs(lines[7], logs[1], logs[2])
    return upright, others
