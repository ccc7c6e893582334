# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered rooms and other simple scenes with exact depth, labels and plane coefficients."""

from __future__ import annotations

import numpy as np

from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Rectangle,
    Scene,
    box,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.types import CameraIntrinsics


def random_room(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return a furnished room: boxes on the floor, cupboards and pictures on the walls."""
    return render(*furnished_room(rng), intrinsics, rng)


def furnished_room(rng: np.random.Generator) -> tuple[list[Rectangle], np.ndarray, np.ndarray]:
    """Return the rectangles of a room, and rotation (3, 3) and position (3,) of a camera in it."""
    size = rng.uniform([3.5, 4.0, 2.3], [7.0, 8.0, 3.2])
    position = np.append(rng.uniform(0.1, 0.9, 2) * size[:2], rng.uniform(0.9, 1.8))
    to_x, to_y = rng.uniform(0.3, 0.7, 2) * size[:2] - position[:2]
    rotation = camera_rotation(np.degrees(np.arctan2(-to_x, to_y)), rng.uniform(-25, 5),
                               rng.uniform(-4, 4))
    furniture: list[Rectangle] = []
    for _ in range(rng.integers(6, 16)):
        furniture += _furniture(rng, size, position)
    return box(size / 2, size) + furniture, rotation, position


def _furniture(rng: np.random.Generator, room: np.ndarray, camera: np.ndarray) -> list[Rectangle]:
    """Return a box away from the camera: free on the floor, at a wall, or hung on a wall."""
    while True:
        kind = rng.integers(3)
        side, end = rng.integers(2), rng.integers(2)
        size = rng.uniform([0.3, 0.3, 0.25], [1.4, 1.0, 1.4])
        center = np.append(rng.uniform(0.1, 0.9, 2) * room[:2], size[2] / 2)
        yaw_deg = rng.uniform(0, 90)
        if kind == 2:
            size[side], center[2] = rng.uniform(0.02, 0.4), rng.uniform(1.2, 1.7)
        if kind > 0:
            yaw_deg, center[side] = 0.0, size[side] / 2 + end * (room[side] - size[side])
        clear = np.linalg.norm(center[:2] - camera[:2]) > 0.6 + np.linalg.norm(size[:2]) / 2
        if clear:
            return box(center, size, yaw_deg)


def staircase(intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return stairs seen from the front: treads 0.3 m deep and risers 0.18 m high."""
    rise, run, width = np.array([0, 0, 0.18]), np.array([0, 0.3, 0]), np.array([4.0, 0, 0])
    faces = [rectangle([-2, -3, 0], width, [0, 5, 0])]
    for k in range(6):
        foot = np.array([-2.0, 2.0, 0.0]) + k * (rise + run)
        faces += [Rectangle(foot, width, rise), Rectangle(foot + rise, width, run)]
    return render(faces, camera_rotation(0, -20, 0), np.array([0, 0, 1.6]), intrinsics,
                  np.random.default_rng(0))


def single_wall(intrinsics: CameraIntrinsics = VGA, yaw_deg: float = 20.0,
                distance_m: float = 3.0) -> Scene:
    """Return one wall that fills the image, rotated by the yaw."""
    return render([rectangle([-500, distance_m, -500], [1000, 0, 0], [0, 0, 1000])],
                  camera_rotation(yaw_deg, 0, 0), np.zeros(3), intrinsics,
                  np.random.default_rng(0))


def attic(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return the empty space under a gable roof: a floor and two slopes of 30 to 55 degrees."""
    half, length = rng.uniform(2.0, 3.5), rng.uniform(4.0, 8.0)
    ridge = half * np.tan(np.radians(rng.uniform(30.0, 55.0)))
    across, along, up = [2 * half, 0, 0], [0, length, 0], [0, 0, ridge]
    faces = [rectangle(*vectors) for vectors in (
        ([0, 0, 0], across, along), ([0, 0, 0], across, up), (along, across, up),
        ([0, 0, 0], along, [half, 0, ridge]), (across, along, [-half, 0, ridge]))]
    position = np.array([rng.uniform(0.7, 1.3) * half, rng.uniform(0.15, 0.5) * length,
                         rng.uniform(0.3, 0.6) * ridge])
    rotation = camera_rotation(rng.uniform(-180, 180), rng.uniform(-15, 15), rng.uniform(-4, 4))
    return render(faces, rotation, position, intrinsics, rng)


def corridor(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return the view along a corridor of 9 to 16 m with a ceiling and a pillar."""
    width, length, height = rng.uniform(1.8, 3.0), rng.uniform(9.0, 16.0), rng.uniform(2.4, 3.0)
    faces = box(np.array([width, length, height]) / 2, np.array([width, length, height]))
    pillar_m, side = rng.uniform(3.0, 4.5), rng.uniform(0.35, 0.6)
    faces += box(np.array([width - side / 2, pillar_m, height / 2]),
                 np.array([side, side, height]))
    rotation = camera_rotation(rng.uniform(-14, 14), rng.uniform(-6, 3), rng.uniform(-2, 2))
    position = np.array([width * rng.uniform(0.35, 0.5), 0.4, rng.uniform(1.2, 1.6)])
    return render(faces, rotation, position, intrinsics, rng)


def hexagon_room(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return an empty hexagonal room: its walls meet at 120 degrees."""
    radius, height = rng.uniform(2.5, 4.5), np.array([0.0, 0.0, rng.uniform(2.3, 3.2)])
    angles = np.radians(60.0 * np.arange(7))
    corners = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(7)], axis=1)
    faces = [Rectangle(corners[k], corners[k + 1] - corners[k], height) for k in range(6)]
    faces += [rectangle([-radius, -radius, z], [2 * radius, 0, 0], [0, 2 * radius, 0])
              for z in (0.0, height[2])]
    position = np.append(rng.uniform(-0.4, 0.4, 2) * radius, rng.uniform(0.3, 1.8))
    rotation = camera_rotation(rng.uniform(-180, 180), rng.uniform(-25, 5), rng.uniform(-4, 4))
    return render(faces, rotation, position, intrinsics, rng)
