# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Methods that find spheres, cylinders and cones: ours and a baseline."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, ShapesConfig
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics, ShapeType

CONFIG = Config(depth=DepthConfig(source='topic'), shapes=ShapesConfig(types='all'))


@dataclass(frozen=True)
class ShapeGuess:
    """
    One shape found by a method.

    Attributes
    ----------
    type : ShapeType
    mask : (H, W) bool
    radius_m : float
        0 for a cone.
    half_angle_rad : float
    axis : (3,) float64
        Zeros for a sphere.

    """

    type: ShapeType
    mask: np.ndarray
    radius_m: float
    half_angle_rad: float
    axis: np.ndarray


def ours(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> list[ShapeGuess]:
    """Return the shapes found by the package with its default settings."""
    detection = PlaneDetector(CONFIG).detect(np.zeros((*depth_m.shape, 3), np.uint8), intrinsics,
                                             depth_m)
    return [ShapeGuess(shape.type, detection.labels == len(detection.planes) + k, shape.radius_m,
                       shape.half_angle_rad, shape.axis)
            for k, shape in enumerate(detection.shapes)]


class PyRansac:
    """
    Spheres and cylinders of pyRANSAC-3D, largest first, where our method finds no plane.

    It uses the normal of three points as the axis of a cylinder, which is correct only by chance,
    and does not limit the extent of a shape: its inliers may be anywhere in the image. It has no
    cones.

    Parameters
    ----------
    threshold_m : float
        Inlier distance.
    max_points, iterations : int
        Points are subsampled, because every iteration tests all of them.

    """

    def __init__(self, threshold_m: float = 0.02, max_points: int = 4000, iterations: int = 500):
        self._threshold_m, self._iterations = threshold_m, iterations
        self._max_points = max_points

    def __call__(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> list[ShapeGuess]:
        """Return up to eight shapes of at least 0.1 % of the image."""
        import pyransac3d
        random.seed(0)
        planes = PlaneDetector(replace(CONFIG, shapes=ShapesConfig())).detect(
            np.zeros((*depth_m.shape, 3), np.uint8), intrinsics, depth_m)
        free = (planes.labels < 0) & np.isfinite(depth_m)
        points_m = depth_to_points(depth_m, intrinsics).astype(np.float64)
        found: list[ShapeGuess] = []
        while len(found) < 8 and free.sum() >= 0.001 * free.size:
            guess = self._largest(pyransac3d, points_m, free)
            if guess is None or guess.mask.sum() < 0.001 * free.size:
                break
            found.append(guess)
            free &= ~guess.mask
        return found

    def _largest(self, library: ModuleType, points_m: np.ndarray,
                 free: np.ndarray) -> ShapeGuess | None:
        cloud = points_m[free]
        thinned = cloud[::-(-len(cloud) // self._max_points)]
        centre, radius_m, _ = library.Sphere().fit(thinned, self._threshold_m, self._iterations)
        guesses = [self._guess(ShapeType.SPHERE, free, np.linalg.norm(cloud - centre, axis=1),
                               radius_m, np.zeros(3))] if len(centre) else []
        centre, axis, radius_m, _ = library.Cylinder().fit(thinned, self._threshold_m,
                                                           self._iterations)
        if len(centre):
            axis = np.asarray(axis, float) / np.linalg.norm(axis)
            away_m = np.linalg.norm(np.cross(cloud - centre, axis), axis=1)
            guesses.append(self._guess(ShapeType.CYLINDER, free, away_m, radius_m, axis))
        return max(guesses, key=lambda guess: guess.mask.sum(), default=None)

    def _guess(self, kind: ShapeType, free: np.ndarray, away_m: np.ndarray, radius_m: float,
               axis: np.ndarray) -> ShapeGuess:
        mask = free.copy()
        mask[free] = np.abs(away_m - radius_m) < self._threshold_m
        return ShapeGuess(kind, mask, float(radius_m), 0.0, axis)
