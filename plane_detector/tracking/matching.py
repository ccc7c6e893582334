# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Similarity of planes in two images by pixels, position and coefficients; matching."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.types import Planes

# Standard deviations of one plane between two images, apart from the motion of the camera: of the
# angle between the normals, and of the offset as a share of the distance from the camera.
_ANGLE_RAD, _OFFSET_SHARE = math.radians(10.0), 0.03
_TINY_M2 = 1e-12


@dataclass(frozen=True)
class Overlap:
    """Pixels that T known planes share with N detected planes, (T, N) float64."""

    of_union: np.ndarray  # share of the union of their pixels: 1 only for identical pixels
    of_known: np.ndarray  # share of the known plane: also 1 for each part of a merged plane
    common: np.ndarray  # number of shared pixels


def thinned(labels: np.ndarray, rows: int) -> np.ndarray:
    """Return labels (H, W) on about this many rows, as (M,) int32."""
    step = max(1, min(labels.shape) // rows)
    return np.ascontiguousarray(labels[::step, ::step], np.int32).ravel()


def measure_overlap(pixels: np.ndarray, known_px: np.ndarray, labels: np.ndarray,
                    found_px: np.ndarray) -> Overlap:
    """Return the overlap of known objects, from :func:`sorted_pixels`, with new labels (M,)."""
    common, known_px = _count_common(pixels, known_px, labels, len(found_px)), known_px[:, None]
    return Overlap(common / np.maximum(known_px + found_px - common, 1),
                   common / np.maximum(known_px, 1), common)


@kernel('Tuple((int32[::1], int64[::1]))(int32[::1], int64)', is_short=True)
def sorted_pixels(labels, count):
    """Return the indices of the pixels, ordered by label, and the count per label (count,)."""
    sizes, place = np.zeros(count, np.int64), np.zeros(count + 1, np.int64)
    for i in range(len(labels)):
        if 0 <= labels[i] < count:
            sizes[labels[i]] += 1
    for k in range(count):
        place[k + 1] = place[k] + sizes[k]
    pixels = np.empty(place[count], np.int32)
    for i in range(len(labels)):
        if 0 <= labels[i] < count:
            pixels[place[labels[i]]] = i
            place[labels[i]] += 1
    return pixels, sizes


@kernel('int64[:, ::1](int32[::1], int64[::1], int32[::1], int64)', is_short=True)
def _count_common(pixels, known_px, labels, count):
    """Return the number of pixels that known objects (T,) share with labels, (T, N)."""
    common, first = np.zeros((len(known_px), count), np.int64), 0
    for t in range(len(known_px)):
        for i in range(first, first + known_px[t]):
            if pixels[i] < len(labels) and 0 <= labels[pixels[i]] < count:
                common[t, labels[pixels[i]]] += 1
        first += known_px[t]
    return common


def split_by(pixels: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Return the pixels of each label, from :func:`sorted_pixels`."""
    ends = np.cumsum(sizes).tolist()
    return [pixels[begin:end] for begin, end in itertools.pairwise([0, *ends])]


def compare(before: Planes, after: Planes, growth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Compare T planes with N others in the same camera frame.

    Return the squared difference of their coefficients in standard deviations, with a factor
    ``growth`` (T,) on the variances between two images, and the nearness of their centroids: 1 if
    they are equal, decreasing with the distance over the smaller size. Both are (T, N).
    """
    return _compare(*(tuple(map(np.ascontiguousarray, (
        one.normals, one.offsets_m, one.centroids_m, one.covariances, one.areas_m2)))
        for one in (before, after)), np.ascontiguousarray(growth, float))


_PLANES = ('Tuple((float64[:, ::1], float64[::1], float64[:, ::1], float64[:, :, ::1], '
           'float64[::1]))')


@kernel(f'UniTuple(float64[:, ::1], 2)({_PLANES}, {_PLANES}, float64[::1])', is_short=True)
def _compare(before, after, growth):
    known, found = _spreads(before), _spreads(after)
    deviation2 = np.empty((len(known), len(found)))
    nearness = np.empty((len(known), len(found)))
    for t in range(len(known)):
        for n in range(len(found)):
            cosine, off, back, apart_m2 = 0.0, after[1][n], before[1][t], 0.0
            for i in range(3):
                cosine += before[0][t, i] * after[0][n, i]
                off += before[2][t, i] * after[0][n, i]
                back += before[0][t, i] * after[2][n, i]
                apart_m2 += (before[2][t, i] - after[2][n, i]) ** 2
            off, back = off / known[t, 0], back / found[n, 0]
            turn_rad = math.acos(min(max(cosine, -1.0), 1.0))
            turn_variance = _ANGLE_RAD**2 * growth[t] + known[t, 1] + found[n, 1]
            off_variance = _OFFSET_SHARE**2 * growth[t] + known[t, 2] + found[n, 2]
            deviation2[t, n] = (turn_rad**2 / turn_variance
                                + (off * off + back * back) / (2 * off_variance))
            small_m2 = max(min(before[4][t], after[4][n]), _TINY_M2)
            large_m2 = max(before[4][t], after[4][n], _TINY_M2)
            nearness[t, n] = math.exp(-apart_m2 / small_m2) * math.sqrt(small_m2 / large_m2)
    return deviation2, nearness


@kernel(f'float64[:, ::1]({_PLANES})')
def _spreads(planes):
    """Return the distance of each plane, and the variances of its normal and relative offset."""
    (normals, _, centroids, covariances, _), spreads = planes, np.zeros((len(planes[1]), 3))
    for k in range(len(normals)):
        variance = covariances[k, 3, 3]
        for i in range(3):
            spreads[k, 0] += centroids[k, i] ** 2
            spreads[k, 1] += covariances[k, i, i]
            variance += 2 * centroids[k, i] * covariances[k, i, 3]
            for j in range(3):
                variance += centroids[k, i] * covariances[k, i, j] * centroids[k, j]
        spreads[k, 0] = max(math.sqrt(spreads[k, 0]), _TINY_M2)
        spreads[k, 2] = variance / spreads[k, 0] ** 2
    return spreads


def labels_of_found(labels: np.ndarray, missed: np.ndarray, match: np.ndarray,
                    keep_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the label of each object detected in an image (N,), and indices of the missing.

    The known objects (T,) are given by their labels, and by the number of images for which each
    was missing. ``match`` (N,) is the known object of each detected one; new ones, -1, get the
    smallest free labels above 0. Objects missing for ``keep_frames`` images are dropped.
    """
    is_kept = missed < keep_frames
    is_kept[match[match >= 0]] = False
    gone = is_kept.nonzero()[0]
    taken = set(labels[gone].tolist()) | set(labels[match[match >= 0]].tolist())
    free = (label for label in itertools.count(1) if label not in taken)
    return np.array([labels[k] if k >= 0 else next(free) for k in match.tolist()], np.int64), gone


def matched(score: np.ndarray, least: float) -> np.ndarray:
    """
    Match detected objects one to one with known ones, with the largest sum of scores.

    Parameters
    ----------
    score : (T, N) float64
        NaN counts as no similarity, 0.
    least : float
        Pairs with this score, or a lower one, do not match.

    Returns
    -------
    (N,) int64
        -1 for none.

    Examples
    --------
    >>> matched(np.array([[0.9, 0.8, 0.0], [0.7, 0.1, 0.0]]), 0.0)
    array([ 1,  0, -1])

    """
    match = np.full(score.shape[1], -1)
    if score.size:
        from scipy.optimize import linear_sum_assignment  # late: it takes a tenth of a second
        rows, columns = linear_sum_assignment(np.nan_to_num(score), maximize=True)
        is_alike = score[rows, columns] > least
        match[columns[is_alike]] = rows[is_alike]
    return match
