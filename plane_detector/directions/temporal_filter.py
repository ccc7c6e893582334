# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Temporal filter of directions: rotated with the camera, averaged, held if an image refuses.

The rotation of the camera between two images is estimated from their lines: segments are matched
by position and direction, and the rotation of the planes through the camera and each segment is
found by reweighted least squares (Cauchy), because the lines of near objects move differently
when the camera translates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plane_detector.directions.axis_pairs import AxisPair
from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.vanishing import SceneDirections

# Largest motion of a matched segment's midpoint at unit focal length, and sine of its rotation.
MATCH_DISTANCE, MATCH_SINE = 0.1, 0.1
MIN_MATCHES = 8
# derived: accuracy of the plane of a segment, half a pixel over its length.
LINE_SPREAD_RAD, ROUNDS = np.radians(0.3), 5
# Weight of a new image in the average of a static camera after the first images. tuned: python -m
# plane_detector.evaluation.benchmark orientation, flat from 0.1 to 0.3.
MIN_GAIN = 0.2
# Random error of the directions of one image, and error of the estimated rotation as a multiple of
# its size: a camera that moves while looking at the same object turns more than its image does
# (measured: by 0.7 degrees while the lines turn by 0.3).
TURN_ERROR_RATIO, RANDOM_RAD = 3.0, np.radians(0.5)
# A larger change is accepted only if it persists for this many images.
JUMP_DEG, JUMPS_BELIEVED = 3.0, 3
# Directions are held for this many refused images, each of which adds to the standard deviation.
HELD_IMAGES, HELD_SIGMA_DEG = 15, 0.2


@dataclass(frozen=True)
class TrackedDirections:
    """
    Directions averaged up to an image.

    Attributes
    ----------
    directions : SceneDirections
        In the camera frame of that image.
    segments : LineSegments
        Of the image.
    images : int
        Number of images in the average.
    held : int
        Number of images since the last one in the average.

    """

    directions: SceneDirections
    segments: LineSegments
    images: int
    held: int


def track_directions(previous: TrackedDirections | None, found: SceneDirections,
                     segments: LineSegments) -> TrackedDirections:
    """
    Average the directions of an image with the previous ones.

    Parameters
    ----------
    previous : TrackedDirections or None
        Of the previous image; None: no average.
    found : SceneDirections
        Of the image alone; may refuse.
    segments : LineSegments
        Of the image.

    """
    alone = TrackedDirections(found, segments, 1, 0)
    if previous is None or previous.directions.gravity_camera is None:
        return alone
    turn = turn_between(previous.segments, segments)
    if turn is None:
        return alone
    before = _turned(previous.directions, cv2.Rodrigues(turn)[0])
    doubt = (TURN_ERROR_RATIO * np.linalg.norm(turn) / RANDOM_RAD) ** 2
    if doubt > 1:
        before = replace(before, pairs=())  # their azimuth is no longer known
    seen = found.gravity_camera
    if seen is None or seen @ before.gravity_camera < np.cos(np.radians(JUMP_DEG)):
        most = HELD_IMAGES if seen is None else JUMPS_BELIEVED - 1
        if previous.held >= most:
            return alone
        added = np.radians(HELD_SIGMA_DEG) ** 2 * (
            np.eye(3) - np.outer(before.gravity_camera, before.gravity_camera))
        held = replace(before, covariance=before.covariance + added)
        return TrackedDirections(held, segments, previous.images, previous.held + 1)
    gain = max(MIN_GAIN, 1.0 / (previous.images + 1), doubt / (doubt + 1.0))
    return TrackedDirections(_averaged(before, found, gain), segments, previous.images + 1, 0)


def turn_between(before: LineSegments, after: LineSegments) -> np.ndarray | None:
    """Return the rotation vector (3,) from the camera frame before to that after, or None."""
    first, second = _matches(before, after)
    if len(first) < MIN_MATCHES:
        return None
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
        moment = weight.sum() * np.eye(3) - (turned.T * weight) @ turned
        turn = turn + np.linalg.solve(moment + 1e-9 * np.eye(3),
                                      weight @ np.cross(turned, residual))
    return turn


def _matches(before: LineSegments, after: LineSegments) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of segments that are mutual nearest neighbours."""
    if not len(before) or not len(after):
        return np.zeros(0, int), np.zeros(0, int)
    distance = np.linalg.norm(before.midpoints[:, None] - after.midpoints, axis=2)
    sine = np.abs(before.tangents[:, :1] * after.tangents[:, 1]
                  - before.tangents[:, 1:] * after.tangents[:, 0])
    cost = distance / MATCH_DISTANCE + sine / MATCH_SINE
    best, back = cost.argmin(1), cost.argmin(0)
    index = np.arange(len(before))
    mutual = (back[best] == index) & (cost[index, best] < 1)
    return index[mutual], best[mutual]


def _plane_normals(segments: LineSegments) -> np.ndarray:
    return segments.normals / np.linalg.norm(segments.normals, axis=1, keepdims=True)


def _turned(directions: SceneDirections, rotation: np.ndarray) -> SceneDirections:
    pairs = tuple(replace(pair, axes=pair.axes @ rotation.T) for pair in directions.pairs)
    return replace(directions, gravity_camera=rotation @ directions.gravity_camera,
                   covariance=rotation @ directions.covariance @ rotation.T, pairs=pairs)


def _averaged(before: SceneDirections, found: SceneDirections, gain: float) -> SceneDirections:
    down = (1 - gain) * before.gravity_camera + gain * found.gravity_camera
    down /= np.linalg.norm(down)
    pairs = found.pairs or before.pairs
    if found.pairs and before.pairs:
        pairs = (_averaged_pair(before.pairs[0], found.pairs[0], gain), *found.pairs[1:])
    pairs = tuple(replace(pair, axes=_level(pair.axes, down)) for pair in pairs)
    return replace(found, gravity_camera=down, pairs=pairs,
                   pair_refusal='' if pairs else found.pair_refusal)


def _averaged_pair(before: AxisPair, found: AxisPair, gain: float) -> AxisPair:
    """Average corresponding axes; a pair at another azimuth is not averaged."""
    cosine = found.axes[0] @ before.axes.T
    same = int(np.abs(cosine).argmax())
    if np.abs(cosine[same]) < np.cos(np.radians(JUMP_DEG)):
        return found
    first = (1 - gain) * np.sign(cosine[same]) * before.axes[same] + gain * found.axes[0]
    return replace(found, axes=np.stack([first, found.axes[1]]))


def _level(axes: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return two axes perpendicular to each other and to the vertical, keeping the first."""
    first = axes[0] - (axes[0] @ down) * down
    first /= np.linalg.norm(first)
    second = np.cross(down, first)
    return np.stack([first, second if second @ axes[1] > 0 else -second])
