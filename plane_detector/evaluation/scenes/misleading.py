# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures whose lines and borders are not those of the scene: posters, stripes, false colours."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rendering import Scene
from plane_detector.geometry.projection import depth_to_points

Pattern = Callable[[np.random.Generator, np.ndarray, np.ndarray], np.ndarray]


def posters(rng: np.random.Generator, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the brightness of rectangles, each rotated by any angle in its plane."""
    grey = np.full(len(u), rng.uniform(70, 210))
    for _ in range(rng.integers(2, 6)):
        middle, angle = rng.integers(len(u)), rng.uniform(0, np.pi)
        across, along = rotated(u - u[middle], v - v[middle], angle)
        half = rng.uniform([0.15, 0.2], [0.6, 1.0])
        grey[(np.abs(across) < half[0]) & (np.abs(along) < half[1])] = rng.uniform(20, 240)
    return grey


def stripes(rng: np.random.Generator, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the brightness of stripes in any direction."""
    across = rotated(u, v, rng.uniform(0, np.pi))[0]
    return np.where(across % rng.uniform(0.2, 0.6) < 0.1, *rng.uniform([20, 140], [110, 240]))


def diagonal_tiles(rng: np.random.Generator, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the brightness of square tiles, laid at any angle."""
    size = rng.uniform(0.25, 0.6)
    across, along = rotated(u, v, rng.uniform(0, np.pi / 2))
    is_joint = (across % size < 0.03) | (along % size < 0.03)
    return np.where(is_joint, *rng.uniform([20, 140], [110, 240]))


PATTERNS: dict[str, Pattern] = {
    'posters': posters, 'stripes': stripes, 'diagonal tiles': diagonal_tiles}
FALSE_COLOURS = 'false colours'
KINDS = (*PATTERNS, FALSE_COLOURS)


def misleading_image(scene: Scene, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Return an image (H, W, 3) uint8 of a scene with exact depth; the kind is one of KINDS."""
    if kind == FALSE_COLOURS:
        return false_colours(scene.labels.shape, rng)
    points_m, grey = depth_to_points(scene.depth_m, scene.intrinsics), np.zeros(scene.labels.shape)
    for k, plane in enumerate(scene.planes):
        mask = scene.labels == k
        along = np.linalg.svd(plane[None, :3])[2][1:]
        grey[mask] = PATTERNS[kind](rng, *(along @ points_m[mask].T))
    grey = cv2.GaussianBlur(grey, (0, 0), 0.6)[..., None] + rng.normal(0, 3, (*grey.shape, 1))
    return np.clip(grey * rng.uniform(0.85, 1.0, 3), 0, 255).astype(np.uint8)


def false_colours(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return Voronoi cells of random places, each of one colour."""
    places = rng.uniform([0, 0], shape, (rng.integers(15, 40), 2))
    row, column = np.mgrid[:shape[0], :shape[1]]
    nearest = np.full(shape, np.inf)
    image = np.zeros((*shape, 3), np.uint8)
    for place in places:
        distance = (row - place[0]) ** 2 + (column - place[1]) ** 2
        image[distance < nearest] = rng.integers(0, 256, 3)
        nearest = np.minimum(distance, nearest)
    return image


def rotated(u: np.ndarray, v: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates in axes that are turned by an angle, radians."""
    return np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u
