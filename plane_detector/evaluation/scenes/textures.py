# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendered scenes with straight lines in their images: planks, tiles, doors and picture frames.

Lines are horizontal or along the steepest direction of each plane. Images are rendered at twice
the size and reduced, so that edges are as smooth as those of a camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Rectangle,
    Scene,
    camera_rotation,
    render,
)
from plane_detector.evaluation.scenes.rooms import furnished_room
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

MakeScene = Callable[[np.random.Generator, CameraIntrinsics], Scene]
_LEVEL_COSINE = 0.95
_GRAIN, _BLUR_PX = 3.0, 0.6


def textured(make: MakeScene, seed: int, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return a scene with lines in its image; ``make`` must draw geometry before colours."""
    double = CameraIntrinsics(2 * intrinsics.fx, 2 * intrinsics.fy, 2 * intrinsics.cx + 0.5,
                              2 * intrinsics.cy + 0.5, 2 * intrinsics.width,
                              2 * intrinsics.height)
    rng = np.random.default_rng([seed, 1])
    fine = make(np.random.default_rng(seed), double)
    grey = _paint(fine, rng)
    size = intrinsics.width, intrinsics.height
    grey = cv2.GaussianBlur(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), (0, 0), _BLUR_PX)
    tint = rng.uniform(0.85, 1.0, 3)
    rgb = grey[..., None] * tint + rng.normal(0, _GRAIN, (*grey.shape, 1))
    return replace(make(np.random.default_rng(seed), intrinsics),
                   rgb=np.clip(rgb, 0, 255).astype(np.uint8))


def rolled_room(rng: np.random.Generator, intrinsics: CameraIntrinsics) -> Scene:
    """Return a furnished room seen by a camera rolled by 10 degrees."""
    rectangles, rotation, position = furnished_room(rng)
    roll = camera_rotation(0, 0, 0).T @ camera_rotation(0, 0, 10)
    return render(rectangles, rotation @ roll, position, intrinsics, rng)


def room_from_above(rng: np.random.Generator, intrinsics: CameraIntrinsics) -> Scene:
    """Return a furnished room seen by a camera that looks straight down, within 8 degrees."""
    rectangles, _, position = furnished_room(rng)
    rotation = camera_rotation(rng.uniform(-180, 180), -90 + rng.uniform(-8, 8),
                               rng.uniform(-8, 8))
    return render(rectangles, rotation, [*position[:2], 2.0], intrinsics, rng)


def ramp_room(rng: np.random.Generator, intrinsics: CameraIntrinsics) -> Scene:
    """Return a furnished room whose floor is inclined by 8 degrees, with vertical walls."""
    rectangles, rotation, position = furnished_room(rng)
    ramp = rectangles[4]
    rise = np.array([0.0, 0.0, np.tan(np.radians(8.0)) * np.linalg.norm(ramp.edge_v)])
    rectangles[4] = Rectangle(ramp.corner - rise / 2, ramp.edge_u, ramp.edge_v + rise)
    return render(rectangles, rotation, position, intrinsics, rng)


def clutter(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> np.ndarray:
    """Return an image (H, W, 3) uint8 of strokes in all directions over blurred noise."""
    shape = (intrinsics.height, intrinsics.width)
    image = cv2.GaussianBlur(rng.normal(0, 1, shape).astype(np.float32), (0, 0), 12.0)
    image = 120 + 40 * image / image.std()
    for _ in range(rng.integers(150, 400)):
        start = rng.uniform([0, 0], shape[::-1])
        angle, length = rng.uniform(0, np.pi), rng.uniform(20, 140)
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(image, *(tuple(int(round(16 * c)) for c in point) for point in (start, end)),
                 float(rng.uniform(20, 235)), int(rng.integers(1, 5)), cv2.LINE_AA, 4)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, _GRAIN, shape)
    return np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _paint(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """Return the brightness (H, W) float32."""
    points_m = depth_to_points(scene.depth_m, scene.intrinsics)
    grey = np.full(scene.labels.shape, 128.0, np.float32)
    upright = _upright_normal(scene)
    for k, plane in enumerate(scene.planes):
        mask = scene.labels == k
        base = rng.uniform(70, 210)
        along = _level_direction(plane[:3], scene.gravity_camera, upright)
        across = np.cross(plane[:3], along)
        u, v = points_m[mask] @ along, points_m[mask] @ across
        is_level = abs(plane[:3] @ scene.gravity_camera) > _LEVEL_COSINE
        paint = _floor if is_level else _wall
        grey[mask] = base + (paint(u, v, rng) if mask.mean() > 0.03 else 0.0)
    return grey


def _upright_normal(scene: Scene) -> np.ndarray:
    """Return the normal of the largest vertical plane; without one, the camera's view."""
    upright = np.abs(scene.planes[:, :3] @ scene.gravity_camera) < 0.05
    if not upright.any():
        return np.array([0.0, 0.0, 1.0])
    pixels = np.bincount(scene.labels[scene.labels >= 0], minlength=len(scene.planes)) * upright
    return scene.planes[pixels.argmax(), :3]


def _level_direction(normal: np.ndarray, down: np.ndarray, upright: np.ndarray) -> np.ndarray:
    level = np.cross(normal, down)
    if np.linalg.norm(level) < np.sqrt(1 - _LEVEL_COSINE**2):
        level = upright - (upright @ normal) * normal
    return level / np.linalg.norm(level)


def _floor(u: np.ndarray, v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return planks along u, or tiles."""
    spacing, joint = rng.uniform(0.12, 0.5), 0.012
    dark = ((v + rng.uniform()) % spacing) < joint
    if rng.integers(2):
        dark |= ((u + rng.uniform()) % spacing) < joint
    shade = rng.uniform(-8, 8, 64)[np.floor(v / spacing).astype(int) % 64]
    return shade - 50.0 * dark


def _wall(u: np.ndarray, v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return doors and frames: vertical rectangles of different brightness."""
    change = np.zeros(len(u), np.float32)
    for _ in range(rng.integers(2, 6)):
        middle = rng.integers(len(u))
        half = rng.uniform([0.15, 0.2], [0.6, 1.0])
        inside = (np.abs(u - u[middle]) < half[0]) & (np.abs(v - v[middle]) < half[1])
        change[inside] = rng.uniform(-60, 60)
    return change
