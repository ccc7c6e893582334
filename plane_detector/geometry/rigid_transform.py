# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rotation and translation between frames, and the transformation of planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from plane_detector.types import Plane


@dataclass(frozen=True)
class RigidTransform:
    """
    p_target = rotation @ p_source + translation_m.

    Attributes
    ----------
    rotation : (3, 3) float64
    translation_m : (3,) float64

    Examples
    --------
    >>> turn = RigidTransform.from_quaternion((0, 0, 1, 1), (1, 0, 0))
    >>> turn.points(np.array([1.0, 0.0, 0.0])).round(6).tolist()
    [1.0, 1.0, 0.0]

    """

    rotation: np.ndarray
    translation_m: np.ndarray

    @classmethod
    def from_quaternion(cls, quaternion: Sequence[float],
                        translation_m: Sequence[float]) -> RigidTransform:
        """Return the transform of a quaternion x y z w of any length but 0, and a translation."""
        return cls(Rotation.from_quat(quaternion).as_matrix(), np.asarray(translation_m, float))

    @classmethod
    def identity(cls) -> RigidTransform:
        """Return the identity transform."""
        return cls(np.eye(3), np.zeros(3))

    @property
    def quaternion(self) -> np.ndarray:
        """The rotation as x y z w, (4,)."""
        return Rotation.from_matrix(self.rotation).as_quat()

    def inverse(self) -> RigidTransform:
        """Return the inverse transform."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation_m)

    def after(self, first: RigidTransform) -> RigidTransform:
        """Return the transform that applies ``first``, then this one."""
        return RigidTransform(self.rotation @ first.rotation,
                              self.rotation @ first.translation_m + self.translation_m)

    def points(self, points_m: np.ndarray) -> np.ndarray:
        """Return points (..., 3) in the target frame, of the same dtype; NaN stays NaN."""
        moved_m = points_m @ self.rotation.T.astype(points_m.dtype)
        return moved_m + self.translation_m.astype(points_m.dtype)

    def plane(self, plane: Plane) -> Plane:
        """
        Return a plane in the target frame.

        Its normal still points to the camera; its offset may be negative there.
        """
        normal = self.rotation @ plane.normal
        return replace(plane, normal=normal, centroid_m=self.points(plane.centroid_m),
                       offset_m=float(plane.offset_m - normal @ self.translation_m))


def interpolate(before: RigidTransform, after: RigidTransform, share: float) -> RigidTransform:
    """Return the interpolated transform, linear and slerp; share 0: ``before``, 1: ``after``."""
    rotations = Rotation.from_matrix(np.stack([before.rotation, after.rotation]))
    return RigidTransform(Slerp([0.0, 1.0], rotations)(share).as_matrix(),
                          (1 - share) * before.translation_m + share * after.translation_m)
