# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The posterior of the vertical from view to view, rotated with the camera.

1. The rotation of the camera from the first image of a view is estimated from the lines of both
   images, or, where these do not match, from the previous image by lines or corner points.
2. All images of a view have the same evidence. So the prior of each is what was known before its
   view began: showing the same image again, with different noise or without, proves nothing.
3. A view ends when the camera has turned. The modes of its last image, blurred by the error of the
   rotation, are the prior of the next view. If the camera returns to an earlier view, what was
   known before that view remains the prior: swinging between two views proves nothing either.
4. Which side of the image is down is decided from all views together, as one observation: what
   misleads in one image of a room misleads in all. The same holds for the axis about which the
   camera turns.
5. After a cut, or where nothing matches, nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.prior import Expected, Modes
from plane_detector.directions.surfaces import Sides
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.geometry.rigid_transform import cross
from plane_detector.types import CameraIntrinsics

# A view ends when the camera has turned by this. chosen: a tenth of a usual field of view, the
# error of lines and normals differs; smaller views count one error of the network several times.
VIEW_RAD = np.radians(6.0)
# Largest motion of a matched segment's midpoint at unit focal length, and sine of its rotation.
# chosen: 50 pixels of 525, and 6 degrees, beyond the motion of a hand within a tenth of a second.
MATCH_DISTANCE, MATCH_SINE = 0.1, 0.1
MIN_MATCHES = 8
# derived: accuracy of the plane of a segment, half a pixel over its length.
LINE_SPREAD_RAD, ROUNDS = np.radians(0.3), 5
# Share of the line length that follows one rotation, at least. measured: .52 to .73 at 30
# images/s, at most .08 between views of other parts of a room.
LEAST_SHARE, MOST_SPREADS = 0.2, 3.0
# Corner points (ORB) of the reduced image: their number, their largest distance in bits, the
# spread of their rays about a rotation, and the share and number of matches that follow one.
# measured: of 3 images/s of a walk .93 to 1 of 117 to 190 matches.
POINTS, MOST_BITS, POINT_SPREAD_RAD = 300, 50, 0.02
LEAST_FOLLOWING, MIN_POINTS, HYPOTHESES = 0.5, 30, 24
# Error of the estimated rotation, as a share of it and of a still camera: a camera that moves
# while it looks at the same object turns more than its image does. measured: medians .3 of .5
# degrees, .5 of .8, 1.6 of 4.
TURN_ERROR_RATIO, STILL_RAD = 0.4, np.radians(0.2)
# Error of a mode from one view to the next. chosen: of the verticals that are the same. The main
# mode is known better than others, and would lose against them where views disagree by a few
# degrees.
CLOSE_RAD = np.radians(2.5)
# Probability that what was known before a view still holds. chosen: a wrong start is forgotten.
REMEMBERED = 0.9
# The last views, to which a camera may come back. chosen: what they showed is half forgotten.
MOST_VIEWS = 6
# The azimuth is no longer known after a rotation with a larger error. chosen: that of its axes.
LARGEST_PAIR_ERROR_RAD = np.radians(5.0)


@dataclass(frozen=True)
class ImagePoints:
    """Corner points of an image, found when they are needed."""

    grey: np.ndarray  # (h, w) uint8: reduced
    intrinsics: CameraIntrinsics  # of the image

    @cached_property
    def found(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return rays (N, 3), float64 unit vectors, and descriptors (N, 32) uint8."""
        corners, descriptors = cv2.ORB_create(
            POINTS, nlevels=4, edgeThreshold=15, patchSize=25, fastThreshold=10
        ).detectAndCompute(self.grey, None)
        camera, (height, width) = self.intrinsics, self.grey.shape
        places = np.array([corner.pt for corner in corners]).reshape(-1, 2) + 0.5
        places = places * [camera.width / width, camera.height / height] - 0.5
        rays = np.column_stack([(places - [camera.cx, camera.cy]) / [camera.fx, camera.fy],
                                np.ones(len(places))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True), descriptors


@dataclass(frozen=True)
class View:
    """The view that an image belongs to."""

    segments: LineSegments  # of its first image
    rotation: np.ndarray  # (3, 3) float64: from the camera of that image to this one
    modes: Modes | None = None  # known before it, in the frame of its first image
    sides: Sides | None = None  # seen before it
    rolled_rad: float = 0.0  # about the optical axis, since these sides were observed
    # (3, 3) float64: of the views before, as ``Expected.turning``, in the frame of its first image
    turning: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    # (N, 3, 3) float64: from the first images of the views before to that of this one
    earlier: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def is_known(self) -> bool:
        """Whether the camera has come back to one of the views before."""
        cosines = (np.trace(self.earlier, axis1=1, axis2=2) - 1) / 2
        return bool((cosines > np.cos(VIEW_RAD)).any())


@dataclass(frozen=True)
class Step:
    """An image of a stream, for the next one."""

    segments: LineSegments
    points: ImagePoints | None
    directions: SceneDirections
    view: View
    sides: Sides | None  # of its view and all before


def first_view(segments: LineSegments) -> View:
    """Return the view of an image before which nothing is known."""
    return View(segments, np.eye(3))


def carried(expected: Expected, last: Step, segments: LineSegments,
            points: ImagePoints | None) -> tuple[Expected, View]:
    """
    Return the expectation for an image after another one, and its view.

    Parameters
    ----------
    expected : Expected
        Without the previous images.
    last : Step
        The previous image.
    segments : LineSegments
    points : ImagePoints, optional

    """
    view = last.view
    turn, share = turn_between_images(view.segments, segments)
    if share < LEAST_SHARE:
        step, share = turn_between_images(last.segments, segments)
        if share < LEAST_SHARE and points is not None and last.points is not None:
            step, share = turn_between_points(last.points, points)
        if share < LEAST_SHARE:
            return expected, first_view(segments)
        rotation = cv2.Rodrigues(step)[0] @ view.rotation
        turn = cv2.Rodrigues(rotation)[0][:, 0]
    # For a stationary camera, the measured rotation is noise.
    square = float(turn @ turn)
    turn = turn * (square / (square + STILL_RAD**2))
    view = replace(view, rotation=cv2.Rodrigues(turn)[0])
    step = view.rotation @ last.view.rotation.T
    step_error_rad = _turn_error_rad(cv2.Rodrigues(step)[0])
    before, pairs = last.directions.modes, last.directions.pairs
    if np.linalg.norm(turn) > VIEW_RAD:
        rolled_rad = view.rolled_rad + float(np.arctan2(view.rotation[1, 0], view.rotation[0, 0]))
        sides, known = last.sides, _turned(
            before, step, float(np.hypot(step_error_rad, CLOSE_RAD)))
        if view.is_known:
            sides, known = view.sides, _turned(
                view.modes, view.rotation, float(np.hypot(_turn_error_rad(turn), CLOSE_RAD)))
        earlier = view.rotation @ np.concatenate([view.earlier, np.eye(3)[None]])[-MOST_VIEWS:]
        turning = view.rotation @ view.turning @ view.rotation.T
        view = View(segments, np.eye(3), known, sides, rolled_rad, turning, earlier)
        if not view.is_known:
            view = replace(view, turning=turning + np.outer(turn, turn))
        if abs(rolled_rad) > np.pi / 4:
            view = replace(view, sides=None, rolled_rad=0.0)
    is_level = last.directions.gravity_camera is not None
    has_pair = is_level and len(pairs) and step_error_rad < LARGEST_PAIR_ERROR_RAD
    return replace(
        expected,
        before=view.modes and _turned(view.modes, view.rotation, _turn_error_rad(turn)),
        kept=REMEMBERED, last=_turned(before, step, step_error_rad),
        pair=pairs[0] @ step.T if has_pair else None, pair_rad=step_error_rad,
        turning=view.rotation @ view.turning @ view.rotation.T), view


def _turn_error_rad(turn: np.ndarray) -> float:
    return float(np.hypot(TURN_ERROR_RATIO * np.linalg.norm(turn), STILL_RAD))


def _turned(modes: Modes, rotation: np.ndarray, error_rad: float) -> Modes:
    return replace(
        modes, downs=modes.downs @ rotation.T,
        covariances=rotation @ modes.covariances @ rotation.T + error_rad**2 * np.eye(3))


def turn_between_images(before: LineSegments, after: LineSegments) -> tuple[np.ndarray, float]:
    """
    Return the rotation vector (3,) from the camera frame before to that after, and its support.

    The support is the share of the line length that follows this rotation; 0 if unknown.
    """
    first, second = _matches(before, after)
    if len(first) < MIN_MATCHES:
        return np.zeros(3), 0.0
    planes_before, planes_after = (_plane_normals(segments)[index] for segments, index in (
        (before, first), (after, second)))
    planes_after = planes_after * np.sign((planes_before * planes_after).sum(1))[:, None]
    turn = np.zeros(3)
    lengths = np.minimum(before.lengths[first], after.lengths[second])
    for _ in range(ROUNDS):
        turned = planes_before @ cv2.Rodrigues(turn)[0].T
        residual = planes_after - turned
        weight = lengths / (1 + (residual**2).sum(1) / LINE_SPREAD_RAD**2)
        # turn x n = residual, i.e. -[n]x turn; the moment is the sum of w (I - n n^T).
        moment = (weight.sum() + 1e-9) * np.eye(3) - (turned.T * weight) @ turned
        turn = turn + cv2.solve(moment, (weight @ cross(turned, residual))[:, None])[1][:, 0]
    follows = np.linalg.norm(residual, axis=1) < MOST_SPREADS * LINE_SPREAD_RAD
    return turn, lengths[follows].sum() / min(before.lengths.sum(), after.lengths.sum())


def _matches(before: LineSegments, after: LineSegments) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of segments that are mutual nearest neighbours."""
    if not len(before) or not len(after):
        return np.zeros(0, int), np.zeros(0, int)
    x, y = (before.midpoints[:, None, axis] - after.midpoints[:, axis] for axis in (0, 1))
    sine = np.abs(before.tangents[:, :1] * after.tangents[:, 1]
                  - before.tangents[:, 1:] * after.tangents[:, 0])
    cost = np.sqrt(x * x + y * y) / MATCH_DISTANCE + sine / MATCH_SINE
    best, back = cost.argmin(1), cost.argmin(0)
    index = np.arange(len(before))
    mutual = (back[best] == index) & (cost[index, best] < 1)
    return index[mutual], best[mutual]


def _plane_normals(segments: LineSegments) -> np.ndarray:
    return segments.normals / np.linalg.norm(segments.normals, axis=1, keepdims=True)


def turn_between_points(before: ImagePoints, after: ImagePoints) -> tuple[np.ndarray, float]:
    """
    Return the rotation vector (3,) from the camera frame before to that after, and its support.

    The support is the share of the matched points that follow this rotation; 0 if unknown. It is
    the best rotation of two matches, refitted to all by reweighted least squares.
    """
    (rays_before, first), (rays_after, second) = before.found, after.found
    if first is None or second is None:
        return np.zeros(3), 0.0
    first, second, bits = _close_descriptors(first, second)
    if len(bits) < MIN_POINTS:
        return np.zeros(3), 0.0
    rays_before, rays_after = rays_before[first], rays_after[second]
    # The best matches come in the order of the points; pairs far apart in it are so in the image.
    order = np.argsort(bits, kind='stable')[:2 * HYPOTHESES]
    one, other = order[:len(order) // 2], order[::-1][:len(order) // 2]
    rotations = _from_pairs(rays_after[one], rays_after[other]) @ _from_pairs(
        rays_before[one], rays_before[other]).transpose(0, 2, 1)
    off = np.linalg.norm(rays_before @ rotations.transpose(0, 2, 1) - rays_after, axis=2)
    rotation = rotations[(1 / (1 + (off / POINT_SPREAD_RAD) ** 2)).sum(axis=1).argmax()]
    for _ in range(ROUNDS):
        turned = rays_before @ rotation.T
        residual = rays_after - turned
        weight = 1 / (1 + (residual**2).sum(1) / POINT_SPREAD_RAD**2)
        moment = (weight.sum() + 1e-9) * np.eye(3) - (turned.T * weight) @ turned
        turn = cv2.solve(moment, (weight @ cross(turned, residual))[:, None])[1]
        rotation = cv2.Rodrigues(turn)[0] @ rotation
    follows = (np.linalg.norm(residual, axis=1) < MOST_SPREADS * POINT_SPREAD_RAD).mean()
    return cv2.Rodrigues(rotation)[0][:, 0], float(follows) * (follows > LEAST_FOLLOWING)


def _close_descriptors(first: np.ndarray,
                       second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the descriptors that are mutual nearest neighbours, and the bits that differ."""
    # A product of bits as -1 and 1 counts the equal ones, in half the time of OpenCV's matcher.
    signs = [2 * np.unpackbits(one, axis=1).astype(np.float32) - 1 for one in (first, second)]
    bits = (signs[0].shape[1] - signs[0] @ signs[1].T) / 2
    best, back = bits.argmin(axis=1), bits.argmin(axis=0)
    found = np.flatnonzero((back[best] == np.arange(len(best)))
                           & (bits.min(axis=1) < MOST_BITS))
    return found, best[found], bits[found, best[found]]


def _from_pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return orthonormal columns (N, 3, 3), the first along rays (N, 3), by second ones (N, 3)."""
    normal = cross(first, second) + 1e-12
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([first, normal, cross(first, normal)], axis=2)
