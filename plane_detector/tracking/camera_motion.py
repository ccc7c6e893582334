# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Motion of the camera between two images, estimated from their planes.

A point moves from p to scale * R p + t, so a plane (n, d) becomes (R n, scale * d - R n . t). The
scale is needed for depth of unknown unit, which may change from image to image. Motion that the
planes do not constrain, such as a rotation about the only visible normal, is assumed to be zero.
"""

from __future__ import annotations

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
        normal = self.rotation @ plane.normal
        turn = np.eye(4)
        turn[:3, :3], turn[3, 3] = self.rotation, self.scale
        return replace(
            plane, normal=normal,
            offset_m=float(self.scale * plane.offset_m - normal @ self.translation_m),
            centroid_m=self.scale * self.rotation @ plane.centroid_m + self.translation_m,
            area_m2=self.scale ** 2 * plane.area_m2,
            covariance=turn @ plane.covariance @ turn.T)


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
    weights = weights / [np.trace((b.covariance + a.covariance)[:3, :3]) + _NORMAL_SPREAD_RAD ** 2
                         for b, a in zip(before, after, strict=True)]
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
    distances_m = np.array([np.linalg.norm(p.centroid_m) for p in after])[agree]
    translation_m, scale = _translation_and_scale(
        normals_after[agree], offsets_before, offsets_after, distances_m, weights[agree])
    return PlaneMotion(rotation, translation_m, scale)


def _rotation(before: np.ndarray, after: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that maps the normals (N, 3) before to those after."""
    rotation = np.eye(3)
    robust, caution = weights, _FIRST_CAUTION
    for _ in range(_ROUNDS):
        moment = (after * robust[:, None]).T @ before + caution * _NO_TURN_WEIGHT * np.eye(3)
        left, _, right = np.linalg.svd(moment)
        left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
        rotation = left @ right
        error_rad = np.linalg.norm(before @ rotation.T - after, axis=1)
        robust = weights * _cauchy(error_rad / _TURN_SPREAD_RAD)
        turn_rad = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
        caution = _cauchy(turn_rad / _TURN_SPREAD_RAD)
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
        normal_matrix = (system.T * robust) @ system / _OFFSET_SPREAD ** 2
        unknown = np.linalg.solve(normal_matrix + np.diag(caution * prior),
                                  system.T @ (robust * change) / _OFFSET_SPREAD ** 2)
        robust = weights * _cauchy((system @ unknown - change) / _OFFSET_SPREAD)
        caution = _cauchy(unknown * np.sqrt(prior))
    return unknown[:3] * typical_m, float(np.clip(1 + unknown[3], 0.01, 100.0))


def _cauchy(ratio: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.square(ratio))
