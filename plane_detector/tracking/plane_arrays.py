# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The coefficients of several planes as arrays: one operation for all planes of an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.types import Plane

_TINY_M = 1e-12


@dataclass(frozen=True)
class PlaneArrays:
    """
    N planes in one camera frame; the fields are those of :class:`~plane_detector.types.Plane`.

    Attributes
    ----------
    normals, centroids_m : (N, 3) float64
    offsets_m, areas_m2 : (N,) float64
    covariances : (N, 4, 4) float64

    """

    normals: np.ndarray
    offsets_m: np.ndarray
    centroids_m: np.ndarray
    areas_m2: np.ndarray
    covariances: np.ndarray

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
