# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Lines and directions of consecutive images."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from functools import partial

import numpy as np

from plane_detector.config import Config
from plane_detector.directions.gravity_choice import LIKELY_SIGMAS, Gravity, choose_gravity
from plane_detector.directions.line_segments import LineSegments, detect_line_segments
from plane_detector.directions.posterior import Expected, collect_evidence, surface_normals
from plane_detector.directions.temporal_filter import carried
from plane_detector.directions.vanishing import SceneDirections, find_directions
from plane_detector.types import CameraIntrinsics


@dataclass(frozen=True)
class ImageDirections:
    """Lines of an image and the directions estimated from them."""

    segments: LineSegments
    directions: SceneDirections  # of this image and those before it

    @property
    def axes(self) -> np.ndarray:
        """Directions (A, 3): gravity, then the horizontal axes; (0, 3) if refused."""
        if self.directions.gravity_camera is None:
            return np.zeros((0, 3))
        return np.vstack([self.directions.gravity_camera[None],
                          *self.directions.pairs[:1]])

    @property
    def all_axes(self) -> np.ndarray:
        """As ``axes``, with all pairs of horizontal axes about the vertical."""
        return np.vstack([self.axes, *self.directions.pairs[1:]])


@dataclass(frozen=True)
class CameraImage:
    """An image and what is known of its pixels."""

    rgb: np.ndarray  # (H, W, 3) uint8: rectified
    intrinsics: CameraIntrinsics  # of that image
    # (H, W) bool or None: pixels that the image covers after rectification; None: all
    covered: np.ndarray | None = None
    # (H, W) float32 or None: 1/z without a shift; NaN invalid. Its normals are evidence for the
    # vertical
    disparity: np.ndarray | None = None


def find_in_image(image: CameraImage, expected: Expected | None = None,
                  before: ImageDirections | None = None) -> ImageDirections:
    """
    Find the lines of an image and the directions common to them.

    Parameters
    ----------
    image : CameraImage
    expected : Expected, optional
        Default: a camera held upright.
    before : ImageDirections, optional
        Of the image before.

    """
    expected = expected or Expected()
    segments = detect_line_segments(image.rgb, image.intrinsics, image.covered)
    surface = (None if image.disparity is None
               else surface_normals(image.disparity, image.intrinsics))
    if before is not None:
        expected = carried(expected, before.directions, before.segments, segments)
    return ImageDirections(segments, find_directions(
        segments, collect_evidence(segments, surface), expected))


class Need(Enum):
    """What the lines of an image are needed for."""

    PLANES = auto()
    """For the planes; found in every image, even if gravity is known."""
    GRAVITY = auto()
    """Only for gravity, if it is not known otherwise."""


@dataclass(frozen=True)
class Surroundings:
    """Known directions in the frame of the camera."""

    gravity: Gravity  # from a sensor, a parameter or the image
    lines: ImageDirections | None  # of the image; None if they were not needed
    seconds: float = 0.0  # time that finding them took

    @property
    def level_axes(self) -> np.ndarray:
        """Horizontal axes (A, 3) of the scene, from the image."""
        return self.lines.axes[1:] if self.lines else np.zeros((0, 3))


class DirectionFinder:
    """Finds the directions of each image, with the posterior of the images before."""

    def __init__(self) -> None:
        self._lines: ImageDirections | None = None

    def look(self, image: CameraImage, measured_down: np.ndarray | None, config: Config,
             need: Need = Need.GRAVITY, may_hold: bool = False) -> Surroundings:
        """
        Determine gravity, and find the lines of the image if they are needed.

        Parameters
        ----------
        image : CameraImage
        measured_down : (3,) floating or None
            Direction of gravity from a sensor.
        config : Config
            Its ``scale`` and ``directions`` are used.
        need : Need
            What the lines are needed for.
        may_hold : bool
            The lines found last are accurate enough for this image.

        """
        choose = partial(choose_gravity, measured_down, config.scale.gravity,
                         config.scale.gravity_tolerance)
        known = choose(None)
        if need != Need.PLANES and (known.is_sure or not config.directions.gravity):
            return Surroundings(known, None)
        if self._lines is None or not may_hold:
            expected = Expected() if known.gravity_camera is None else Expected(
                known.gravity_camera, known.tolerance_deg / LIKELY_SIGMAS)
            self._lines = find_in_image(image, expected, self._lines)
        return Surroundings(choose(self._lines.directions) if config.directions.gravity
                            else known, self._lines)

    def reset(self) -> None:
        """Discard what is kept from earlier images."""
        self._lines = None
