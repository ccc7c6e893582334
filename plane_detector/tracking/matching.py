# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Similarity of planes in two images: by their pixels, position and coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector.types import Plane

_TINY = 1e-12


@dataclass(frozen=True)
class Overlap:
    """
    Pixels that known planes share with found planes.

    Attributes
    ----------
    of_union : (T, N) float64
        As a share of the union of their pixels: 1 only for identical pixels.
    of_known : (T, N) float64
        As a share of the pixels of the known plane: 1 also for each part of a merged plane.

    """

    of_union: np.ndarray
    of_known: np.ndarray


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


def likeness(before: Sequence[Plane], after: Sequence[Plane], overlap: Overlap,
             tolerances: tuple[float, float], growth: np.ndarray) -> np.ndarray:
    """
    Return how well planes agree in position and coefficients, (T, N), 0 to 1.

    The positions agree by shared pixels or, if the camera has turned so far that there are none,
    by the distance of the centroids relative to the size of the planes.

    Parameters
    ----------
    before, after : sequence of Plane
        T and N planes, in one camera frame.
    overlap : Overlap
        Of these planes.
    tolerances : (float, float)
        ``angle_deg`` and ``offset_share`` of :func:`squared_deviation`.
    growth : (T,) float
        As there.

    """
    first, second = _stack(before), _stack(after)
    place = np.maximum((overlap.of_union + overlap.of_known) / 2, _nearness(first, second))
    return place * np.exp(-0.5 * _squared_deviation(first, second, *tolerances,
                                                    np.reshape(growth, (-1, 1))))


def squared_deviation(before: Sequence[Plane], after: Sequence[Plane], angle_deg: float,
                      offset_share: float, growth: np.ndarray | float = 1.0) -> np.ndarray:
    """
    Return the squared number of standard deviations by which coefficients differ, (T, N).

    Parameters
    ----------
    before, after : sequence of Plane
        T and N planes, in one camera frame.
    angle_deg : float
        Standard deviation of the angle between normals, in addition to that of the fits.
    offset_share : float
        The same for the distance from one plane to the centroid of the other, as a share of the
        distance of the centroid from the camera.
    growth : (T,) float or float
        Factor on these variances.

    """
    return _squared_deviation(_stack(before), _stack(after), angle_deg, offset_share,
                              np.reshape(growth, (-1, 1)))


@dataclass(frozen=True)
class _Stack:
    """
    Planes as arrays.

    Attributes
    ----------
    normal, centroid_m : (N, 3) float64
    offset_m, distance_m, area_m2 : (N,) float64
        Of the plane from the camera, of the centroid from the camera, of the plane.
    normal_variance, distance_variance : (N,) float64
        Squared radians; squared shares of the distance, at the centroid.

    """

    normal: np.ndarray
    centroid_m: np.ndarray
    offset_m: np.ndarray
    distance_m: np.ndarray
    area_m2: np.ndarray
    normal_variance: np.ndarray
    distance_variance: np.ndarray


def _stack(planes: Sequence[Plane]) -> _Stack:
    centroid_m = np.stack([plane.centroid_m for plane in planes])
    distance_m = np.maximum(np.linalg.norm(centroid_m, axis=1), _TINY)
    covariance = np.stack([plane.covariance for plane in planes])
    point = np.column_stack([centroid_m, np.ones(len(planes))])
    return _Stack(
        np.stack([plane.normal for plane in planes]), centroid_m,
        np.array([plane.offset_m for plane in planes]), distance_m,
        np.array([plane.area_m2 for plane in planes]),
        np.trace(covariance[:, :3, :3], axis1=1, axis2=2),
        np.einsum('ni,nij,nj->n', point, covariance, point) / distance_m ** 2)


def _nearness(before: _Stack, after: _Stack) -> np.ndarray:
    """Return (T, N): 1 for equal centroids, less with the distance over the smaller size."""
    apart_m = before.centroid_m[:, None] - after.centroid_m
    smaller_m2 = np.maximum(np.minimum.outer(before.area_m2, after.area_m2), _TINY)
    larger_m2 = np.maximum(np.maximum.outer(before.area_m2, after.area_m2), _TINY)
    return np.exp(-(apart_m ** 2).sum(axis=2) / smaller_m2) * np.sqrt(smaller_m2 / larger_m2)


def _squared_deviation(before: _Stack, after: _Stack, angle_deg: float, offset_share: float,
                       growth: np.ndarray) -> np.ndarray:
    turn_rad = np.arccos(np.clip(before.normal @ after.normal.T, -1, 1))
    off = (before.centroid_m @ after.normal.T + after.offset_m) / before.distance_m[:, None]
    back = (before.normal @ after.centroid_m.T + before.offset_m[:, None]) / after.distance_m
    turn_variance = (np.radians(angle_deg) ** 2 * growth
                     + np.add.outer(before.normal_variance, after.normal_variance))
    off_variance = (offset_share ** 2 * growth
                    + np.add.outer(before.distance_variance, after.distance_variance))
    return turn_rad ** 2 / turn_variance + (off ** 2 + back ** 2) / (2 * off_variance)
