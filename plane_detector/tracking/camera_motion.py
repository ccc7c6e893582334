# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Motion of the camera between two images, estimated from their planes.

A point moves from p to scale * R p + t, so a plane (n, d) becomes (R n, scale * d - R n . t). The
scale is needed for depth of unknown unit, which may change from image to image. Motion that the
planes do not constrain, such as a rotation about the only visible normal, is assumed to be zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.types import Plane

_ROUNDS = 8
# Weight of the prior for no rotation; all planes together have weight 1.
_NO_TURN_WEIGHT = 0.03
# Lower bound of the deviation between normals, however small the covariance of their fit.
_NORMAL_SPREAD_RAD = np.radians(1.0)
_TURN_SPREAD_RAD = np.radians(2.0)
# Spread of the offsets of a rigid scene, and of the translation of the camera between two images,
# as shares of the distance to the scene.
_OFFSET_SPREAD, _STEP_SPREAD, _SCALE_SPREAD = 0.02, 0.1, 0.04
# In the first round, large rotations and changes of the unit are nearly as likely as none.
_FIRST_CAUTION = 0.01


@dataclass(frozen=True)
class PlaneMotion:
    """
    A similarity from the previous camera frame to the present one.

    Attributes
    ----------
    rotation : (3, 3) float64
    translation_m : (3,) float64
        In the unit of the present image.
    scale : float
        Factor on lengths; 1 if the unit is known.

    """

    rotation: np.ndarray
    translation_m: np.ndarray
    scale: float

    def move(self, plane: Plane) -> Plane:
        """Return a plane of the previous camera frame in the present one."""
        return self.move_all([plane])[0]

    def move_all(self, planes: Sequence[Plane]) -> list[Plane]:
        """Return planes of the previous camera frame, at least one, in the present one."""
        turn = np.eye(4)
        turn[:3, :3], turn[3, 3] = self.rotation, self.scale
        normals = np.stack([plane.normal for plane in planes]) @ self.rotation.T
        centroids_m = np.stack([plane.centroid_m for plane in planes]) @ self.rotation.T
        offsets_m = self.scale * np.array([plane.offset_m for plane in planes])
        covariances = turn @ np.stack([plane.covariance for plane in planes]) @ turn.T
        return [replace(plane, normal=normal, offset_m=offset_m, centroid_m=centroid_m,
                        area_m2=self.scale ** 2 * plane.area_m2, covariance=covariance)
                for plane, normal, offset_m, centroid_m, covariance in zip(
                    planes, normals, (offsets_m - normals @ self.translation_m).tolist(),
                    self.scale * centroids_m + self.translation_m, covariances, strict=True)]


NO_MOTION = PlaneMotion(np.eye(3), np.zeros(3), 1.0)


def estimate_motion(before: list[Plane], after: list[Plane], weights: np.ndarray) -> PlaneMotion:
    """
    Estimate the motion from planes visible in both images.

    1. Estimate the rotation between the normals (Kabsch 1976).
    2. Estimate translation and scale by least squares.

    Both are reweighted with Cauchy's function, so that a few wrong pairs have little effect.

    Parameters
    ----------
    before, after : list of Plane
        The same planes in the previous and in the present camera frame.
    weights : (N,) float
        Weight of each pair.

    Returns
    -------
    PlaneMotion
        No motion if there is no pair.

    """
    if not before:
        return NO_MOTION
    weights = weights / (_normal_variances(before) + _normal_variances(after)
                         + _NORMAL_SPREAD_RAD ** 2)
    weights /= weights.sum()
    normals_before, normals_after = (np.stack([plane.normal for plane in side])
                                     for side in (before, after))
    rotation = _rotation(normals_before, normals_after, weights)
    turned = normals_before @ rotation.T
    agree = np.linalg.norm(turned - normals_after, axis=1) < 2 * _TURN_SPREAD_RAD
    if not agree.any():
        return NO_MOTION
    offsets_before, offsets_after = (np.array([p.offset_m for p in side])[agree]
                                     for side in (before, after))
    distances_m = np.linalg.norm([plane.centroid_m for plane in after], axis=1)[agree]
    translation_m, scale = _translation_and_scale(
        normals_after[agree], offsets_before, offsets_after, distances_m, weights[agree])
    return PlaneMotion(rotation, translation_m, scale)


def _normal_variances(planes: list[Plane]) -> np.ndarray:
    """Return the sum of the variances of each normal, (N,)."""
    covariances = np.stack([plane.covariance for plane in planes])
    return covariances[:, :3, :3].trace(axis1=1, axis2=2)


def _rotation(before: np.ndarray, after: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that maps the normals (N, 3) before to those after."""
    rotation, prior = np.eye(3), _NO_TURN_WEIGHT * np.eye(3)
    robust, caution = weights, _FIRST_CAUTION
    for _ in range(_ROUNDS):
        left, _, right = np.linalg.svd((after.T * robust) @ before + caution * prior)
        left[:, 2] *= np.linalg.det(left @ right)
        rotation = left @ right
        error = before @ rotation.T - after
        robust = weights * _cauchy_of_square((error * error).sum(axis=1) / _TURN_SPREAD_RAD ** 2)
        turn_rad = math.acos(min(max((rotation.trace() - 1) / 2, -1.0), 1.0))
        caution = _cauchy_of_square((turn_rad / _TURN_SPREAD_RAD) ** 2)
    return rotation


def _translation_and_scale(normals: np.ndarray, before: np.ndarray, after: np.ndarray,
                           distances_m: np.ndarray, weights: np.ndarray
                           ) -> tuple[np.ndarray, float]:
    """Solve after = scale * before - normals . t, with priors that keep t and scale - 1 small."""
    typical_m = float(np.average(distances_m, weights=weights))
    # Unknowns: t as a share of the typical distance, and scale - 1.
    system = np.column_stack([-normals * typical_m, before]) / distances_m[:, None]
    change = (after - before) / distances_m
    prior = np.array([_STEP_SPREAD] * 3 + [_SCALE_SPREAD]) ** -2
    robust, caution = weights, np.array([1.0, 1.0, 1.0, _FIRST_CAUTION])
    for _ in range(_ROUNDS):
        weighted = system.T * (robust / _OFFSET_SPREAD ** 2)
        unknown = np.linalg.solve(weighted @ system + np.diag(caution * prior), weighted @ change)
        misfit = (system @ unknown - change) / _OFFSET_SPREAD
        robust = weights * _cauchy_of_square(misfit * misfit)
        caution = _cauchy_of_square(unknown * unknown * prior)
    return unknown[:3] * typical_m, float(np.clip(1 + unknown[3], 0.01, 100.0))


def _cauchy_of_square(squared_ratio: np.ndarray | float) -> np.ndarray | float:
    return 1.0 / (1.0 + squared_ratio)
