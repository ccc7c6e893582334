# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The correction of the poses, carried from image to image: the place of the map in their frame.

The error of a given pose is the sum of a drift, which persists, and of jitter, which is new in
each image. Both are Gaussian; re-observed planes measure their sum [Kaess 2015 registers to planes
of a map in the same way; here their coefficients are heights].

References
----------
M. Kaess: Simultaneous localization and mapping with infinite planes, ICRA 2015.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plane_detector.config import MapConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.heights import (
    ROBUST,
    PlaneFrames,
    heights_of,
    normal_equations,
    squared_misfits,
)
from plane_detector.types import Planes

# chosen: at this distance, errors of the translation move a plane as far as those of the rotation.
TYPICAL_M = 2.0
# derived: the quantile .999 of chi-squared with three degrees of freedom.
GATE = 16.27
ROUNDS = 4
MOST_CORRECTION_M = 0.2
"""A larger correction of the camera's position raises doubts about the poses."""
# A wide prior, for poses that have jumped: deviations of the rotation and translation.
_JUMP = np.diag([np.radians(3.0) ** 2] * 3 + [0.15**2] * 3)
# The first image has an exact pose; 1 micrometre keeps its covariance invertible.
_EXACT = 1e-12 * np.eye(6)


@dataclass(frozen=True)
class Correction:
    """
    The transform from the frame of the poses to that of the map.

    Rows and columns of the covariances: small rotation about the camera, radians, then shift, m.
    """

    transform: RigidTransform  # for the last image, with its jitter
    error: np.ndarray  # (6, 6) covariance of that
    persistent: RigidTransform  # without the jitter, to be carried on
    drift: np.ndarray  # (6, 6) covariance of that
    pose: RigidTransform | None = None  # of the camera in the last image, as it was given

    @classmethod
    def none(cls) -> Correction:
        """Return the correction before the first image, whose pose defines the map."""
        none, exact = RigidTransform.identity(), np.zeros((6, 6))
        return cls(none, exact, none, exact)

    @classmethod
    def loaded(cls, transform: RigidTransform) -> Correction:
        """Return the correction of a saved map: the next pose may be off as after a jump."""
        return cls(transform, _JUMP, transform, _JUMP)

    @property
    def camera(self) -> RigidTransform:
        """The corrected pose of the camera in the last image."""
        return self.transform.after(self.pose)

    def size(self) -> tuple[float, float]:
        """Return how far it moves the camera, in metres, and rotates it, in degrees."""
        moved = self.camera.translation_m - self.pose.translation_m if self.pose else np.zeros(3)
        return float(np.linalg.norm(moved)), float(np.degrees(angle_rad(self.transform.rotation)))


@dataclass(frozen=True)
class Prediction:
    """What is known about the pose of an image before its planes are compared with the map."""

    transform: RigidTransform  # from the frame of the poses to that of the map
    pose: RigidTransform  # given
    drift: np.ndarray  # (6, 6) covariance
    covariance: np.ndarray  # (6, 6) covariance, with the jitter

    @property
    def camera(self) -> RigidTransform:
        """Pose of the camera in the map."""
        return self.transform.after(self.pose)

    def widened(self) -> Prediction:
        """Return the prediction for a pose that may have jumped."""
        return replace(self, drift=self.drift + _JUMP, covariance=self.covariance + _JUMP)


def predict(before: Correction, pose: RigidTransform, config: MapConfig) -> Prediction:
    """
    Return the prediction for the next image.

    The variance of the drift is proportional to the distance travelled, whatever the rate of
    images.
    """
    if before.pose is None:
        return Prediction(before.persistent, pose, before.drift, before.drift)
    way_m, turn_rad = motion(before.pose, pose)
    moved_m = before.persistent.after(pose).translation_m - before.camera.translation_m
    shift = np.eye(6)  # the same error, as a rotation about the camera's new position
    shift[3:, :3] = -_cross_matrix(moved_m)
    added = np.diag([turn_rad + way_m / TYPICAL_M**2] * 3 + [way_m] * 3) * config.pose_drift**2
    jitter = np.diag([TYPICAL_M**-2] * 3 + [1.0] * 3) * config.pose_jitter**2
    drift = shift @ before.drift @ shift.T + added
    return Prediction(before.persistent, pose, drift, drift + jitter)


def register(prediction: Prediction, found: Planes, frames: PlaneFrames, index: np.ndarray
             ) -> Correction:
    """
    Return the correction under which detected planes fit the planes of the map best.

    Gauss-Newton over the six unknowns, with robust weights and the prior.

    Parameters
    ----------
    prediction : Prediction
    found : Planes
        In the frame of the camera.
    frames : PlaneFrames
        Planes of the map, M.
    index : (M,) int
        The detected plane for each of them.

    """
    if not len(index):
        return Correction(prediction.transform, prediction.covariance, prediction.transform,
                          prediction.drift, prediction.pose)
    prior = np.linalg.inv(prediction.covariance + _EXACT)
    centre_m, total = prediction.camera.translation_m, np.zeros(6)
    transform = prediction.transform
    for _ in range(ROUNDS):
        information, gradient = normal_equations(
            frames, found, index, transform.after(prediction.pose), centre_m)
        information += prior
        step = np.linalg.solve(information, gradient - prior @ total)
        total = total + step
        transform = _moved(transform, step, centre_m)
    error = np.linalg.inv(information)
    # The part of the sum that is drift: the linear filter of two Gaussians whose sum was measured.
    gain = prediction.drift @ prior
    drift = prediction.drift - gain @ (prediction.covariance - error) @ gain.T
    return Correction(transform, error, _moved(prediction.transform, gain @ total, centre_m),
                      (drift + drift.T) / 2, prediction.pose)


def heights_by_others(correction: Correction, frames: PlaneFrames, found: Planes,
                      index: np.ndarray, is_evidence: np.ndarray
                      ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return detected planes as heights over those of the map, each with the pose from the others.

    A plane is not evidence for itself: with a pose that it has helped to estimate, it would agree
    with the map, and the map would become overconfident.

    Parameters
    ----------
    correction : Correction
    frames : PlaneFrames
        Planes of the map, M.
    found : Planes
        In the frame of the map.
    index : (M,) int
        The detected plane for each of them.
    is_evidence : (M,) bool
        Whether this pair was used for the correction.

    Returns
    -------
    coefficients : (M, 3) float64
    covariances : (M, 3, 3) float64
    pose : (M, 3, 3) float64
        The part of them that is due to the error of the pose.

    """
    heights, alone, jacobians = heights_of(frames, found, index,
                                           centre_m=correction.camera.translation_m)
    weights = np.linalg.inv(alone + frames.covariances)
    squared = squared_misfits(frames, heights, alone)
    weights *= (is_evidence / (1 + squared / ROBUST))[:, None, None]
    transposed = jacobians.transpose(0, 2, 1)
    weighted = transposed @ weights
    errors = np.linalg.inv(np.linalg.inv(correction.error + _EXACT) - weighted @ jacobians)
    misfits = (frames.coefficients - heights)[:, :, None]
    steps = jacobians @ errors @ weighted @ misfits
    pose = jacobians @ errors @ transposed
    return heights - steps[:, :, 0], alone + pose, pose


def motion(before: RigidTransform, after: RigidTransform) -> tuple[float, float]:
    """Return how far a camera has moved and rotated between two poses, m and radians."""
    return (float(np.linalg.norm(after.translation_m - before.translation_m)),
            angle_rad(after.rotation @ before.rotation.T))


def angle_rad(rotation: np.ndarray) -> float:
    """Return the angle of a rotation (3, 3)."""
    return float(np.linalg.norm(cv2.Rodrigues(rotation)[0]))


def _moved(transform: RigidTransform, step: np.ndarray, centre_m: np.ndarray) -> RigidTransform:
    """Rotate a transform about a point of the map, then shift it."""
    rotation = cv2.Rodrigues(step[:3])[0]
    return RigidTransform(rotation, centre_m + step[3:] - rotation @ centre_m).after(transform)


def _cross_matrix(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
