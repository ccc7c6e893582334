# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as surfaces to stand on: those that join the own floor, and the class of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.ground.along_ways import count_off_level
from plane_detector.planes.classification import PlaneClass, are_certain, classify_planes
from plane_detector.planes.history import PlaneHistory
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
# Borders are sampled at every fourth pixel; fewer joining samples are chance.
MIN_JOINS = 3
# Of every eighth pixel: the least number that determines the heights of a plane, and the share of
# them that may be off.
MIN_SAMPLES, STRAY_SHARE = 10, 0.05


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


def ground_planes(surfaces: Surfaces, own: int, above: np.ndarray, error: np.ndarray,
                  walkable: np.ndarray, joins: np.ndarray, flat: np.ndarray,
                  steps: np.ndarray, max_step: float
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the planes (K + 1,) that join the own floor, those at its level, and lower ones.

    ``flat`` planes are nowhere off its level by as much as an obstacle: pieces of a floor that a
    sensor bends, unless steps lead to them.
    """
    is_level = abs(surfaces.slopes_deg - surfaces.slopes_deg[own]) <= LEVEL_DEG
    # The error of a plane must not turn a level surface into a step, nor hide a step half as high
    # again.
    at_level = walkable & is_level & (
        abs(above) <= max_step + np.minimum(SIGMAS * error, 0.5 * max_step))
    at_level[own] = True
    joined, linked = at_level.copy(), joins >= MIN_JOINS
    while True:
        more = joined | (walkable & linked[joined].any(axis=0))
        more |= flat & ~(steps[joined] >= MIN_JOINS).any(axis=0)
        if (more == joined).all():
            return joined, at_level | joined & flat, walkable & ~joined & (above < -max_step)
        joined = more


def are_flat(seen: Seen, down: np.ndarray, point_m: np.ndarray, most_m: float,
             count: int) -> np.ndarray:
    """Return which planes (K + 1,) are within some height of the level of a point."""
    pixels, off = count_off_level(seen, down.astype(np.float32), point_m @ down, most_m, count + 1)
    return (pixels >= MIN_SAMPLES) & (off <= STRAY_SHARE * pixels)


def classes_of(found: PlaneSegmentation, surfaces: Surfaces, above: np.ndarray, joined: np.ndarray,
               at_level: np.ndarray, risers: np.ndarray, step_range_m: float,
               steepest_deg: float, own: int, past: PlaneHistory) -> np.ndarray:
    """Return the class of each plane (K,)."""
    classes = np.append(classify_planes(found.planes, surfaces.down, past),
                        np.uint8(PlaneClass.FLOOR))
    is_sure_slope = np.append(are_certain(found.planes, surfaces.down, steepest_deg, past),
                              True)
    slopes_deg = np.append(np.degrees(np.arccos(np.clip(-past.cosines, -1, 1))), 0.0)
    is_level = slopes_deg <= LEVEL_DEG - np.append(past.yields_deg(PlaneClass.RAMP), 0.0)
    # Steps are reached from the ground, or from other steps; without metres there are none.
    is_step, linked = joined.copy(), risers >= MIN_JOINS
    near = is_level & (abs(above) <= step_range_m)
    while (more := is_step | (near & linked[is_step].any(axis=0))).sum() > is_step.sum():
        is_step = more
    # A level plane is OTHER only if that is uncertain.
    classes[is_step & ~joined & (classes != PlaneClass.OTHER)] = PlaneClass.STEP
    classes[joined & ~at_level & ~is_level & is_sure_slope] = PlaneClass.RAMP
    # The surface under the robot is ground, however uncertain its orientation; so it is floor,
    # unless the image shows that it is more likely not level.
    known = np.append(found.planes.class_certainties, np.nan)[own]
    is_sure_slope[own] |= not known < 0.5
    classes[at_level & is_sure_slope] = PlaneClass.FLOOR
    return classes[:-1]
