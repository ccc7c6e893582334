# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Directions over time: turned with the image, averaged, and held where an image refuses.

The camera's turn between two images is what turns the lines of one into those of the other:
segments are matched by place and direction, and the rotation of the planes through the camera and
each segment is found by reweighted least squares (Cauchy), since lines of near things move
otherwise when the camera moves too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.vanishing import AxisPair, SceneDirections

# The same line in two images: its middle moves by less, at unit focal length, and so it turns.
MATCH_DISTANCE, MATCH_SINE = 0.1, 0.1
MIN_MATCHES = 8
# derived: the plane of a segment is known to about this, half a pixel over its length.
LINE_SPREAD_RAD, ROUNDS = np.radians(0.3), 5
# Share of a new image in the average of a still camera once there are enough. tuned: python -m
# plane_detector.evaluation.benchmark orientation, flat from 0.1 to 0.3.
MIN_GAIN = 0.2
# The directions of an image are off by this much at random; the turn is wrong by this multiple of
# itself, since a camera that moves and keeps looking at the same thing turns more than its image
# does (seen: by 0.7 degrees where the lines turn by 0.3).
TURN_ERROR_RATIO, RANDOM_RAD = 3.0, np.radians(0.5)
# Directions further off than this are another answer, believed if given this often in a row.
JUMP_DEG, JUMPS_BELIEVED = 3.0, 3
# Images that refuse, after which nothing is held any more, and what each adds to the deviation.
HELD_IMAGES, HELD_SIGMA_DEG = 15, 0.2


@dataclass(frozen=True)
class TrackedDirections:
    """
    Directions up to an image.

    Attributes
    ----------
    directions : SceneDirections
        In the camera frame of that image.
    segments : LineSegments
        Of the image.
    images : int
        How many went into the average.
    held : int
        How many since then did not.

    """

    directions: SceneDirections
    segments: LineSegments
    images: int
    held: int


def track_directions(previous: TrackedDirections | None, found: SceneDirections,
                     segments: LineSegments) -> TrackedDirections:
    """
    Average the directions of an image with those before.

    Parameters
    ----------
    previous : TrackedDirections or None
        Of the image before; None: the image stands alone.
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
        before = replace(before, pairs=())  # their azimuth is not known any more
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
    """Return the rotation vector (3,) from the camera frame before to the one after, or None."""
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
        # turn x n = residual, that is -[n]x turn; the moment is the sum of w (I - n n^T).
        moment = weight.sum() * np.eye(3) - (turned.T * weight) @ turned
        turn = turn + np.linalg.solve(moment + 1e-9 * np.eye(3),
                                      weight @ np.cross(turned, residual))
    return turn


def _matches(before: LineSegments, after: LineSegments) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of segments that are each other's nearest."""
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
    """Average the axes that are the same; a pair at another azimuth stands alone."""
    cosine = found.axes[0] @ before.axes.T
    same = int(np.abs(cosine).argmax())
    if np.abs(cosine[same]) < np.cos(np.radians(JUMP_DEG)):
        return found
    first = (1 - gain) * np.sign(cosine[same]) * before.axes[same] + gain * found.axes[0]
    return replace(found, axes=np.stack([first, found.axes[1]]))


def _level(axes: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return two axes at right angles to each other and to the vertical, the first one kept."""
    first = axes[0] - (axes[0] @ down) * down
    first /= np.linalg.norm(first)
    second = np.cross(down, first)
    return np.stack([first, second if second @ axes[1] > 0 else -second])
