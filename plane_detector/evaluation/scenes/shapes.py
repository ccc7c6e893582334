# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rooms with balls, pipes, columns and cones, and with distractors of other shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Rectangle,
    Scene,
    box,
    camera_rotation,
    render,
)
from plane_detector.evaluation.scenes.surfaces import (
    Revolution,
    Thing,
    bar,
    cone,
    ellipsoid,
    sheet,
)
from plane_detector.geometry.projection import pixel_rays
from plane_detector.types import ShapeType

_ROOM_M = np.array([5.0, 7.0, 2.8])
_TEMPTATIONS = ('box', 'ellipsoid', 'curtain', 'torus')


@dataclass(frozen=True)
class SeenShape:
    """A shape and its visible pixels."""

    type: ShapeType
    # (3,) float64: centre, a point on the axis, or the apex, in the camera frame
    position_m: np.ndarray
    axis: np.ndarray  # (3,) float64: camera frame; zeros for a sphere
    radius_m: float  # 0 for a cone
    half_angle_rad: float
    mask: np.ndarray  # (H, W) bool


@dataclass(frozen=True)
class ShapeScene:
    """A rendered scene with its shapes; ``temptation`` names the distractor, if any."""

    scene: Scene
    shapes: tuple[SeenShape, ...]
    temptation: str


def shape_scene(rng: np.random.Generator) -> ShapeScene:
    """Return a room with one to five shapes, some half hidden, and often a distractor."""
    position = np.array([_ROOM_M[0] / 2, 0.3, rng.uniform(1.0, 1.6)])
    rotation = camera_rotation(rng.uniform(-10, 10), rng.uniform(-25, -8), rng.uniform(-5, 5))
    faces = box(_ROOM_M / 2, _ROOM_M)
    places = _places(rng)
    things = [_shape(rng, *places.pop()) for _ in range(rng.integers(1, 6))]
    temptation = rng.choice(_TEMPTATIONS) if rng.random() < 0.5 else ''
    tempting = _tempting(temptation, rng, *places.pop()) if temptation else Thing()
    hiding = _hiding(rng) if rng.random() < 0.4 else Thing()
    curved = [piece for thing in (*things, tempting) for piece in thing.curved_pieces()]
    scene = render([*faces, *tempting.flat, *hiding.flat], rotation, position, VGA, rng, curved)
    shapes = tuple(found for thing in things for piece in thing.curved
                   if (found := _truth(piece, scene, rotation, position)).mask.any())
    return ShapeScene(scene, shapes, temptation)


def _places(rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Return separate places on the floor: x, y and largest radius."""
    columns = np.linspace(1.0, 4.0, 3)
    places = [(x + rng.uniform(-0.2, 0.2), y + rng.uniform(-0.2, 0.2), 0.12 * y)
              for y in (1.9, 3.2, 4.7) for x in columns]
    rng.shuffle(places)
    return places


def _shape(rng: np.random.Generator, x: float, y: float, most_m: float) -> Thing:
    radius = float(np.exp(rng.uniform(np.log(max(0.03, 0.02 * y)), np.log(most_m))))
    kind = rng.integers(4)
    if kind == 0:
        return ellipsoid(radius, radius).at(x, y, radius + rng.choice([0.0, 0.8]))
    if kind == 1:
        return cone(radius, radius, 0.0, rng.uniform(0.6, 2.8)).at(x, y)
    if kind == 2:
        height, half = rng.uniform(0.2, 1.5), rng.uniform(0.4, 1.0)
        turn = rng.uniform(-0.6, 0.6)
        along = half * np.array([np.cos(turn), np.sin(turn), rng.uniform(-0.3, 0.3)])
        middle = np.array([x, y, height + radius])
        return bar(middle - along, middle + along, radius)
    height = radius * rng.uniform(1.5, 4.0)
    return cone(radius, 1e-3, 0.0, height).at(x, y)


def _tempting(kind: str, rng: np.random.Generator, x: float, y: float, most_m: float) -> Thing:
    """Return a distractor: a curved object or a box that is not a sphere, cylinder or cone."""
    size = 0.7 * most_m
    if kind == 'box':
        low = np.array([x - size, y - size, 0.0])
        return Thing(tuple(box(low + size, np.full(3, 2 * size), rng.uniform(0, 90))))
    if kind == 'ellipsoid':
        return ellipsoid(size, size * rng.choice([0.4, 0.5, 2.0, 2.5])).at(x, y, 2.5 * size)
    if kind == 'curtain':
        along = np.linspace(-1.2, 1.2, 1200)
        fold = 0.06 * np.sin(along * rng.uniform(18, 30))
        return sheet(np.column_stack([x + along, 6.7 + fold, np.full(along.size, 0.3)]),
                     np.array([0.0, 0.0, 2.0]))
    return Thing(curved=tuple(_torus(x, y, 1.2 * size, 0.5 * size)))


def _torus(x: float, y: float, ring_m: float, tube_m: float) -> list[Rectangle]:
    """Return a horizontal ring made of facets, each smaller than a few pixels."""
    u, v = (np.linspace(0, 2 * np.pi, count + 1) for count in (72, 36))
    away = ring_m + tube_m * np.cos(v)
    grid = np.stack([x + away * np.cos(u)[:, None], y + away * np.sin(u)[:, None],
                     np.broadcast_to(tube_m + tube_m * np.sin(v), (u.size, v.size))], axis=-1)
    facets = []
    for i in range(u.size - 1):
        for j in range(v.size - 1):
            corner, along = grid[i, j], grid[i + 1, j] - grid[i, j]
            across = grid[i, j + 1] - corner
            across -= (across @ along) / max(along @ along, 1e-12) * along
            facets.append(Rectangle(corner, along * 1.05, across * 1.05))
    return facets


def _hiding(rng: np.random.Generator) -> Thing:
    """Return a board that hides some of the shapes from the camera."""
    x, width = rng.uniform(1.2, 3.2), rng.uniform(0.15, 0.35)
    return Thing(tuple(box(np.array([x, 1.3, 0.5]), np.array([width, 0.02, 1.0]),
                           rng.uniform(-20, 20))))


def _truth(piece: Revolution, scene: Scene, rotation: np.ndarray,
           position: np.ndarray) -> SeenShape:
    ray_x, ray_y = (slopes.astype(np.float64) for slopes in pixel_rays(scene.intrinsics))
    z_m = piece.depth(ray_x, ray_y[:, None], rotation, position)
    mask = np.isfinite(z_m) & (np.abs(z_m - scene.depth_m) < 1e-5) & (scene.labels < 0)
    origin, axis = rotation.T @ (piece.origin - position), rotation.T @ piece.axis
    a, b, c = piece.squared_radius
    if c < 0:
        return SeenShape(ShapeType.SPHERE, origin, np.zeros(3), float(np.sqrt(a)), 0.0, mask)
    if c == 0:
        return SeenShape(ShapeType.CYLINDER, origin, axis, float(np.sqrt(a)), 0.0, mask)
    # r = sqrt(a) + slope * t is 0 at the apex; the axis points from there into the cone.
    slope = b / (2 * np.sqrt(a))
    apex = origin - np.sqrt(a) / slope * axis
    return SeenShape(ShapeType.CONE, apex, np.sign(slope) * axis, 0.0,
                     float(np.arctan(abs(slope))), mask)
