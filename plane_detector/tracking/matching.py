# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Similarity of planes in two images: by their pixels, position and coefficients."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np

from plane_detector.types import Plane

# Standard deviations of one plane in two images, apart from the motion of the camera: of the angle
# between the normals, and of the distance from the plane as a share of that from the camera.
_ANGLE_DEG, _OFFSET_SHARE = 10.0, 0.03
_TINY_M = _TINY_M2 = 1e-12


@dataclass(frozen=True)
class PlaneArrays:
    """N planes in one camera frame, float64; fields of :class:`~plane_detector.types.Plane`."""

    normals: np.ndarray  # (N, 3)
    offsets_m: np.ndarray  # (N,)
    centroids_m: np.ndarray  # (N, 3)
    areas_m2: np.ndarray  # (N,)
    covariances: np.ndarray  # (N, 4, 4)

    @classmethod
    def of(cls, planes: Sequence[Plane]) -> PlaneArrays:
        """Return the coefficients of planes."""
        return cls(np.array([plane.normal for plane in planes]).reshape(-1, 3),
                   np.array([plane.offset_m for plane in planes], float),
                   np.array([plane.centroid_m for plane in planes]).reshape(-1, 3),
                   np.array([plane.area_m2 for plane in planes], float),
                   np.array([plane.covariance for plane in planes]).reshape(-1, 4, 4))

    def __len__(self) -> int:
        return len(self.offsets_m)

    def picked(self, index: np.ndarray | Sequence[int]) -> PlaneArrays:
        """Return some planes, by a mask (N,) bool or by their indices."""
        return PlaneArrays(self.normals[index], self.offsets_m[index], self.centroids_m[index],
                           self.areas_m2[index], self.covariances[index])

    def followed_by(self, others: PlaneArrays) -> PlaneArrays:
        """Return these planes and others."""
        if not len(others):
            return self
        return PlaneArrays(*(np.concatenate([getattr(self, name), getattr(others, name)])
                             for name in self.__dataclass_fields__))

    @cached_property
    def distances_m(self) -> np.ndarray:
        """Distance of each centroid from the camera, (N,), above 0."""
        return np.maximum(np.sqrt((self.centroids_m ** 2).sum(axis=1)), _TINY_M)

    @cached_property
    def normal_variances(self) -> np.ndarray:
        """Sum of the variances of each normal, (N,), squared radians."""
        return np.einsum('nii->n', self.covariances[:, :3, :3])

    @cached_property
    def distance_variances(self) -> np.ndarray:
        """Variance of each plane's position at its centroid, (N,), squared shares of distance."""
        point = np.ones((len(self), 4))
        point[:, :3] = self.centroids_m
        return np.einsum('ni,nij,nj->n', point, self.covariances, point) / self.distances_m ** 2


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


def likeness(before: PlaneArrays, after: PlaneArrays, overlap: Overlap,
             growth: np.ndarray) -> np.ndarray:
    """
    Return how well planes agree in position and coefficients, (T, N), 0 to 1.

    The positions agree by shared pixels or, if the camera has turned so far that there are none,
    by the distance of the centroids relative to the size of the planes. ``growth`` is that of
    :func:`squared_deviation`.
    """
    place = np.maximum((overlap.of_union + overlap.of_known) / 2, _nearness(before, after))
    return place * np.exp(-0.5 * squared_deviation(before, after, growth))


def squared_deviation(before: PlaneArrays, after: PlaneArrays, growth: np.ndarray | float = 1.0,
                      angle_deg: float = _ANGLE_DEG,
                      offset_share: float = _OFFSET_SHARE) -> np.ndarray:
    """
    Return the squared number of standard deviations by which coefficients differ, (T, N).

    Parameters
    ----------
    before, after : PlaneArrays
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
                    + np.add.outer(before.distance_variances, after.distance_variances))
    return turn_rad ** 2 / turn_variance + (off ** 2 + back ** 2) / (2 * off_variance)


def _nearness(before: PlaneArrays, after: PlaneArrays) -> np.ndarray:
    """Return (T, N): 1 for equal centroids, less with the distance over the smaller size."""
    apart_m = before.centroids_m[:, None] - after.centroids_m
    smaller_m2 = np.maximum(np.minimum.outer(before.areas_m2, after.areas_m2), _TINY_M2)
    larger_m2 = np.maximum(np.maximum.outer(before.areas_m2, after.areas_m2), _TINY_M2)
    return np.exp(-(apart_m ** 2).sum(axis=2) / smaller_m2) * np.sqrt(smaller_m2 / larger_m2)


def free_labels(taken: Collection[int]) -> Iterator[int]:
    """Yield the smallest labels above 0 that are not taken."""
    return (label for label in count(1) if label not in taken)
