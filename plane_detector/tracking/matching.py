# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Likeness of planes in two images, by their pixels, position and coefficients; their pairs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.types import Planes

# Standard deviations of one plane in two images, apart from the motion of the camera: of the angle
# between the normals, and of the distance from the plane as a share of that from the camera.
_ANGLE_RAD, _OFFSET_SHARE = math.radians(10.0), 0.03
_TINY_M2 = 1e-12


@dataclass(frozen=True)
class Overlap:
    """Pixels that T known planes share with N found planes, (T, N) float64."""

    of_union: np.ndarray  # share of the union of their pixels: 1 only for identical pixels
    of_known: np.ndarray  # share of the known plane: 1 also for each part of a merged plane


def thinned(labels: np.ndarray, rows: int) -> np.ndarray:
    """Return labels (H, W) on about so many rows, as (M,) int32."""
    step = max(1, min(labels.shape) // rows)
    return np.ascontiguousarray(labels[::step, ::step], np.int32).ravel()


def pixels_by_label(labels: np.ndarray, count: int) -> list[np.ndarray]:
    """Return the indices (N,) int32 of the pixels of each label in labels (M,)."""
    pixels, ends = _sorted_pixels(labels, count)
    return [pixels[begin:end] for begin, end in itertools.pairwise(ends.tolist())]


def measure_overlap(before: Sequence[np.ndarray], labels: np.ndarray, count: int) -> Overlap:
    """Return the overlap of things known by the indices of their pixels with labels (M,) now."""
    known_px = np.array([len(pixels) for pixels in before], np.int64)
    common, found_px = _count_common(np.concatenate([np.zeros(0, np.int32), *before]), known_px,
                                     labels, count)
    known_px = known_px[:, None]
    return Overlap(common / np.maximum(known_px + found_px - common, 1),
                   common / np.maximum(known_px, 1))


@kernel('Tuple((int32[::1], int64[::1]))(int32[::1], int64)', is_short=True)
def _sorted_pixels(labels, count):
    """Return the indices of the pixels, ordered by label, and where each label begins and ends."""
    ends = np.zeros(count + 1, np.int64)
    for i in range(len(labels)):
        if 0 <= labels[i] < count:
            ends[labels[i] + 1] += 1
    for k in range(count):
        ends[k + 1] += ends[k]
    pixels, place = np.empty(ends[count], np.int32), ends[:count].copy()
    for i in range(len(labels)):
        if 0 <= labels[i] < count:
            pixels[place[labels[i]]] = i
            place[labels[i]] += 1
    return pixels, ends


@kernel('Tuple((int64[:, ::1], int64[::1]))(int32[::1], int64[::1], int32[::1], int64)',
        is_short=True)
def _count_common(pixels, known_px, labels, count):
    """Return the pixels that known things (T,) share with labels, (T, N), and those of each."""
    common, found_px = np.zeros((len(known_px), count), np.int64), np.zeros(count, np.int64)
    for i in range(len(labels)):
        if 0 <= labels[i] < count:
            found_px[labels[i]] += 1
    first = 0
    for t in range(len(known_px)):
        for i in range(first, first + known_px[t]):
            if pixels[i] < len(labels) and 0 <= labels[pixels[i]] < count:
                common[t, labels[pixels[i]]] += 1
        first += known_px[t]
    return common, found_px


def likeness(before: Planes, after: Planes, overlap: Overlap,
             deviation2: np.ndarray) -> np.ndarray:
    """
    Return how well planes agree in position and coefficients, (T, N), 0 to 1.

    The positions agree by shared pixels or, if the camera has turned so far that there are none,
    by the distance of the centroids relative to the size of the planes. The coefficients agree by
    their :func:`squared_deviation`.
    """
    place = np.maximum((overlap.of_union + overlap.of_known) / 2, _nearness(before, after))
    return place * np.exp(-0.5 * deviation2)


def squared_deviation(before: Planes, after: Planes, growth: np.ndarray | float = 1.0
                      ) -> np.ndarray:
    """
    Return the squared number of standard deviations by which coefficients differ, (T, N).

    The T and N planes are in one camera frame; ``growth``, (T,) or a number, is a factor on the
    variances of angle and offset between two images.
    """
    growth = np.reshape(growth, (-1, 1))
    turn_rad = np.arccos((before.normals @ after.normals.T).clip(-1, 1))
    off = (before.centroids_m @ after.normals.T + after.offsets_m) / before.distances_m[:, None]
    back = (before.normals @ after.centroids_m.T + before.offsets_m[:, None]) / after.distances_m
    turn_variance = (_ANGLE_RAD ** 2 * growth
                     + np.add.outer(before.normal_variances, after.normal_variances))
    off_variance = (_OFFSET_SHARE ** 2 * growth
                    + np.add.outer(*(one.centroid_variances_m2 / one.distances_m ** 2
                                     for one in (before, after))))
    return turn_rad ** 2 / turn_variance + (off ** 2 + back ** 2) / (2 * off_variance)


def _nearness(before: Planes, after: Planes) -> np.ndarray:
    """Return (T, N): 1 for equal centroids, less with the distance over the smaller size."""
    apart_m = before.centroids_m[:, None] - after.centroids_m
    smaller_m2 = np.maximum(np.minimum.outer(before.areas_m2, after.areas_m2), _TINY_M2)
    larger_m2 = np.maximum(np.maximum.outer(before.areas_m2, after.areas_m2), _TINY_M2)
    return np.exp(-(apart_m ** 2).sum(axis=2) / smaller_m2) * np.sqrt(smaller_m2 / larger_m2)


def labels_of_found(tracks: Sequence[Any], match: Mapping[int, int], count: int,
                    keep_frames: int) -> tuple[list[int], list[int]]:
    """
    Return the label of each thing found in an image, and the indices of tracks that are missing.

    ``match`` gives the track of those of ``count`` things that have one; others get the smallest
    free labels above 0. Tracks that were missing for ``keep_frames`` images are dropped.
    """
    matched = set(match.values())
    gone = [index for index, track in enumerate(tracks)
            if index not in matched and track.missed < keep_frames]
    taken = {tracks[index].label for index in (*gone, *matched)}
    free = (label for label in itertools.count(1) if label not in taken)
    return [tracks[match[k]].label if k in match else next(free) for k in range(count)], gone


def best_pairs(score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return rows and columns, one to one, with the largest sum of scores.

    Parameters
    ----------
    score : (N, M) float64
        NaN counts as no likeness, 0.

    Returns
    -------
    rows, columns : (min(N, M),) int64
        Ordered by the rows.

    Examples
    --------
    >>> rows, columns = best_pairs(np.array([[0.9, 0.8], [0.7, 0.1]]))
    >>> rows.tolist(), columns.tolist()
    ([0, 1], [1, 0])

    """
    from scipy.optimize import linear_sum_assignment  # imported late: it takes a tenth of a second
    return linear_sum_assignment(np.nan_to_num(score), maximize=True)
