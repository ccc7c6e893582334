# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Prior of the vertical: the mountings of cameras, and the evidence of previous views.

Cameras are held upright, on a side or upside down, or look straight down; or a sensor gives a
coarse direction of gravity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector._runtime.compilation import kernel

# Values said to be tuned are so as those of posterior.py.  Prior of pitch and roll of a camera
# held by hand or on a robot: mean and spread of the pitch, spread of the roll. tuned: the roll,
# Brier score of rendered scenes .065 at 8 degrees, .072 at 10, .081 at 12; of real ones .092,
# .094, .095. chosen: the pitch, from looking up slightly to looking at the floor; a camera that
# looks up is as likely to be upside down.
PITCH_DEG, HELD_DEG = 15.0, (25.0, 8.0)
# Share of cameras that look straight down (arms, drones, desks), and their tilt from there; 37
# tilts more. A wall straight ahead and a table straight below have the same lines and normals.
# chosen: lines alone then leave open which of them a surface parallel to the image plane is, and
# nothing at ten degrees from there.
LOOKING_DOWN, DOWN_DEG = 0.05, 12.0
# Share of cameras for each of three more mountings: on either side, and upside down. tuned: three
# walks in four mountings. At .05, .07, .1, .12 and .14, of upright streams by colour 84, 84, 84,
# 82 and 81 % are answered; of turned images with measured depth, single ones or in streams, at
# worst 5, 3, 2, 2 and 0 % of a walk are wrong; of 60 single images of turned corridors, whose
# pictures show no light, at .1, .12 and .14 two, one and none.
TURNED = 0.14
# Of gravity to the bottom, right, top and left of the image: the roll, and the share of cameras.
TURNS_DEG = np.array([[0.0], [-90.0], [180.0], [90.0]])
SHARES = np.array([[1 - LOOKING_DOWN - 3 * TURNED], *[[TURNED]] * 3])
# The largest density of each mounting, 1/sr.
PEAKS = np.vstack([
    SHARES / (2 * math.pi * math.radians(HELD_DEG[0]) * math.radians(HELD_DEG[1])),
    [[LOOKING_DOWN / (2 * math.pi * math.radians(DOWN_DEG) ** 2)]]])
# Keeps logarithms finite; and the squared deviation beyond which a bell, 1e-13 of its peak, is 0.
TINY, FAR_SQUARE = 1e-30, 60.0
# In each further view, a vertical of previous views is weighted by this power of the density of
# mountings: a camera that turns keeps its tilt against the vertical, but not against the other
# axes. tuned: by colour, three walks in four mountings, answered upright and wrong turned: at 0 55
# and 3 %, at .25 57 and 0 %, at .4 61 and 0 %, and then more of a turned camera that pans back and
# forth.
STEADY = 0.25
# Cameras rotate about the vertical more than about other axes: the likelihood of a vertical is the
# share of the rotation about it, one observation for all views. measured: .78 and .70 in two walks
# with poses. Less rotation than this shows little. chosen: two views.
LITTLE_TURN_RAD = np.radians(12.0)
# Without depth no camera is turned.
TAKEN_AS_UPRIGHT = (math.log((1 - LOOKING_DOWN) / (1 - LOOKING_DOWN - 3 * TURNED)),
                    *[-math.inf] * 3)


@dataclass(frozen=True)
class Modes:
    """Verticals with most of the mass of a posterior, the largest first; the rest is anywhere."""

    downs: np.ndarray  # (K, 3) float64: unit vectors
    covariances: np.ndarray  # (K, 3, 3) float64: rad^2
    # (K,) float64: probability that the true vertical is within CLOSE_DEG of each
    masses: np.ndarray
    unsided: np.ndarray  # (K,) float64: the same without the evidence of the sides of the image
    gain: float = 0.0  # log likelihood of everything except upright lines at the main mode

    def bells(self, error_rad: float) -> np.ndarray:
        """
        Return the normal densities (K, 13) of the modes, 1/sr, blurred by an error.

        The columns are the mean (3), the inverse covariance (9) and the density of the mean.
        """
        wide = self.covariances + error_rad**2 * np.eye(3)
        along = np.einsum('ki,kij,kj->k', self.downs, wide, self.downs)
        areas = 2 * np.pi * np.sqrt(np.linalg.det(wide) / along)
        return np.hstack([self.downs, np.linalg.inv(wide).reshape(-1, 9),
                          (self.unsided / areas)[:, None]])


@dataclass(frozen=True)
class Expected:
    """What is known about the vertical before an image."""

    # (3,) float64 or None: coarse direction of gravity; None: that of a camera held upright
    down: np.ndarray | None = None
    sigma_deg: float = 12.0  # its error; not used without a direction
    before: Modes | None = None  # known before the view began, in the frame of this camera
    kept: float = 0.0  # probability that these still hold
    last: Modes | None = None  # of the previous image, in the frame of this camera
    # (2, 3) float64 or None: horizontal axes of the previous image, in the frame of this camera
    pair: np.ndarray | None = None
    pair_rad: float = 0.0  # error of their azimuth
    # (3, 3) float64 or None: sum of r r^T of the rotation vectors r from view to view, rad^2, in
    # the frame of this camera
    turning: np.ndarray | None = None


@dataclass(frozen=True)
class Mounted:
    """How cameras are mounted for which verticals are down."""

    densities: np.ndarray  # (5, N) float64: as of :func:`mounted_density`

    @cached_property
    def steadiness(self) -> np.ndarray:
        """Weight (N,) of what previous views showed."""
        return (self.densities / PEAKS).max(axis=0) ** STEADY


def prior_density(downs: np.ndarray, expected: Expected, log_mountings: Sequence[float],
                  error_deg: float, mounted: Mounted | None = None) -> np.ndarray:
    """
    Return the prior density (2, N) of verticals (N, 3), 1/sr, blurred by an error.

    The second one omits the evidence of the sides of the image, the log likelihoods of the five
    mountings. ``mounted`` are those of these verticals, if they are known. They are never 0.
    """
    held, turned, bells, rest = np.ones(len(downs)), np.eye(3), np.zeros((0, 13)), 1.0
    if expected.down is not None:
        sigma_rad = np.radians(math.hypot(expected.sigma_deg, error_deg))
        off_rad = np.arccos((downs @ expected.down).clip(-1, 1))
        densities, likelihoods = np.exp(-0.5 * (off_rad / sigma_rad) ** 2)[None] / (
            2 * np.pi * sigma_rad**2), np.ones(1)
    else:
        mounted = mounted or Mounted(mounted_density(downs))
        densities, likelihoods = mounted.densities, np.exp(log_mountings)
        if expected.turning is not None:
            turned = likelihood_of_turning(expected.turning)
    if expected.before is not None:
        before, kept = expected.before, expected.kept
        bells = before.bells(np.radians(error_deg))
        bells[:, -1] *= kept
        rest = 1 - kept * min(before.unsided.sum(), 1.0)
        held = held if expected.down is not None else mounted.steadiness
    return _density(np.ascontiguousarray(downs), densities, likelihoods, turned,
                    (held, bells, rest))


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], '
        'Tuple((float64[::1], float64[:, ::1], float64)))')
def _density(downs, densities, likelihoods, turned, before):
    """
    Return the prior (2, N) of :func:`prior_density` at verticals (N, 3).

    Of mountings (M, N) and their likelihoods (M,), times the likelihood of the rotation of the
    camera and, after previous views, their normal densities and the weight (N,) of these.
    """
    held, bells, rest = before
    found, seen = np.full((2, len(downs)), TINY), np.zeros(len(downs))
    sided, anywhere = found[0], found[1]
    for k in range(len(densities)):
        for i in range(len(downs)):
            anywhere[i] += densities[k, i]
            sided[i] += likelihoods[k] * densities[k, i]
    for k in range(len(bells)):
        b = bells[k]
        for i in range(len(downs)):
            x, y, z = downs[i, 0] - b[0], downs[i, 1] - b[1], downs[i, 2] - b[2]
            square = (b[3] * x * x + b[7] * y * y + b[11] * z * z
                      + 2 * (b[4] * x * y + b[5] * x * z + b[8] * y * z))
            if square < FAR_SQUARE:
                seen[i] += b[12] * np.exp(-0.5 * square)
    for i in range(len(downs)):
        x, y, z = downs[i, 0], downs[i, 1], downs[i, 2]
        share = sided[i] / anywhere[i] * (
            turned[0, 0] * x * x + turned[1, 1] * y * y + turned[2, 2] * z * z
            + 2 * (turned[0, 1] * x * y + turned[0, 2] * x * z + turned[1, 2] * y * z))
        anywhere[i] = (seen[i] + rest * anywhere[i]) * held[i]
        sided[i] = anywhere[i] * share + TINY
        anywhere[i] += TINY
    return found


def likelihood_of_turning(turning: np.ndarray) -> np.ndarray:
    """Return the form (3, 3) d^T form d in verticals d, the likelihood of a rotation (3, 3)."""
    return (turning + LITTLE_TURN_RAD**2 / 3 * np.eye(3)) / (
        np.trace(turning) + LITTLE_TURN_RAD**2)


def held_density(down: np.ndarray) -> float:
    """Return the prior density of a vertical (3,) of a camera that does not look down, 1/sr."""
    return float(mounted_density(down[None])[:4].sum())


def mounted_density(downs: np.ndarray) -> np.ndarray:
    """Return the prior density (5, N), 1/sr, of turned cameras, and of one looking down."""
    pitch_deg, roll_deg = _tilt_deg(downs)
    rolls_deg = (roll_deg - TURNS_DEG + 180) % 360 - 180
    held = SHARES * _normal_density(pitch_deg - PITCH_DEG, rolls_deg, HELD_DEG)
    off_deg = np.degrees(np.arccos(downs[:, 2].clip(-1, 1)))
    return np.vstack([held, LOOKING_DOWN * _normal_density(off_deg, 0.0, (DOWN_DEG, DOWN_DEG))])


def _tilt_deg(downs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pitch and roll (...) of verticals (..., 3)."""
    return (np.degrees(np.arcsin(downs[..., 2].clip(-1, 1))),
            np.degrees(np.arctan2(-downs[..., 0], downs[..., 1])))


def _normal_density(pitch_deg: np.ndarray, roll_deg: np.ndarray | float,
                    spread_deg: tuple[float, float]) -> np.ndarray:
    """Return the normal density of pitch and roll, 1/sr."""
    of_pitch, of_roll = spread_deg
    return (np.exp(-0.5 * ((pitch_deg / of_pitch) ** 2 + (roll_deg / of_roll) ** 2))
            / (2 * math.pi * math.radians(of_pitch) * math.radians(of_roll)))
