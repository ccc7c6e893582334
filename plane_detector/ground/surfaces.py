# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes of an image as surfaces to stand on, and their visible parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.types import PlaneSegmentation

# Tuned by benchmark ground on seeds below 9000, unless derived or given by contract; nothing
# changes there from .7 to 1.4 times a value unless stated.
# Slopes within the accuracy of an IMU or of a level plane count as level.
LEVEL_DEG = 3.0
# chosen: a slope that is steeper by the error of gravity and of the plane is still within
# max_slope.
SLOPE_MARGIN_DEG = 1.0
# A difference counts beyond this many standard deviations. With 2, less of a far level behind a
# ramp is ground; with 4, half as much again of the obstacles is.
SIGMAS = 3.0
Seen = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]
"""Depth and labels (H, W) of an image, slopes of the rays of its columns and rows."""


@dataclass(frozen=True)
class Surfaces:
    """Planes as surfaces to stand on; the last one is level, at the height of the camera."""

    normals: np.ndarray  # (K + 1, 3)
    offsets: np.ndarray  # (K + 1,)
    covariances: np.ndarray  # (K + 1, 4, 4)
    centroids: np.ndarray  # (K + 1, 3)
    # (K + 1,) float64: cosine of the angle between their upper side and the vertical, and this
    # angle; above 90 for what faces down
    uprights: np.ndarray
    slopes_deg: np.ndarray
    down: np.ndarray  # (3,) float64

    @classmethod
    def of(cls, found: PlaneSegmentation, down: np.ndarray, height_m: float) -> Surfaces:
        """Collect the planes of an image."""
        planes = found.planes
        normals = np.concatenate([planes.normals, -down[None]])
        uprights = -normals @ down
        return cls(normals, np.concatenate([planes.offsets_m, [height_m]]),
                   np.concatenate([planes.covariances, np.zeros((1, 4, 4))]),
                   np.concatenate([planes.centroids_m, height_m * down[None]]),
                   uprights, np.degrees(np.arccos(uprights.clip(-1, 1))), down)

    def heights(self) -> np.ndarray:
        """Return the height (K + 1,) of the camera over each plane, infinite over walls."""
        return self.offsets / np.maximum(self.uprights, 1e-9)

    def above(self, own: int) -> tuple[np.ndarray, np.ndarray]:
        """Return height and error (K + 1,) of each plane's centroid over one of them."""
        points = np.column_stack([self.centroids, np.ones(len(self.offsets))])
        heights = ((self.centroids @ self.normals[own] + self.offsets[own])
                   / max(self.uprights[own], 1e-9))
        variances = (np.einsum('ki,kij,kj->k', points, self.covariances, points)
                     + np.einsum('ki,ij,kj->k', points, self.covariances[own], points))
        return heights, np.sqrt(np.maximum(variances, 0.0))

    def table(self) -> np.ndarray:
        """Return the rows (K + 1, 5) of the compiled loops, see `along_ways`."""
        inverse = 1 / np.maximum(self.uprights, 1e-6)
        return np.column_stack([self.normals * inverse[:, None], self.offsets * inverse,
                                inverse]).astype(np.float32)
