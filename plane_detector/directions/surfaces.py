# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Normals of the surfaces of a depth image; evidence from them and its disparity on the mounting.

Cameras see more surfaces that face upwards than downwards, and near surfaces are at the bottom of
the image; a camera that looks straight down sees one surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.photograph import NO_SCORE, log_likelihood
from plane_detector.geometry.rigid_transform import unit
from plane_detector.geometry.robust import order_statistics
from plane_detector.types import CameraIntrinsics

# Values said to be tuned are so as those of posterior.py.
# By the depth: cameras see much of what faces upwards, floors and tables, and hardly anything that
# faces downwards, while walls on both sides are seen alike. The log likelihood that gravity points
# to a side of the image is the log of the share of normals within FACING_DEG of it (of floors,
# away from the camera) times one weight, less that of its opposite times the other.
# tuned: 77 real frames, 35 rooms and corridors (seeds from 8200), each in four mountings: 58 real
# frames are answered upright, 4 of 231 turned ones and one of 75 turned corridors are wrong; at
# (0.7, 1.5) and at (0.5, 2) with 0.03 three corridors are, at (0.3, 1.5) 51 are answered upright.
FLOOR_WEIGHT, CEILING_WEIGHT, FACING_DEG, LEAST_SHARE = 0.5, 1.5, 41.4, 0.02
# By the disparity: upright cameras see near surfaces at the bottom. The trend is the difference of
# the medians of the lowest and the highest quarter of the image over the spread (10 to 90 %) of
# all. Its density upright is normal, or as from above anywhere between -1 and 1. measured: .3 to 1
# in 49 of 57 upright views of rooms, without bias in 20 from above.
UPRIGHT_TREND, TREND_SPREAD, ANY_TREND = 0.65, 0.25, 0.15
# The surface is evidence too: the share of its normals within this angle of straight ahead has a
# half-normal density upright, or, as seen from above, is anywhere between 0 and 1. measured:
# median 0.03, nine of ten below 0.5 in 80 upright views of rooms, one at 0.84; 0.73 to 1 in 24 of
# rooms from above, 0.11 to 0.55 in 6 of tables with things on them. tuned: rooms, seeds 300 to 323
# and 2007, flat from 0.3 to 0.4 and from 0.05 to 0.1; at 0.25 walls ahead are lost. A small share
# proves nothing: cluttered tables, streets between high buildings.
AHEAD_DEG, AHEAD_SPREAD, ANY_AHEAD = 20.0, 0.35, 0.1
# With an unknown shift it is the share of the largest surface, as pieces of one plane are parallel
# at any shift; looked at is the one that makes the far tenth of the disparities this share of the
# near tenth. The share is normal upright, or as from above anywhere between 0 and 1; a smaller one
# says nothing. measured: median 0.42, at most 0.72 in 50 upright views of rooms; 0.63 to 1, median
# 0.97, in 30 of rooms from above; the same within 0.03 for a far tenth of 0.2 to 0.6.
USUAL_RATIO, LARGEST, LARGEST_SPREAD = 0.43, 0.45, 0.13
# chosen: a cell of 16 pixels in an image of 640, about a cell of the segmentation, half of it
# valid.
CELLS_PER_ROW, LEAST_VALID = 40, 0.5
# A cell is on a step if the normals of its two sides differ by more than this: what stands before
# a floor would else have a ceiling at its lower edge. tuned: as FLOOR_WEIGHT, flat from 30 to 50.
STEP_DEG = 40.0
# Normals within this angle of a normal with many neighbours are one surface, which has one vote if
# it has this share of them; about this many are examined. tuned: with a vote for each normal 41 of
# 56 answers in attics are wrong, as the slopes of a roof are larger than floor and gable, here 8
# of 50; at 12 and 18 degrees, and with a share of 0.03 or 0.06, fewer parts of images are
# answered.
SAME_SURFACE_DEG, LEAST_SURFACE, SURFACE_NORMALS = 15.0, 0.05, 200


@dataclass(frozen=True)
class Sides:
    """What shows which side of the image is down, in one view or several: their mean."""

    shares: np.ndarray  # (4,) float64: of the normals, toward bottom, right, top and left
    log_odds_down: float
    picture: np.ndarray  # (4,) float64: as of :func:`score_of_sides`
    views: int = 1

    def with_view(self, other: Sides) -> Sides:
        """Return the mean with that of another view."""
        mine = self.views / (self.views + other.views)
        return Sides(mine * self.shares + (1 - mine) * other.shares,
                     mine * self.log_odds_down + (1 - mine) * other.log_odds_down,
                     mine * self.picture + (1 - mine) * other.picture,
                     self.views + other.views)

    @property
    def log_likelihood(self) -> np.ndarray:
        """Log likelihoods (4,), by the surfaces, that gravity points to each side, at most 0."""
        if not self.shares.any():
            return np.zeros(4)
        shares = np.log(self.shares + LEAST_SHARE)
        log_sides = FLOOR_WEIGHT * shares - CEILING_WEIGHT * np.roll(shares, 2)
        return log_sides - log_sides.max()

    @property
    def log_likelihood_by_picture(self) -> np.ndarray:
        """The same by the photograph."""
        return log_likelihood(self.picture)


def log_odds_down(disparity: np.ndarray, surface: np.ndarray,
                  has_shift: bool = False) -> float:
    """
    Return the log odds, from depth, that a camera looks straight down.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/z, not finite where invalid.
    surface : (N, 3) floating
        Normals of the depth; those without a direction are 0. With an unknown shift, at the
        usual one.
    has_shift : bool

    """
    far, near = _far_and_near(disparity)
    odds = _odds_by_trend(disparity, near - far)
    known = _some_known(surface)
    if not len(known):
        return odds
    if has_shift:
        share = (known @ known.T > math.cos(math.radians(SAME_SURFACE_DEG))).mean(axis=1).max()
        usual = _normal(max(share - LARGEST, 0.0) / LARGEST_SPREAD) / LARGEST_SPREAD
    else:
        share = np.mean(np.abs(known[:, 2]) > math.cos(math.radians(AHEAD_DEG)))
        usual = 2 * _normal(share / AHEAD_SPREAD) / AHEAD_SPREAD
    return odds - min(math.log((1 - ANY_AHEAD) * usual + ANY_AHEAD), 0.0)


def sides_of(surface: np.ndarray, odds_down: float = 0.0,
             picture: np.ndarray = NO_SCORE) -> Sides:
    """
    Return what a surface and a photograph show about which side of the image is down.

    Parameters
    ----------
    surface : (N, 3) floating
        Normals of the depth, as for :func:`log_odds_down`, but for those on steps.
    odds_down : float
        As of :func:`log_odds_down`.
    picture : (4,) floating
        As of :func:`score_of_sides`.

    """
    known = _some_known(surface)
    if not len(known):
        return Sides(np.zeros(4), odds_down, picture)
    sides = known[:, 1::-1]  # towards the bottom, towards the right
    facing = math.cos(math.radians(FACING_DEG))
    return Sides(np.concatenate([(sides > facing).mean(axis=0), (-sides > facing).mean(axis=0)]),
                 odds_down, picture)


def usual_inverse_depth(disparity: np.ndarray) -> np.ndarray:
    """Return 1/z (H, W), in any unit, for a usual shift of a disparity of unknown shift."""
    far, near = _far_and_near(disparity)
    return disparity + ((near - far) / (1 - USUAL_RATIO) - near)


def _far_and_near(disparity: np.ndarray) -> tuple[float, float]:
    """Return the far and the near tenth of the disparities; 0 if there are none."""
    thinned = disparity[::8, ::8]
    known = thinned[np.isfinite(thinned)]
    if not len(known):
        return 0.0, 0.0
    return tuple(order_statistics(known, rank)[1]
                 for rank in (len(known) // 10, len(known) - 1 - len(known) // 10))


def _some_known(normals: np.ndarray) -> np.ndarray:
    known = normals[np.abs(normals).sum(axis=1) > 0]
    return known[::max(1, len(known) // SURFACE_NORMALS)]


def _odds_by_trend(disparity: np.ndarray, spread: float) -> float:
    thinned = disparity[::8, ::8]
    quarter = len(thinned) // 4
    top, bottom = (np.sort(part[np.isfinite(part)])
                   for part in (thinned[:quarter], thinned[len(thinned) - quarter:]))
    if not len(top) or not len(bottom) or not spread > 0:
        return 0.0
    trend = np.clip((bottom[len(bottom) // 2] - top[len(top) // 2]) / spread, -1, 1)
    upright = _normal((trend - UPRIGHT_TREND) / TREND_SPREAD) / TREND_SPREAD
    return -math.log(2 * (1 - ANY_TREND) * upright + ANY_TREND)


def _normal(deviations: float) -> float:
    return math.exp(-0.5 * deviations**2) / math.sqrt(2 * math.pi)


def mean_normals(normals: np.ndarray) -> np.ndarray:
    """Return the mean normals (S, 3) of surfaces, groups of normals (N, 3) close to each other."""
    known = _some_known(normals)
    near = (known @ known.T > np.cos(np.radians(SAME_SURFACE_DEG))).astype(np.float32)
    left, found = np.ones(len(known), np.float32), []
    while left.any():
        sizes = near @ left * left
        largest = sizes.argmax()
        if sizes[largest] < LEAST_SURFACE * len(known):
            break
        found.append(unit((near[largest] * left) @ known))
        left *= 1 - near[largest]
        left[largest] = 0  # also if it is not finite, and so not near itself
    return np.array(found, float).reshape(-1, 3)


def surface_normals(disparity: np.ndarray,
                    intrinsics: CameraIntrinsics) -> tuple[np.ndarray, np.ndarray]:
    """
    Return unit normals (N, 3) of the surface on a grid over the image, away from the camera.

    Also returned is which of these cells (N,), bool, are on a step of the depth.

    Parameters
    ----------
    disparity : (H, W) floating
        1/z, not finite or not positive where invalid; these cells have the normal 0.
    intrinsics : CameraIntrinsics

    """
    step = max(1, intrinsics.width // CELLS_PER_ROW)
    if min(intrinsics.width, intrinsics.height) // step < 3:  # a normal needs a cell on each side
        return np.zeros((0, 3)), np.zeros(0, bool)
    every = 1 if step % 8 else 2  # pixel of a row; half of them are enough in large cells
    normals, bends = _surface(
        np.ascontiguousarray(disparity, np.float32), step, every,
        (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy))
    is_step = bends.any(axis=2)
    # A step within a cell bends the surface on both sides of it.
    is_step[:, 1:-1] |= bends[:, :-2, 0] & bends[:, 2:, 0]
    is_step[1:-1] |= bends[:-2, :, 1] & bends[2:, :, 1]
    return normals.reshape(-1, 3), is_step.ravel()


@kernel("Tuple((float64[:, :, ::1], boolean[:, :, ::1]))(Array(float32, 2, 'C', readonly=True), "
        'int64, int64, UniTuple(float64, 4))', is_short=True)
def _surface(disparity, step, every, camera):
    """
    Return the normals (h, w, 3) of the inner cells, 0 if unknown.

    Also returned is whether the surface bends in each along the row and along the column, by the
    normals of the two halves (h, w, 2).
    """
    (fx, fy, cx, cy), height, width = camera, len(disparity) // step, disparity.shape[1] // step
    inverse, least = np.full((height, width), np.nan), LEAST_VALID * (-(-step // every)) ** 2
    for i in range(height):
        for j in range(width):
            total, count = np.float32(0), np.int32(0)
            for v in range(i * step, (i + 1) * step, every):
                for u in range(j * step, (j + 1) * step, every):
                    value = disparity[v, u]
                    total += value if value > 0 else np.float32(0)
                    count += np.int32(value > 0)
            if count > least:
                inverse[i, j] = total / count
    normals = np.zeros((height - 2, width - 2, 3))
    bends = np.zeros((height - 2, width - 2, 2), np.bool_)
    middle, least = (step - every) / 2, np.cos(np.radians(STEP_DEG))
    for i in range(1, height - 1):
        y = (i * step + middle - cy) / fy
        for j in range(1, width - 1):
            x, here = (j * step + middle - cx) / fx, inverse[i, j]
            # 1/z = p x + q y + r on a plane with a normal along (p, q, r).
            before = (here - inverse[i, j - 1]) * fx / step
            after = (inverse[i, j + 1] - here) * fx / step
            above = (here - inverse[i - 1, j]) * fy / step
            below = (inverse[i + 1, j] - here) * fy / step
            p, q = (before + after) / 2, (above + below) / 2
            r, n = here - p * x - q * y, normals[i - 1, j - 1]
            length = np.sqrt(p * p + q * q + r * r)
            if 0 < length < np.inf:
                n[0], n[1], n[2] = p / length, q / length, r / length
            rest = here - q * y
            bends[i - 1, j - 1, 0] = least > _angle_cosine(
                q, before, rest - before * x, after, rest - after * x)
            rest = here - p * x
            bends[i - 1, j - 1, 1] = least > _angle_cosine(
                p, above, rest - above * y, below, rest - below * y)
    return normals, bends


@kernel('float64(float64, float64, float64, float64, float64)')
def _angle_cosine(common, x, z, other_x, other_z):
    """Return the cosine between two normals that share one component, by their other two."""
    square = common * common
    return (x * other_x + square + z * other_z) / np.sqrt(
        (x * x + square + z * z) * (other_x * other_x + square + other_z * other_z))
