# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Lines and directions of consecutive images."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from plane_detector.config import Config
from plane_detector.directions.line_segments import (
    LineSegments,
    detect_line_segments,
    reduced_grey,
)
from plane_detector.directions.photograph import NO_SCORE, score_of_sides
from plane_detector.directions.posterior import collect_evidence
from plane_detector.directions.prior import TAKEN_AS_UPRIGHT, Expected
from plane_detector.directions.surfaces import (
    log_odds_down,
    sides_of,
    surface_normals,
    usual_inverse_depth,
)
from plane_detector.directions.temporal_filter import ImagePoints, Step, carried, first_view
from plane_detector.directions.vanishing import (
    NO_PAIRS,
    SYSTEMATIC_DEG,
    SceneDirections,
    find_directions,
)
from plane_detector.geometry.gravity import unit_direction
from plane_detector.types import COARSE_DEG, CameraIntrinsics, Gravity, PlaneSegmentation

# While planes show that a camera does not turn, the lines are kept for this many times longer, and
# for twice as long each time that they are found again, up to 2 s.
STEADY_TIMES, MOST_STEADY_TIMES = 5, 20
# chosen: a tenth of the tolerated error of gravity from an image. With noise of .001, .002 and
# .004 per metre on real images, 100, 92 and 82 % of the frames of a still camera are within it.
TURNED_RAD = math.radians(0.5)
# Of a plane whose normal counts, and between two of them: a plane does not show rotations about
# its normal.
LARGE_SHARE, APART_RAD = 0.02, math.radians(20)
# Largest likely error of gravity from lines, in standard deviations.
LIKELY_SIGMAS = 2.0
# After a jump of the camera or a cut, half of 1/z differs by more than this share from the
# previous image; every eighth pixel is compared. measured: the median difference is .002 for a
# stationary sensor, .004 to .010 for a handheld one at 30 images/s, .05 to .15 at 1.5 images/s.
JUMP_SHARE, THINNED = 0.04, 8
# Error of a guessed focal length, as a share of it. derived: a horizontal field of view of 60 to
# 75 degrees, taken as 67.
GUESSED_FOCAL = 0.15
# Weight of the evidence of a network on the sides of the image. measured: fastdepth, which was
# trained on upright images, also finds floors at the bottom of turned images: in 58 of 60 images
# of a walk turned by 90 degrees, upright in 49. With .3 more is answered (rooms turned by 90
# degrees 0 to 17 % more, all wrong; upright 4 to 60 % more).
NETWORK_SIDES = 0.0


@dataclass(frozen=True)
class ImageDirections:
    """Lines of an image and the directions estimated from them."""

    segments: LineSegments
    directions: SceneDirections  # of this image and the previous ones
    step: Step | None = None  # for the next image

    @property
    def axes(self) -> np.ndarray:
        """Directions (A, 3): the main axis, then the pair across it; (0, 3) if refused."""
        if self.directions.main_axis is None:
            return np.zeros((0, 3))
        return np.vstack([self.directions.main_axis[None], *self.directions.pairs[:1]])

    @property
    def all_axes(self) -> np.ndarray:
        """As ``axes``, with all pairs of axes about the main one."""
        return np.vstack([self.axes, *self.directions.pairs[1:]])


@dataclass(frozen=True)
class CameraImage:
    """An image and what is known about its pixels."""

    rgb: np.ndarray  # (H, W, 3) uint8: rectified
    intrinsics: CameraIntrinsics  # of that image
    # (H, W) bool or None: pixels that the image covers after rectification; None: all
    covered: np.ndarray | None = None
    # (H, W) float32 or None: affine in 1/z; NaN invalid. Its trend is evidence for the vertical
    disparity: np.ndarray | None = None
    has_shift: bool = False  # of the disparity; without one, its normals are evidence too
    stamp_s: float = float('nan')  # time of the image; NaN: unknown
    is_measured: bool = False  # the disparity, not a network's
    is_lens_guessed: bool = False  # the focal length of the intrinsics is a guess
    is_still: bool = False  # nothing has moved since the previous image, as far as is known


def find_in_image(image: CameraImage, expected: Expected | None = None,
                  before: ImageDirections | None = None,
                  mounting: str = 'any') -> ImageDirections:
    """
    Find the lines of an image and the directions common to them.

    Parameters
    ----------
    image : CameraImage
    expected : Expected, optional
        Default: a camera held upright.
    before : ImageDirections, optional
        Of the previous image.
    mounting : str
        As ``directions.mounting``.

    """
    expected = expected or Expected()
    grey = reduced_grey(image.rgb)
    segments = detect_line_segments(grey, image.intrinsics, image.covered)
    points, view = ImagePoints(grey, image.intrinsics), first_view(segments)
    if before is not None and before.step is not None:
        expected, view = carried(expected, before.step, segments, points)
    surface, sides, by_sides = None, view.sides, ()
    if image.disparity is not None:
        inverse = usual_inverse_depth(image.disparity) if image.has_shift else image.disparity
        surface, is_step = surface_normals(inverse, image.intrinsics)
        is_open = mounting == 'any' and expected.down is None
        sides = sides_of(surface[~is_step],
                         log_odds_down(image.disparity, surface, image.has_shift),
                         score_of_sides(image.rgb, grey, segments) if is_open else NO_SCORE)
        if view.sides is not None:
            sides = view.sides.with_view(sides)
        by_sides = (sides.log_odds_down,
                    (1.0 if image.is_measured else NETWORK_SIDES) * sides.log_likelihood
                    + sides.log_likelihood_by_picture)
    if mounting == 'upright':
        by_sides = (-math.inf, TAKEN_AS_UPRIGHT)
    evidence = collect_evidence(segments, None if image.has_shift else surface, *by_sides,
                                focal_error=GUESSED_FOCAL if image.is_lens_guessed else 0.0)
    directions = find_directions(segments, evidence, expected)
    return ImageDirections(segments, directions, Step(segments, points, directions, view, sides))


@dataclass(frozen=True)
class Surroundings:
    """Known directions in the frame of the camera."""

    gravity: Gravity  # from a sensor, a parameter or the image
    lines: ImageDirections | None  # of the image; None if they were not needed

    @property
    def level_axes(self) -> np.ndarray:
        """Horizontal axes (A, 3) of the scene, from the image."""
        if self.lines is None or self.lines.directions.gravity_camera is None:
            return np.zeros((0, 3))
        return self.lines.axes[1:]

    @property
    def open_axes(self) -> np.ndarray:
        """Axes (A, 3) of the scene, from the image, any of which may be the vertical."""
        if self.lines is None or self.lines.directions.open_axis is None:
            return np.zeros((0, 3))
        return self.lines.axes


def choose_gravity(measured: np.ndarray | None, given: tuple[float, ...], tolerance_deg: float,
                   directions: SceneDirections | None, measured_by: str = 'measured') -> Gravity:
    """
    Return the first available of measured, given and image direction.

    Parameters
    ----------
    measured : (3,) floating, optional
        From an accelerometer or a calibrated mounting.
    given : (3,) float
        The parameter ``scale.gravity``; 0 0 0 means unknown.
    tolerance_deg : float
        Of both. A coarse direction is replaced by a direction from the image that agrees with it.
    directions : SceneDirections, optional
        Of the image, if they were estimated.
    measured_by : str
        Name of the source of the measured direction.

    """
    down = unit_direction(given if measured is None else measured)
    source = 'parameter' if measured is None else measured_by
    seen = None if directions is None else directions.gravity_camera
    if down is not None and (tolerance_deg <= COARSE_DEG or seen is None
                             or seen @ down < np.cos(np.radians(tolerance_deg))):
        return Gravity(down, tolerance_deg, source)
    if seen is None:
        return Gravity(None, tolerance_deg, 'none', directions.refusal if directions else '')
    sigma_deg = np.degrees(np.sqrt(np.trace(directions.covariance) / 2))
    return Gravity(seen, LIKELY_SIGMAS * float(sigma_deg), 'image',
                   probability=directions.probability)


class DirectionFinder:
    """
    Finds the directions of each image, with the posterior of the previous images.

    The last lines are kept while nothing moves: if planes show that the camera does not turn, they
    are needed again only after up to two seconds. Images come in order, each followed by its
    planes.
    """

    def __init__(self) -> None:
        self._lines: ImageDirections | None = None
        self._found_s = float('nan')
        self._stamp_s = float('nan')
        self._is_held = False
        self._thinned = np.zeros((0, 0))  # disparity of the previous image
        self._normals: dict[int, list[float]] = {}  # by label, when the lines were found
        self._hold_times = 1

    def find(self, image: CameraImage, measured_down: np.ndarray | None, config: Config,
             measured_by: str = 'measured', *, for_planes: bool = False) -> Surroundings:
        """
        Determine gravity, and find the lines of the image if they are needed.

        Parameters
        ----------
        image : CameraImage
        measured_down : (3,) floating or None
            Direction of gravity from a sensor.
        config : Config
            Its ``scale`` and ``directions`` are used.
        measured_by : str
            Name of that sensor.
        for_planes : bool
            The lines are needed for the planes, even if gravity is known.

        """
        choose = partial(choose_gravity, measured_down, config.scale.gravity,
                         config.scale.gravity_tolerance, measured_by=measured_by)
        hold_s = config.directions.hold_time * self._hold_times
        before, self._thinned = self._thinned, _thinned(image)
        self._is_held = (image.is_still and 0 < image.stamp_s - self._found_s < hold_s
                         and not _has_jumped(before, self._thinned))
        self._stamp_s = image.stamp_s
        known = choose(None)
        if not for_planes and (known.is_sure or not config.directions.gravity):
            # Once gravity is no longer measured, these lines and planes are of another time.
            self._lines, self._found_s, self._hold_times = None, float('nan'), 1
            return Surroundings(known, None)
        if self._lines is None or not self._is_held:
            expected = Expected() if known.gravity_camera is None else Expected(
                known.gravity_camera, known.tolerance_deg / LIKELY_SIGMAS)
            self._lines = find_in_image(image, expected, self._lines,
                                        config.directions.mounting)
        return Surroundings(choose(self._lines.directions) if config.directions.gravity
                            else known, _with_vertical(self._lines, known))

    def note_planes(self, found: PlaneSegmentation, is_trusted: bool) -> None:
        """
        Note the planes of the image, which show whether the camera turns.

        They are not trusted with a network's depth, or without a direction of gravity.
        """
        if self._lines is None:
            return
        planes, is_large = found.planes, found.planes.counts >= LARGE_SHARE * found.labels.size
        normals = dict(zip(planes.labels[is_large].tolist(), planes.normals[is_large].tolist(),
                           strict=True))
        if not self._is_held:
            longer = 1 if _has_turned(self._normals, normals) else 2 * self._hold_times
            self._hold_times = min(max(longer, STEADY_TIMES), MOST_STEADY_TIMES)
            self._found_s, self._normals = self._stamp_s, normals
        if not is_trusted or _has_turned(self._normals, normals):
            self._hold_times = 1


def _with_vertical(lines: ImageDirections, known: Gravity) -> ImageDirections:
    """Return lines about a known vertical, if they leave open which one theirs is."""
    if lines.directions.gravity_camera is not None or not known.is_sure:
        return lines
    down = known.gravity_camera
    error_rad = np.radians(max(known.tolerance_deg / LIKELY_SIGMAS, SYSTEMATIC_DEG))
    return replace(lines, directions=replace(
        lines.directions, gravity_camera=down, probability=1.0, pairs=NO_PAIRS, open_axis=None,
        covariance=error_rad**2 * (np.eye(3) - np.outer(down, down))))


def _thinned(image: CameraImage) -> np.ndarray:
    if image.disparity is None:
        return np.zeros((0, 0))
    return image.disparity[::THINNED, ::THINNED].copy()


def _has_jumped(before: np.ndarray, after: np.ndarray) -> bool:
    """Return whether most of the disparity (h, w) differs from that of the image before."""
    if before.shape != after.shape:
        return True
    known = np.isfinite(before) & np.isfinite(after)
    differs = np.abs(after[known] - before[known]) > JUMP_SHARE * np.abs(before[known])
    return 2 * np.count_nonzero(differs) > known.sum()


def _has_turned(before: dict[int, list[float]], after: dict[int, list[float]]) -> bool:
    """Return False if two planes have the same normals as before: then no turn is possible."""
    same = np.array([normal for label, normal in before.items() if label in after
                     and math.dist(after[label], normal) < TURNED_RAD])
    return not same.size or bool((abs(same @ same.T) > math.cos(APART_RAD)).all())
