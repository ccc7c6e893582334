# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Posterior of the vertical and of the azimuth of the scene.

1. A grid has every frame of three perpendicular axes once; each axis, up or down, may be the
   vertical. The prior is how cameras are mounted: upright, on a side, upside down, or looking
   straight down, or a coarse direction of gravity, and the modes of the views before.
2. Each line segment points to one of the axes, with an error by its length, or anywhere; the share
   of those is that of the best coarse cell. Segments of one line share one vote.
3. Each surface of the depth has a normal along one of the axes, or horizontal, or anything, with
   the error for which these normals alone are most likely, and one vote however large it is.
4. The evidence of lines is tempered: edges of one object are not independent.
5. The grid is coarse first; its best cells are divided once more. The verticals within 5 degrees
   of an answer are its mass: the probability that it is right. The mass of all frames with one of
   its axes is the probability of that axis, whichever side is down.

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

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.line_segments import LineSegments
from plane_detector.geometry.rigid_transform import cross, unit
from plane_detector.types import CameraIntrinsics

# Values said to be tuned are so on the views of python -m plane_detector.evaluation.benchmark
# orientation --only calibration --first-seed 300 --scenes 12 of commit 671e645, for normals also
# with the depth of fastdepth and of the sensors of the same views.
#
# Prior of pitch and roll of a camera held by hand or on a robot: mean and spread of the pitch,
# spread of the roll. tuned: the roll, Brier score of rendered scenes .065 at 8 degrees, .072 at
# 10, .081 at 12; of real ones .092, .094, .095. chosen: the pitch, from looking up slightly to
# looking at the floor; whoever looks up is as likely to be upside down.
PITCH_DEG, HELD_DEG = 15.0, (25.0, 8.0)
# chosen: the range of the axis closest to the bottom of the image, of any three at right angles.
MAX_PITCH_DEG, MAX_ROLL_DEG, STEP_DEG = 52.5, 45.0, 7.5
# Share of cameras that look straight down (arms, drones, desks), and their tilt from there; 37
# tilts more. A wall straight ahead and a table straight below have the same lines and normals.
# chosen: lines alone then leave open which of them a surface parallel to the image plane is, and
# nothing at ten degrees from there.
LOOKING_DOWN, DOWN_DEG = 0.05, 12.0
# Share of cameras for each of three more mountings: on either side, and upside down. tuned: three
# walks by colour in four mountings, as streams, answered upright and, of all turned images, wrong:
# at .07 59 and 5 %, at .1 51 and 1 %, at .14 33 and 0 %.
TURNED = 0.1
# By the depth: cameras see much of what faces upwards, floors and tables, and hardly anything that
# faces downwards, while walls on both sides are seen alike. The log likelihood that gravity points
# to a side of the image is the log of the share of normals within FACING_DEG of it (of floors,
# away from the camera) times one weight, less that of its opposite times the other.
# tuned: 56 real frames, 48 rooms and corridors (seeds 8200 to 8211), each in four mountings: from
# (0.3, 1.5) and (0.5, 2) to (0.7, 2) 38 to 41 real frames are answered upright, 2 turned wrong.
FLOOR_WEIGHT, CEILING_WEIGHT, FACING_DEG, LEAST_SHARE = 0.7, 2.0, 41.4, 0.02
# By the disparity: upright cameras see what is near at the bottom. The trend is the difference
# of the medians of the lowest and the highest quarter of the image over the spread (10 to 90 %) of
# all. Its density upright is normal, or as from above anywhere between -1 and 1. measured: .3 to
# 1 in 49 of 57 upright views of rooms, without bias in 20 from above.
UPRIGHT_TREND, TREND_SPREAD, ANY_TREND = 0.65, 0.25, 0.15
# The surface tells, too: the share of its normals within this angle of straight ahead is half
# normal upright, or as from above anywhere between 0 and 1. measured: median 0.03, nine of ten
# below 0.5 in 80 upright views of rooms, one at 0.84; 0.73 to 1 in 24 of rooms from above, 0.11 to
# 0.55 in 6 of tables with things on them. tuned: rooms, seeds 300 to 323 and 2007, flat from 0.3
# to 0.4 and from 0.05 to 0.1; at 0.25 walls ahead are lost. A small share says nothing: cluttered
# tables, streets between high buildings.
AHEAD_DEG, AHEAD_SPREAD, ANY_AHEAD = 20.0, 0.35, 0.1
# With an unknown shift it is the share of the largest surface, as pieces of one plane are parallel
# at any shift; looked at is the one that makes the far tenth of the disparities this share of the
# near tenth. The share is normal upright, or as from above anywhere between 0 and 1; a smaller one
# says nothing. measured: median 0.42, at most 0.72 in 50 upright views of rooms; 0.63 to 1, median
# 0.97, in 30 of rooms from above; the same within 0.03 for a far tenth of 0.2 to 0.6.
USUAL_RATIO, LARGEST, LARGEST_SPREAD = 0.43, 0.45, 0.13
# Each step is divided by three in the best cells that are not negligible (log of the posterior).
# tuned: flat from 8 to 1000; at 5 a tenth more answers, and twice as many wrong ones.
DIVIDED_CELLS, DIVISION, NEGLIGIBLE = 40, 3, 10.0
CELL_RAD = np.radians(STEP_DEG / DIVISION)
# Added to all errors for the distance to the next point of the grid. tuned: flat from 2.6 to 3.6,
# and from 0.7 to 1.
COARSE_ERROR_DEG, FINE_ERROR_DEG = 3.1, 0.8
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
# Share of the lines that are along no axis, before and in the best coarse cell: its prior counts
# as much as so many votes. tuned: flat from 1 to 5 votes and from 0.4 to 0.5. With a fixed share
# 3 of 60 images of random strokes are answered, with this none.
STRAY_LINES, STRAY_PRIOR_VOTES, STRAY_ROUNDS = 0.4, 5.0, 10
# chosen: a cell of 16 pixels in an image of 640, about a cell of the segmentation, half of it
# valid.
CELLS_PER_ROW, LEAST_VALID = 40, 0.5
# Normals within this angle of that of most others are one surface, which has one vote, if it has
# this share of them; about so many are looked at. tuned: with a vote for each normal 41 of 56
# answers in attics are wrong, as the slopes of a roof are larger than floor and gable, here 8 of
# 50; at 12 and 18 degrees, and with a share of 0.03 or 0.06, fewer parts of images are answered.
SAME_SURFACE_DEG, LEAST_SURFACE, SURFACE_NORMALS = 15.0, 0.05, 200
# Errors of normals, of which the most likely one is taken. measured: with finer steps 1.5 degrees
# in exact depth, 1.5 to 4 with noise of .002 per metre, 4 to 14 with .008, of sensors 1.5 to 10,
# of fastdepth mostly 10 to 20.
NORMAL_DEG = (3.5, 7.0, 14.0)
# Shares of normals that are along no axis, and of those that are only horizontal. tuned: flat
# from 0.2 to 0.42 and from 0.1 to 0.28.
STRAY_NORMALS, OTHER_WALLS = 0.3, 0.2
# Verticals within this angle of the answer are the same. chosen: what planes can use.
CLOSE_DEG = 5.0
# Errors beyond three standard deviations do not count.
MOST_VARIANCES = 9.0
# Of gravity to the bottom, right, top and left of the image: the roll, and the share of cameras.
TURNS_DEG = np.array([[0.0], [-90.0], [180.0], [90.0]])
SHARES = np.array([[1 - LOOKING_DOWN - 3 * TURNED], *[[TURNED]] * 3])
# The largest density of each mounting, 1/sr.
PEAKS = np.vstack([
    SHARES / (2 * math.pi * math.radians(HELD_DEG[0]) * math.radians(HELD_DEG[1])),
    [[LOOKING_DOWN / (2 * math.pi * math.radians(DOWN_DEG) ** 2)]]])
# Keeps logarithms finite; and the squared deviation beyond which a bell, 1e-13 of its peak, is 0.
TINY, FAR_SQUARE = 1e-30, 60.0
# A vertical of the views before has this power of the density of mountings in each further view: a
# camera that turns keeps its tilt against the vertical, and not against the other axes. tuned: by
# colour, three walks in four mountings, answered upright and wrong turned (TURNED .07): at 0
# 52 and 14 %, at .1 54 and 11 %, at .25 59 and 5 %.
STEADY = 0.25
# Cameras turn about the vertical more than about other axes: the likelihood of a vertical is the
# share of the turning about it, one observation for all views. measured: .78 and .70 in two walks
# with poses. Less turning than this shows little. chosen: two views.
LITTLE_TURN_RAD = np.radians(12.0)
# Keeps the direction of a line defined where it passes through the vanishing point. chosen: the
# square of two degrees.
MIN_IMAGE_LENGTH2 = 1e-3
# The natural logarithm of 2, and that of 1 to 2 in powers from 0 to 5 within 1e-5: derived, least
# squares at Chebyshev's points. Votes are known to a few percent.
LOG_2 = math.log(2)
LOG = (-1.93675974, 3.51408730, -2.44002976, 1.11609003, -0.28382685, 0.03044900)
# Modes that are carried to the next image, and the least mass of one. chosen: others hold less
# than the probability that is asked for leaves.
MOST_MODES, LEAST_MASS = 6, 0.01


@dataclass(frozen=True)
class Modes:
    """Verticals with most of the mass of a posterior, the largest first; the rest is anywhere."""

    downs: np.ndarray  # (K, 3) float64: unit vectors
    covariances: np.ndarray  # (K, 3, 3) float64: rad^2
    # (K,) float64: probability that the true vertical is within CLOSE_DEG of each
    masses: np.ndarray
    unsided: np.ndarray  # (K,) float64: the same without what faces the sides of the image
    gain: float = 0.0  # log likelihood of all but the upright lines at the main mode

    def density(self, downs: np.ndarray, error_rad: float) -> np.ndarray:
        """Return the density (C,) at verticals (C, 3), 1/sr, blurred by an error."""
        wide = self.covariances + error_rad**2 * np.eye(3)
        along = np.einsum('ki,kij,kj->k', self.downs, wide, self.downs)
        areas = 2 * np.pi * np.sqrt(np.linalg.det(wide) / along)
        return _sum_of_bells(np.ascontiguousarray(downs), self.downs, np.linalg.inv(wide),
                             self.unsided / areas)


@kernel('float64[::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[::1])')
def _sum_of_bells(points, means, inverses, peaks):
    """Return the sum of normal densities at points."""
    sums = np.zeros(len(points))
    for k in range(len(means)):
        xx, yy, zz = inverses[k, 0, 0], inverses[k, 1, 1], inverses[k, 2, 2]
        xy, xz, yz = inverses[k, 0, 1], inverses[k, 0, 2], inverses[k, 1, 2]
        for i in range(len(points)):
            x, y, z = (points[i, 0] - means[k, 0], points[i, 1] - means[k, 1],
                       points[i, 2] - means[k, 2])
            square = (xx * x * x + yy * y * y + zz * z * z
                      + 2 * (xy * x * y + xz * x * z + yz * y * z))
            if square < FAR_SQUARE:
                sums[i] += peaks[k] * np.exp(-0.5 * square)
    return sums


@dataclass(frozen=True)
class Expected:
    """What is known of the vertical before an image."""

    # (3,) float64 or None: coarse direction of gravity; None: that of a camera held upright
    down: np.ndarray | None = None
    sigma_deg: float = 12.0  # its error; not used without a direction
    before: Modes | None = None  # known before the view began, in the frame of this camera
    kept: float = 0.0  # probability that these still hold
    last: Modes | None = None  # of the image before, in the frame of this camera
    # (2, 3) float64 or None: horizontal axes of the image before, in the frame of this camera
    pair: np.ndarray | None = None
    pair_rad: float = 0.0  # error of their azimuth
    # (3, 3) float64 or None: sum of r r^T of the rotation vectors r from view to view, rad^2, in
    # the frame of this camera
    turning: np.ndarray | None = None


# Without depth no camera is turned.
TAKEN_AS_UPRIGHT = (math.log((1 - LOOKING_DOWN) / (1 - LOOKING_DOWN - 3 * TURNED)),
                    *[-math.inf] * 3)


@dataclass(frozen=True)
class Evidence:
    """Lines and normals of an image."""

    # (N, 8) float64: normals of planes through the camera, midpoints, variances and votes of
    # segments
    lines: np.ndarray
    normals: np.ndarray  # (M, 3) float64: of the surfaces of the depth
    normal_rad: float = np.radians(NORMAL_DEG[-1])  # their error
    stray_share: float = STRAY_LINES  # of the lines, along no axis
    log_odds_down: float = 0.0  # of a camera that looks straight down
    # four log likelihoods that gravity points to the bottom, right, top and left of the image
    log_turned: Sequence[float] = TAKEN_AS_UPRIGHT
    focal_error: float = 0.0  # share of the focal length, of lines and normals together


def collect_evidence(segments: LineSegments, surface: np.ndarray | None = None,
                     odds_down: float = 0.0,
                     log_turned: Sequence[float] = TAKEN_AS_UPRIGHT,
                     focal_error: float = 0.0) -> Evidence:
    """
    Return what the posterior takes from an image.

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
    normals = segments.normals
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    in_line = (np.abs(unit @ unit.T) > np.cos(np.radians(SAME_LINE_DEG))).sum(axis=1)
    variance = np.radians(LINE_DEG) ** 2 + (END_ERROR / segments.lengths) ** 2
    # The image of a direction moves towards the centre by this share, and the line past it.
    variance += (focal_error * np.linalg.norm(segments.midpoints[:, :2], axis=1)) ** 2
    votes = LINE_VOTE * np.sqrt(segments.lengths / FULL_LENGTH) / in_line
    lines = np.column_stack([normals, segments.midpoints, variance, votes])
    known = np.zeros((0, 3)) if surface is None else _surfaces(surface)
    return _with_normal_error(Evidence(lines, known, log_odds_down=odds_down,
                                       log_turned=log_turned, focal_error=focal_error))


def log_odds_down(disparity: np.ndarray, surface: np.ndarray,
                  has_shift: bool = False) -> float:
    """
    Return the log odds, by depth, of a camera that looks straight down.

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


@dataclass(frozen=True)
class Sides:
    """How much of what is seen faces each side of the image, of one view or of several."""

    shares: np.ndarray  # (4,) float64: of the normals, towards bottom, right, top and left
    log_odds_down: float
    views: int = 1

    def with_view(self, other: Sides) -> Sides:
        """Return the mean with that of another view."""
        mine = self.views / (self.views + other.views)
        return Sides(mine * self.shares + (1 - mine) * other.shares,
                     mine * self.log_odds_down + (1 - mine) * other.log_odds_down,
                     self.views + other.views)

    @property
    def log_likelihood(self) -> np.ndarray:
        """Log likelihoods (4,) that gravity points to each side of the image, at most 0."""
        if not self.shares.any():
            return np.zeros(4)
        shares = np.log(self.shares + LEAST_SHARE)
        log_sides = FLOOR_WEIGHT * shares - CEILING_WEIGHT * np.roll(shares, 2)
        return log_sides - log_sides.max()


def sides_of(surface: np.ndarray, odds_down: float = 0.0) -> Sides:
    """
    Return how much of a surface faces each side of the image.

    Parameters
    ----------
    surface : (N, 3) floating
        Normals of the depth, as for :func:`log_odds_down`.
    odds_down : float
        As of :func:`log_odds_down`.

    """
    known = _some_known(surface)
    if not len(known):
        return Sides(np.zeros(4), odds_down)
    sides = known[:, 1::-1]  # towards the bottom, towards the right
    facing = math.cos(math.radians(FACING_DEG))
    return Sides(np.concatenate([(sides > facing).mean(axis=0), (-sides > facing).mean(axis=0)]),
                 odds_down)


def usual_inverse_depth(disparity: np.ndarray) -> np.ndarray:
    """Return 1/z (H, W), in any unit, for a usual shift of a disparity of unknown shift."""
    far, near = _far_and_near(disparity)
    return disparity + ((near - far) / (1 - USUAL_RATIO) - near)


def _far_and_near(disparity: np.ndarray) -> tuple[float, float]:
    """Return the far and the near tenth of the disparities; 0 if there are none."""
    thinned = disparity[::8, ::8]
    known = np.sort(thinned[np.isfinite(thinned)])
    if not len(known):
        return 0.0, 0.0
    return float(known[len(known) // 10]), float(known[len(known) - 1 - len(known) // 10])


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


def _surfaces(normals: np.ndarray) -> np.ndarray:
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


def surface_normals(disparity: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Return unit normals (N, 3) of the surface on a grid over the image, away from the camera.

    Parameters
    ----------
    disparity : (H, W) floating
        1/z, not finite or not positive where invalid; these cells have the normal 0.
    intrinsics : CameraIntrinsics

    """
    step = max(1, intrinsics.width // CELLS_PER_ROW)
    size = intrinsics.width // step, intrinsics.height // step
    if min(size) < 3:  # a normal needs a cell on each side
        return np.zeros((0, 3))
    every = 1 if step % 8 else 2  # pixel of a row; half of them are enough in large cells
    thinned = disparity[:size[1] * step:every, :size[0] * step:every]
    total, share = (
        cv2.resize(image.astype(np.float32, copy=False), size, interpolation=cv2.INTER_AREA)
        for image in (np.fmax(thinned, 0), thinned > 0))
    inverse = np.where(share > LEAST_VALID, total / np.maximum(share, LEAST_VALID), np.nan)
    middle = (step - every) / 2
    x = (np.arange(1, size[0] - 1) * step + middle - intrinsics.cx) / intrinsics.fx
    y = (np.arange(1, size[1] - 1) * step + middle - intrinsics.cy) / intrinsics.fy
    # 1/z = p x + q y + r on a plane with a normal along (p, q, r).
    p = (inverse[1:-1, 2:] - inverse[1:-1, :-2]) * intrinsics.fx / (2 * step)
    q = (inverse[2:, 1:-1] - inverse[:-2, 1:-1]) * intrinsics.fy / (2 * step)
    r = inverse[1:-1, 1:-1] - p * x - q * y[:, None]
    normals = np.stack([p, q, r], axis=-1).reshape(-1, 3)
    return np.nan_to_num(normals / np.linalg.norm(normals, axis=1, keepdims=True))


@dataclass(frozen=True)
class Posterior:
    """Probability of verticals on a grid."""

    downs: np.ndarray  # (V, 3) float64: unit vectors
    masses: np.ndarray  # (V,) float64: their sum is 1
    unsided: np.ndarray  # (V,) float64: masses without what faces the sides of the image
    frames: np.ndarray  # (V, 3, 3) float64: the three axes of which each is one

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
        """Return the modes, of which the first one is about a given vertical."""
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
    prior = prior_density(grid.axes, expected, evidence, COARSE_ERROR_DEG, grid.mounted)
    of_frames = np.log(prior[0].reshape(-1, 6).sum(axis=1)).reshape(grid.azimuths.shape)
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
            * prior_density(downs, expected, evidence, FINE_ERROR_DEG))
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
    """Return evidence with the share of lines that are along no axis of a frame."""
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
        grid.axes, Expected(), evidence, COARSE_ERROR_DEG, grid.mounted
    )[0].reshape(-1, 6).sum(axis=1)).reshape(grid.azimuths.shape)
    alone = replace(evidence, lines=evidence.lines[:0])
    bases, azimuths = grid.bases, np.radians(grid.azimuths)
    tried = [replace(alone, normal_rad=np.radians(sigma_deg)) for sigma_deg in NORMAL_DEG]
    peaks = [(log_prior + sum(log_likelihood(bases, azimuths, one, np.radians(COARSE_ERROR_DEG)))
              ).max() for one in tried]
    return replace(evidence, normal_rad=tried[int(np.argmax(peaks))].normal_rad)


@dataclass(frozen=True)
class _CoarseGrid:
    """All frames of three axes at right angles, each once."""

    tilts: np.ndarray  # (V, 2) float64: pitch and roll, degrees, of the axis closest to the bottom
    azimuths: np.ndarray  # (V, A) float64: of the other two axes, degrees
    bases: np.ndarray  # (V, 3, 3) float64
    log_area: np.ndarray  # (V, A) float64: of the cells; -inf for a frame that is another cell's
    axes: np.ndarray  # (V * A * 6, 3) float64: both directions of the axes of each frame
    mounted: np.ndarray  # (5, V * A * 6) float64: their :func:`_mounted`


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
                       axes, _mounted(axes))


@cache
def _sparse_grid() -> _CoarseGrid:
    """Return the coarse grid where the prior is, with every other azimuth."""
    grid = _coarse_grid()
    near, (count, azimuths) = np.abs(grid.tilts[:, 1]) < 3 * HELD_DEG[1], grid.azimuths.shape
    return _CoarseGrid(
        grid.tilts[near], grid.azimuths[near, ::2], grid.bases[near], grid.log_area[near, ::2],
        grid.axes.reshape(count, azimuths, 6, 3)[near, ::2].reshape(-1, 3),
        grid.mounted.reshape(5, count, azimuths, 6)[:, near, ::2].reshape(5, -1))


def _frames(bases: np.ndarray, azimuths_deg: np.ndarray) -> np.ndarray:
    """Return the axes (V, A, 3, 3) of bases (V, 3, 3) at azimuths (V, A)."""
    angle = np.radians(azimuths_deg)[..., None]
    down, right, ahead = (bases[:, None, k] for k in range(3))
    x, y = (np.cos(angle) * right + np.sin(angle) * ahead,
            np.cos(angle) * ahead - np.sin(angle) * right)
    return np.stack([np.broadcast_to(down, x.shape), x, y], axis=2)


def _both_ways(frames: np.ndarray) -> np.ndarray:
    """Return the axes (6 F, 3) of frames (F, 3, 3): of each its three, then their opposites."""
    return np.concatenate([frames, -frames], axis=1).reshape(-1, 3)


def prior_density(downs: np.ndarray, expected: Expected, evidence: Evidence,
                  error_deg: float, mounted: np.ndarray | None = None) -> np.ndarray:
    """
    Return the prior density (2, N) of verticals (N, 3), 1/sr, blurred by an error.

    The second one is without what faces the sides of the image. The ``mounted`` (5, N) is their
    :func:`_mounted`, if it is known. They are never 0.
    """
    if expected.down is not None:
        sigma_rad = np.radians(math.hypot(expected.sigma_deg, error_deg))
        off_rad = np.arccos((downs @ expected.down).clip(-1, 1))
        anywhere = np.exp(-0.5 * (off_rad / sigma_rad) ** 2) / (2 * np.pi * sigma_rad**2)
        turned = 1.0
    else:
        mounted = _mounted(downs) if mounted is None else mounted
        anywhere = mounted.sum(axis=0) + TINY
        turned = (np.exp([*evidence.log_turned, evidence.log_odds_down]) @ mounted + TINY
                  ) / anywhere
        if expected.turning is not None:
            turned = turned * turned_about(downs, expected.turning)
    if expected.before is not None:
        before, kept = expected.before, expected.kept
        seen = kept * before.density(downs, np.radians(error_deg))
        rest = 1 - kept * min(before.unsided.sum(), 1.0)
        held = 1.0 if expected.down is not None else (mounted / PEAKS).max(axis=0) ** STEADY
        anywhere = (seen + rest * anywhere) * held
    return np.stack([anywhere * turned, np.broadcast_to(anywhere, len(downs))]) + TINY


def turned_about(downs: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Return the likelihood (N,) of the turning (3, 3) of a camera with verticals (N, 3)."""
    about = ((downs @ turning) * downs).sum(axis=1) + LITTLE_TURN_RAD**2 / 3
    return about / (np.trace(turning) + LITTLE_TURN_RAD**2)


def _grid(*axes: np.ndarray) -> np.ndarray:
    return np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing='ij')], axis=1)


def held_density(down: np.ndarray) -> float:
    """Return the prior density of a vertical (3,) of a camera that does not look down, 1/sr."""
    return float(_mounted(down[None])[:4].sum())


def _mounted(downs: np.ndarray) -> np.ndarray:
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


def log_likelihood(bases: np.ndarray, azimuths_rad: np.ndarray, evidence: Evidence,
                   error_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the tempered log likelihoods of the upright lines, and of all else, both (V, A).

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
    sharp = 1 / variance  # a division takes as long as all else in the loop over azimuths
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
