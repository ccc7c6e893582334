# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The posterior of the vertical from image to image: turned with the camera and blurred.

The rotation of the camera between two images is estimated from their lines: segments are matched
by position and direction, and the rotation of the planes through the camera and each segment is
found by reweighted least squares (Cauchy), because the lines of near objects move differently
when the camera translates.

Images of one view have the same evidence: it is averaged. What is new in an image is added. So the
logarithms of the posterior before and of the evidence are weighted: for the same view with weights
that sum to 1, the first one smaller if the turn has blurred it, for a new view with nearly 1 each,
so that a wrong start is forgotten.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.posterior import Expected
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.geometry.rigid_transform import cross

# Largest motion of a matched segment's midpoint at unit focal length, and sine of its rotation.
# chosen: 50 pixels of 525, and 6 degrees, beyond the motion of a hand within a tenth of a second.
MATCH_DISTANCE, MATCH_SINE = 0.1, 0.1
MIN_MATCHES = 8
# derived: accuracy of the plane of a segment, half a pixel over its length.
LINE_SPREAD_RAD, ROUNDS = np.radians(0.3), 5
# Error of the estimated rotation as a multiple of its size: a camera that moves while looking at
# the same object turns more than its image does (measured: by 0.7 degrees while the lines turn by
# 0.3). Without a match the camera has turned by any angle of this size.
TURN_ERROR_RATIO, STILL_RAD, UNKNOWN_TURN_RAD = 3.0, np.radians(0.2), np.radians(10.0)
# Share of the line length that follows the rotation of a camera that does not move, and the least
# share that determines a rotation. measured: .65 to .91 with noise of 5 grey levels, .52 to .64
# at 30 images/s, .38 to .56 at half of that, at most .08 between views of other parts of a room.
STILL_SHARE, LEAST_SHARE, MOST_SPREADS = 0.65, 0.2, 3.0
# Blur at which the posterior before is worth half. chosen: of the verticals that are the same.
CLOSE_RAD = np.radians(2.5)
# Weight of the evidence of one more image of a view. tuned: 22 images with a probability below
# 0.995, each 12 times: at 0.2 the probability rises by 0.08 in the mean, because modes are not
# the whole posterior, from 0.27 to 0.4 it stays within 0.02; at 0.5 and with noise of 3 grey
# levels answers come and go twice as often.
SAME_VIEW_GAIN = 0.35
# Share of the evidence before that a new view leaves. chosen: ten views.
REMEMBERED = 0.9
# The azimuth is no longer known after a turn with a larger error. chosen: that of its axes.
LARGEST_PAIR_ERROR_RAD = np.radians(5.0)


def carried(expected: Expected, before: SceneDirections, segments_before: LineSegments,
            segments: LineSegments) -> Expected:
    """
    Return what is expected of an image after another one.

    Parameters
    ----------
    expected : Expected
        Without the images before.
    before : SceneDirections
        Of the image before, in the frame of its camera.
    segments_before, segments : LineSegments
        Of both images.

    """
    turn, share = turn_between_images(segments_before, segments)
    error_rad = np.hypot(TURN_ERROR_RATIO * np.linalg.norm(turn), STILL_RAD)
    if share < LEAST_SHARE:
        turn, share, error_rad = np.zeros(3), 0.0, UNKNOWN_TURN_RAD
    rotation, is_new = cv2.Rodrigues(turn)[0], max(0.0, 1 - share / STILL_SHARE)
    sharp = CLOSE_RAD**2 / (CLOSE_RAD**2 + error_rad**2)
    gain = is_new + (1 - is_new) * (1 - sharp * (1 - SAME_VIEW_GAIN))
    modes = replace(
        before.modes, downs=before.modes.downs @ rotation.T,
        covariances=rotation @ before.modes.covariances @ rotation.T + error_rad**2 * np.eye(3))
    has_pair = len(before.pairs) and error_rad < LARGEST_PAIR_ERROR_RAD
    return replace(expected, before=modes, pair=before.pairs[0] @ rotation.T if has_pair else None,
                   pair_rad=error_rad, new=gain, kept=1 - gain + REMEMBERED * is_new)


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
