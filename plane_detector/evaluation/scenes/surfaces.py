# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of rendered objects: flat faces, curved surfaces, and functions to place them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rendering import NEAREST_M, Rectangle, box

Mask = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Revolution:
    """
    A curved surface of revolution, open at both ends.

    The squared radius is a polynomial of the coordinate t along the axis, which covers cylinders,
    cones, spheres, ellipsoids and bowls.
    """

    origin: np.ndarray  # (3,) float64: point with t = 0, metres
    axis: np.ndarray  # (3,) float64: unit vector
    squared_radius: tuple[float, float, float]  # a, b, c of r**2 = a + b t + c t**2; metres
    low_m: float  # the smallest t
    high_m: float

    def hull(self) -> np.ndarray:
        """Return the corners of an enclosing box."""
        a, b, c = self.squared_radius
        turning = [-b / (2 * c)] if c else []
        ways = np.clip([self.low_m, self.high_m, *turning], self.low_m, self.high_m)
        radius = np.sqrt((a + b * ways + c * ways**2).max())
        across = np.linalg.svd(self.axis[None])[2][1:] * radius
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) @ across
        return np.vstack([self.origin + way * self.axis + corners
                          for way in (self.low_m, self.high_m)])

    def depth(self, ray_x: np.ndarray, ray_y: np.ndarray, world_from_camera: np.ndarray,
              position: np.ndarray) -> np.ndarray:
        """Return the depth at which each ray first meets it; inf if it does not."""
        origin = world_from_camera.T @ (self.origin - position)
        axis = world_from_camera.T @ self.axis
        a, b, c = self.squared_radius
        # At depth z the coordinate along the axis is t = z slope + start.
        slope, start = axis[0] * ray_x + axis[1] * ray_y + axis[2], -axis @ origin
        towards = origin[0] * ray_x + origin[1] * ray_y + origin[2]
        square = ray_x**2 + ray_y**2 + 1 - (1 + c) * slope**2
        half = -towards - slope * ((1 + c) * start + b / 2)
        rest = origin @ origin - (1 + c) * start**2 - b * start - a
        nearest = np.full(np.shape(slope), np.inf)
        with np.errstate(divide='ignore', invalid='ignore'):
            root = np.sqrt(half**2 - square * rest)
            for z_m in ((-half - root) / square, (-half + root) / square):
                way = z_m * slope + start
                hit = (z_m > NEAREST_M) & (way >= self.low_m) & (way <= self.high_m)
                nearest = np.where(hit & (z_m < nearest), z_m, nearest)
        return nearest


@dataclass(frozen=True)
class Sheet:
    """A curved sheet swept by a polyline (K, 3) along a perpendicular vector (3,), metres."""

    profile: np.ndarray
    extrusion: np.ndarray

    def hull(self) -> np.ndarray:
        """Return the points of both ends."""
        return np.vstack([self.profile, self.profile + self.extrusion])

    def strips(self) -> list[Rectangle]:
        """Return the flat pieces that represent it in rendering."""
        return [Rectangle(start, end - start, self.extrusion)
                for start, end in zip(self.profile[:-1], self.profile[1:], strict=True)]


@dataclass(frozen=True)
class Thing:
    """Flat faces, each a separate plane, and curved surfaces."""

    flat: tuple[Rectangle, ...] = ()
    curved: tuple[Revolution | Sheet, ...] = ()

    def __add__(self, other: Thing) -> Thing:
        return Thing(self.flat + other.flat, self.curved + other.curved)

    def turned(self, about: Sequence[float], angle_deg: float) -> Thing:
        """Rotate about an axis (3,) through the origin."""
        rotation = cv2.Rodrigues(np.radians(angle_deg) * np.asarray(about, float))[0]
        return self._moved(rotation, np.zeros(3))

    def at(self, x: float, y: float, z: float = 0.0, yaw_deg: float = 0.0) -> Thing:
        """Rotate about the z axis, then translate."""
        return self.turned((0, 0, 1), yaw_deg)._moved(np.eye(3), np.array([x, y, z]))

    def curved_pieces(self) -> list[Revolution | Rectangle]:
        """Return the curved surfaces in the form that is rendered."""
        return [piece for surface in self.curved for piece in (
            surface.strips() if isinstance(surface, Sheet) else [surface])]

    def bounds(self) -> np.ndarray:
        """Return the lowest and the highest coordinates, (2, 3)."""
        points = np.vstack([surface.hull() for surface in (*self.flat, *self.curved)])
        return np.array([points.min(0), points.max(0)])

    def _moved(self, rotation: np.ndarray, shift: np.ndarray) -> Thing:
        return Thing(*(tuple(_moved(surface, rotation, shift) for surface in surfaces)
                       for surfaces in (self.flat, self.curved)))


def _moved(surface: Rectangle | Revolution | Sheet, rotation: np.ndarray, shift: np.ndarray):
    if isinstance(surface, Rectangle):
        return replace(surface, corner=rotation @ surface.corner + shift,
                       edge_u=rotation @ surface.edge_u, edge_v=rotation @ surface.edge_v)
    if isinstance(surface, Sheet):
        return Sheet(surface.profile @ rotation.T + shift, rotation @ surface.extrusion)
    return replace(surface, origin=rotation @ surface.origin + shift, axis=rotation @ surface.axis)


def joined(*things: Thing) -> Thing:
    """Return several things combined into one."""
    return sum(things, Thing())


def block(low: Sequence[float], high: Sequence[float]) -> Thing:
    """Return a box between two opposite corners."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    return Thing(tuple(box((low + high) / 2, high - low)))


def panel(low: Sequence[float], high: Sequence[float], front: Mask) -> Thing:
    """Return a box whose front and back, the faces of constant y, are limited by a mask."""
    faces = list(block(low, high).flat)
    for k in (2, 3):
        faces[k] = replace(faces[k], mask=lambda along_z, along_x: front(along_x, along_z))
    return Thing(tuple(faces))


def outside(low: Sequence[float], high: Sequence[float]) -> Mask:
    """Return a mask that leaves a hole between these shares of the edges."""
    return partial(_is_outside, low, high)


def _is_outside(low: Sequence[float], high: Sequence[float], u: np.ndarray, v: np.ndarray
                ) -> np.ndarray:
    return ~((u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1]))


def disc(radius: float, z: float) -> Thing:
    """Return a horizontal disc about the z axis."""
    corner = np.array([-radius, -radius, z])
    edges = 2 * radius * np.eye(3)[:2]
    return Thing((Rectangle(corner, *edges, mask=lambda u, v: np.hypot(u - 0.5, v - 0.5) <= 0.5),))


def cone(low_radius: float, high_radius: float, low: float, high: float) -> Thing:
    """Return a vertical conical wall between two values of z."""
    growth = (high_radius - low_radius) / (high - low)
    return Thing(curved=(Revolution(
        np.array([0, 0, low]), np.eye(3)[2],
        (low_radius**2, 2 * low_radius * growth, growth**2), 0.0, high - low),))


def drum(radius: float, low: float, high: float) -> Thing:
    """Return a vertical cylinder with top and bottom."""
    return cone(radius, radius, low, high) + disc(radius, low) + disc(radius, high)


def ellipsoid(radius: float, half_height: float, share: float = 1.0) -> Thing:
    """Return an ellipsoid about the origin, flattened along z, or its lower share."""
    return Thing(curved=(Revolution(
        np.zeros(3), np.eye(3)[2], (radius**2, 0.0, -(radius / half_height) ** 2),
        -half_height, (2 * share - 1) * half_height),))


def bar(start: Sequence[float], end: Sequence[float], radius: float) -> Thing:
    """Return a round bar from one point to another, open at the ends."""
    start, along = np.asarray(start, float), np.subtract(end, start)
    length = float(np.linalg.norm(along))
    return Thing(curved=(Revolution(start, along / length, (radius**2, 0.0, 0.0), 0.0, length),))


def sheet(profile: np.ndarray, extrusion: np.ndarray) -> Thing:
    """Return a sheet; its strips should be at most a pixel wide, otherwise they are planes."""
    return Thing(curved=(Sheet(profile, extrusion),))


def bezier(controls: Sequence[Sequence[float]], pieces: int) -> np.ndarray:
    """Return points (pieces + 1, 3) of the cubic Bezier curve with these 4 control points."""
    t = np.linspace(0, 1, pieces + 1)[:, None]
    weights = np.hstack([(1 - t)**3, 3 * t * (1 - t)**2, 3 * t**2 * (1 - t), t**3])
    return weights @ np.asarray(controls, float)
