# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered scenes by their seeds, and their depth with noise or seen by a sensor."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

from plane_detector.evaluation.metrics import MIN_PIXELS, overlap
from plane_detector.evaluation.scenes.living_rooms import living_room
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA, Rectangle, camera_rotation, render
from plane_detector.evaluation.scenes.rooms import Scene, random_room
from plane_detector.evaluation.scenes.sensors import SENSORS
from plane_detector.evaluation.scenes.surfaces import bar, cone, ellipsoid

RADII_M = (0.25, 0.4, 0.7, 1.2)
ANGLES_DEG = ((0, 0, 0), (0, -15, 4), (10, 10, 0))
"""Yaw, pitch and roll of the camera."""
CURVED = tuple(product(RADII_M, ANGLES_DEG, ('column', 'pipe', 'ball')))
"""Content of each curved scene."""
_FRONT_M, _WALL_M, _CAMERA_HEIGHT_M = 2.0, 4.0, 1.2


@lru_cache(maxsize=64)
def room(seed: int) -> Scene:
    """Return one room of boxes."""
    return random_room(np.random.default_rng(seed))


@lru_cache(maxsize=64)
def furnished(seed: int) -> Scene:
    """Return one lived-in room."""
    return living_room(np.random.default_rng(seed))


def curved_scene(index: int) -> Scene:
    """Return a wall and a floor with one of CURVED in front of them."""
    radius_m, angles_deg, kind = CURVED[index]
    vectors = [([-50, _WALL_M, -50], [100, 0, 0], [0, 0, 100]),
               ([-9, -1, -_CAMERA_HEIGHT_M], [18, 0, 0], [0, 9, 0])]
    flat = [Rectangle(*(np.array(vector, float) for vector in one)) for one in vectors]
    away_m = _FRONT_M + radius_m
    if kind == 'column':
        thing = cone(radius_m, radius_m, -3, 3).at(0, away_m)
    elif kind == 'pipe':
        thing = bar((-4, away_m, -0.3), (4, away_m, -0.3), radius_m)
    else:
        thing = ellipsoid(radius_m, radius_m).at(0, away_m)
    return render(flat, camera_rotation(*angles_deg), np.zeros(3), VGA,
                  np.random.default_rng(0), thing.curved_pieces())


def judge_curved(labels: np.ndarray, scene: Scene) -> tuple[float, float]:
    """Return the labelled share of the curved pixels, and the lowest IoU of a large true plane."""
    seen = np.isfinite(scene.depth_m)
    curved = seen & (scene.labels < 0)
    shared = overlap(scene.labels, labels, seen)
    large = shared.counts[:-1].sum(axis=1) > MIN_PIXELS
    best = shared.iou[large].max(axis=1, initial=0)
    return float((labels[curved] >= 0).mean()), float(best.min(initial=1))


def noisy_depth(scene: Scene, noise: float | str, seed: int) -> np.ndarray:
    """Return a scene's depth with disparity noise or as a sensor sees it, the same for a seed."""
    rng = np.random.default_rng([seed, 1])
    if isinstance(noise, str):
        return SENSORS[noise](scene.depth_m, scene.intrinsics, rng)
    return with_disparity_noise(scene.depth_m, noise, rng) if noise else scene.depth_m
