# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes that join the own floor, and the class of each plane."""

from __future__ import annotations

import numpy as np

from plane_detector.ground.along_ways import count_off_level
from plane_detector.ground.surfaces import LEVEL_DEG, SIGMAS, Surfaces
from plane_detector.planes.classification import PlaneClass, are_certain, classify_planes
from plane_detector.planes.history import PlaneHistory
from plane_detector.types import PlaneSegmentation

# Tuned by benchmark ground on seeds below 9000, unless derived or given by contract; nothing
# changes there from .7 to 1.4 times a value unless stated. Borders are sampled at every fourth
# pixel; fewer joining samples are chance.
MIN_JOINS = 3
# Of every eighth pixel: the least number that determines the heights of a plane, and the share of
# them that may be off.
MIN_SAMPLES, STRAY_SHARE = 10, 0.05


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


def are_flat(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
             down: np.ndarray, point_m: np.ndarray, most_m: float, count: int) -> np.ndarray:
    """Return which planes (K + 1,) are within some height of the level of a point."""
    pixels, off = count_off_level(depth_m, labels, *rays, down.astype(np.float32),
                                  point_m @ down, most_m, count + 1)
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
    is_level = slopes_deg <= LEVEL_DEG + np.append(past.yields_deg(PlaneClass.RAMP, -1), 0.0)
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
