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

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.frames import turn_by_solution
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
        places = np.reshape(cv2.KeyPoint.convert(corners), (-1, 2)).astype(float) + 0.5
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
    match = _matches(before.midpoints, before.tangents, after.midpoints, after.tangents)
    first = np.flatnonzero(match >= 0)
    if len(first) < MIN_MATCHES:
        return np.zeros(3), 0.0
    second = match[first]
    planes_before, planes_after = before.unit_normals[first], after.unit_normals[second]
    planes_after *= np.sign((planes_before * planes_after).sum(1))[:, None]
    lengths = np.minimum(before.lengths[first], after.lengths[second])
    rotation, off = _refitted(planes_before, planes_after, lengths, LINE_SPREAD_RAD, np.eye(3))
    follows = off < MOST_SPREADS * LINE_SPREAD_RAD
    return (cv2.Rodrigues(rotation)[0][:, 0],
            lengths[follows].sum() / min(before.lengths.sum(), after.lengths.sum()))


@kernel('int64[::1](float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])',
        is_short=True)
def _matches(midpoints, tangents, other_midpoints, other_tangents):
    """Return the index (N,) of the mutual nearest neighbour of each segment, -1 if none."""
    count = len(other_midpoints)
    others = np.empty((4, count))
    x, y, along_x, along_y = others[0], others[1], others[2], others[3]
    for j in range(count):
        x[j], y[j] = other_midpoints[j, 0], other_midpoints[j, 1]
        along_x[j], along_y[j] = other_tangents[j, 0], other_tangents[j, 1]
    best, back = np.full(len(midpoints), -1), np.full(count, -1)
    cost, least_back = np.empty(count), np.ones(count)
    for i in range(len(midpoints)):
        for j in range(count):
            far_x, far_y = x[j] - midpoints[i, 0], y[j] - midpoints[i, 1]
            sine = tangents[i, 0] * along_y[j] - tangents[i, 1] * along_x[j]
            cost[j] = (np.sqrt(far_x * far_x + far_y * far_y) / MATCH_DISTANCE
                       + abs(sine) / MATCH_SINE)
        least = 1.0
        for j in range(count):
            if cost[j] < least:
                least, best[i] = cost[j], j
            if cost[j] < least_back[j]:
                least_back[j], back[j] = cost[j], i
    for i in range(len(best)):
        if best[i] >= 0 and back[best[i]] != i:
            best[i] = -1
    return best


@kernel('Tuple((float64[:, ::1], float64[::1]))(float64[:, ::1], float64[:, ::1], float64[::1], '
        'float64, float64[:, ::1])', is_short=True)
def _refitted(before, after, weights, spread, start):
    """
    Return the rotation (3, 3) of vectors before to those after, and by how much each is off.

    It is found by least squares, with weights that fall with the deviation over its spread; the
    deviations (N,) are those of the last weights.
    """
    columns, off = start.T.copy(), np.empty(len(before))
    moment, right = np.empty((3, 3)), np.empty(3)
    for _ in range(ROUNDS):
        moment[:], right[:] = 0.0, 0.0
        for i in range(len(before)):
            b = before[i]
            x = b[0] * columns[0, 0] + b[1] * columns[1, 0] + b[2] * columns[2, 0]
            y = b[0] * columns[0, 1] + b[1] * columns[1, 1] + b[2] * columns[2, 1]
            z = b[0] * columns[0, 2] + b[1] * columns[1, 2] + b[2] * columns[2, 2]
            dx, dy, dz = after[i, 0] - x, after[i, 1] - y, after[i, 2] - z
            square = dx * dx + dy * dy + dz * dz
            off[i], weight = np.sqrt(square), weights[i] / (1 + square / (spread * spread))
            # turn x n = (dx, dy, dz), i.e. -[n]x turn; the moment is the sum of w (I - n n^T).
            moment[0, 0] += weight * (1 - x * x)
            moment[1, 1] += weight * (1 - y * y)
            moment[2, 2] += weight * (1 - z * z)
            moment[0, 1] -= weight * x * y
            moment[0, 2] -= weight * x * z
            moment[1, 2] -= weight * y * z
            right[0] += weight * (y * dz - z * dy)
            right[1] += weight * (z * dx - x * dz)
            right[2] += weight * (x * dy - y * dx)
        for k in range(3):
            moment[k, k] += 1e-9
            for j in range(k):
                moment[k, j] = moment[j, k]
        turn_by_solution(columns, moment, right)
    return columns.T.copy(), off


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
    off = rays_before @ rotations.transpose(0, 2, 1) - rays_after
    squares = np.einsum('hnk,hnk->hn', off, off)
    rotation = rotations[(1 / (1 + squares / POINT_SPREAD_RAD**2)).sum(axis=1).argmax()]
    rotation, off = _refitted(rays_before, rays_after, np.ones(len(rays_before)),
                              POINT_SPREAD_RAD, rotation)
    follows = (off < MOST_SPREADS * POINT_SPREAD_RAD).mean()
    return cv2.Rodrigues(rotation)[0][:, 0], float(follows) * (follows > LEAST_FOLLOWING)


def _close_descriptors(first: np.ndarray,
                       second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the descriptors that are mutual nearest neighbours, and the bits that differ."""
    best, bits = _closest(first.view(np.uint64), np.ascontiguousarray(second.view(np.uint64).T))
    found = np.flatnonzero(best >= 0)
    return found, best[found], bits[found]


@kernel('Tuple((int64[::1], int64[::1]))(uint64[:, ::1], uint64[:, ::1])', is_short=True)
def _closest(first, second):
    """
    Return the mutual nearest neighbours (N,) of descriptors, -1 if none, and the bits that differ.

    The first ones are (N, 4), the others (4, M).
    """
    count = second.shape[1]
    best, least = np.full(len(first), -1), np.full(len(first), MOST_BITS)
    back, least_back = np.full(count, -1), np.full(count, 64 * len(second))
    bits = np.empty(count, np.int64)
    for i in range(len(first)):
        bits[:] = 0
        for k in range(len(second)):
            word = first[i, k]
            for j in range(count):
                bits[j] += _bit_count(word ^ second[k, j])
        for j in range(count):
            if bits[j] < least[i]:
                least[i], best[i] = bits[j], j
            if bits[j] < least_back[j]:
                least_back[j], back[j] = bits[j], i
    for i in range(len(first)):
        if best[i] >= 0 and back[best[i]] != i:
            best[i] = -1
    return best, least


@kernel('int64(uint64)')
def _bit_count(x):
    """Return the number of bits that are set, an instruction of most processors."""
    x -= (x >> np.uint64(1)) & np.uint64(0x5555555555555555)
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0f0f0f0f0f0f0f0f)
    return np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


def _from_pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return orthonormal columns (N, 3, 3), the first along rays (N, 3), by second ones (N, 3)."""
    normal = cross(first, second) + 1e-12
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([first, normal, cross(first, normal)], axis=2)
