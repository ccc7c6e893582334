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

from plane_detector.types import Planes

# Standard deviations of one plane in two images, apart from the motion of the camera: of the angle
# between the normals, and of the distance from the plane as a share of that from the camera.
_ANGLE_DEG, _OFFSET_SHARE = 10.0, 0.03
_TINY_M2 = 1e-12


@dataclass(frozen=True)
class Overlap:
    """Pixels that T known planes share with N found planes, (T, N) float64."""

    of_union: np.ndarray  # share of the union of their pixels: 1 only for identical pixels
    of_known: np.ndarray  # share of the known plane: 1 also for each part of a merged plane


def measure_overlap(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> Overlap:
    """Return the overlap of planes; each plane is given by the indices of its pixels."""
    (first, first_size), (second, second_size) = map(_joined, (before, after))
    width = len(after) + 1
    plane = np.zeros(1 + max(first.max(initial=0), second.max(initial=0)), np.intp)
    plane[second] = np.repeat(np.arange(1, width), second_size)
    pairs = np.repeat(width * np.arange(len(before)), first_size) + plane[first]
    common = np.bincount(pairs, minlength=width * len(before)).reshape(-1, width)[:, 1:]
    before_size, after_size = first_size[:, None], second_size
    return Overlap(common / np.maximum(before_size + after_size - common, 1),
                    common / np.maximum(before_size, 1))


def _joined(groups: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of all groups, and the number in each group."""
    return (np.concatenate([np.zeros(0, np.intp), *groups]),
            np.array([len(group) for group in groups], np.intp))


def likeness(before: Planes, after: Planes, overlap: Overlap,
             growth: np.ndarray) -> np.ndarray:
    """
    Return how well planes agree in position and coefficients, (T, N), 0 to 1.

    The positions agree by shared pixels or, if the camera has turned so far that there are none,
    by the distance of the centroids relative to the size of the planes. ``growth`` is that of
    :func:`squared_deviation`.
    """
    place = np.maximum((overlap.of_union + overlap.of_known) / 2, _nearness(before, after))
    return place * np.exp(-0.5 * squared_deviation(before, after, growth))


def squared_deviation(before: Planes, after: Planes, growth: np.ndarray | float = 1.0,
                      angle_deg: float = _ANGLE_DEG,
                      offset_share: float = _OFFSET_SHARE) -> np.ndarray:
    """
    Return the squared number of standard deviations by which coefficients differ, (T, N).

    Parameters
    ----------
    before, after : Planes
        T and N planes, in one camera frame.
    growth : (T,) float or float
        Factor on the variances of the next two.
    angle_deg : float
        Standard deviation of the angle between normals, in addition to that of the fits.
    offset_share : float
        The same for the distance from one plane to the centroid of the other, as a share of the
        distance of the centroid from the camera.

    """
    growth = np.reshape(growth, (-1, 1))
    turn_rad = np.arccos((before.normals @ after.normals.T).clip(-1, 1))
    off = (before.centroids_m @ after.normals.T + after.offsets_m) / before.distances_m[:, None]
    back = (before.normals @ after.centroids_m.T + before.offsets_m[:, None]) / after.distances_m
    turn_variance = (math.radians(angle_deg) ** 2 * growth
                     + np.add.outer(before.normal_variances, after.normal_variances))
    off_variance = (offset_share ** 2 * growth
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
