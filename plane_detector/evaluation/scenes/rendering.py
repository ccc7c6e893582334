# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendering of surfaces with exact depth, labels and plane coefficients.

A scene is a list of rectangles in a world with z up. Each pixel's ray is intersected with all of
them, and the nearest hit is used. Every rectangle is a separate plane, even if two are coplanar.
Curved surfaces can be added: they occlude planes and have no label.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from plane_detector.geometry.projection import pixel_rays
from plane_detector.types import CameraIntrinsics

VGA = CameraIntrinsics(525.0, 525.0, 319.5, 239.5, 640, 480)
# Columns: the axes x right, y down, z forward of a horizontal camera that looks along world y.
LEVEL_WORLD_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
NEAREST_M = 0.05
"""Nearer surfaces are not visible."""


@dataclass(frozen=True)
class Scene:
    """A rendered image with its ground truth; the arrays are read-only."""

    rgb: np.ndarray  # (H, W, 3) uint8
    depth_m: np.ndarray  # (H, W) float32: exact depth; NaN where the ray hits nothing
    labels: np.ndarray  # (H, W) int32: index into ``planes``, -1 for none
    # (N, 4) float64: unit normal pointing toward the camera and offset of every visible plane, in
    # the camera frame
    planes: np.ndarray
    intrinsics: CameraIntrinsics
    gravity_camera: np.ndarray  # (3,) float64: direction of gravity in the camera frame
    # (N,) int: index of each plane's rectangle in the rendered list, which identifies a
    # surface in images from several positions
    rectangles: np.ndarray
    height_m: float = 0.0  # height of the camera above z = 0, the floor of rooms

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False


class Surface(Protocol):
    """A surface that can be rendered."""

    def hull(self) -> np.ndarray:
        """Return points (K, 3) in the world whose convex hull contains the surface, metres."""

    def depth(self, ray_x: np.ndarray, ray_y: np.ndarray, world_from_camera: np.ndarray,
              position: np.ndarray) -> np.ndarray:
        """Return the depth (h, w) at which rays (w,), (h, 1) meet it; inf if they do not."""


@dataclass(frozen=True)
class Rectangle:
    """
    A corner and the two perpendicular edges that start there, metres.

    The mask, if any, returns which points of the rectangle exist, bool, from their coordinates
    along the edges, 0 to 1.
    """

    corner: np.ndarray
    edge_u: np.ndarray
    edge_v: np.ndarray
    mask: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def hull(self) -> np.ndarray:
        """Return the four corners."""
        far = self.corner + self.edge_u
        return np.array([self.corner, far, far + self.edge_v, self.corner + self.edge_v])

    def depth(self, ray_x: np.ndarray, ray_y: np.ndarray, world_from_camera: np.ndarray,
              position: np.ndarray) -> np.ndarray:
        """Return the depth at which each ray meets it; inf if it does not."""
        corner, edge_u, edge_v = self.in_camera(world_from_camera, position)
        plane = _plane_towards_camera(corner, edge_u, edge_v)
        with np.errstate(divide='ignore', invalid='ignore'):
            z_m = -plane[3] / (plane[0] * ray_x + plane[1] * ray_y + plane[2])
            along_u = _along(ray_x, ray_y, z_m, corner, edge_u)
            along_v = _along(ray_x, ray_y, z_m, corner, edge_v)
            hit = (z_m > NEAREST_M) & (abs(along_u - 0.5) <= 0.5) & (abs(along_v - 0.5) <= 0.5)
        if self.mask is not None:
            hit &= self.mask(along_u, along_v)
        return np.where(hit, z_m, np.inf)

    def in_camera(self, world_from_camera: np.ndarray, position: np.ndarray) -> list[np.ndarray]:
        """Return corner and edges in the camera frame."""
        return [world_from_camera.T @ (self.corner - position),
                *(world_from_camera.T @ edge for edge in (self.edge_u, self.edge_v))]


def rectangle(corner: Sequence[float], edge_u: Sequence[float], edge_v: Sequence[float],
              mask: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None) -> Rectangle:
    """Return the rectangle of three vectors given as any numbers."""
    return Rectangle(*(np.array(vector, float) for vector in (corner, edge_u, edge_v)), mask)


def camera_rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """Return world_from_camera (3, 3); positive yaw turns left, positive pitch looks up."""
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    about_up = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    about_z = np.array(
        [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return about_up @ LEVEL_WORLD_FROM_CAMERA @ about_x @ about_z


def box(center: np.ndarray, size: np.ndarray, yaw_deg: float = 0.0) -> list[Rectangle]:
    """Return the six faces of an upright box."""
    yaw = np.radians(yaw_deg)
    axes = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    edges = axes * np.asarray(size, float)[:, None]
    low = np.asarray(center, float) - edges.sum(axis=0) / 2
    faces = []
    for k in range(3):
        u, v = edges[(k + 1) % 3], edges[(k + 2) % 3]
        faces += [Rectangle(low, u, v), Rectangle(low + edges[k], u, v)]
    return faces


def render(rectangles: Sequence[Rectangle], world_from_camera: np.ndarray, position: np.ndarray,
           intrinsics: CameraIntrinsics, rng: np.random.Generator,
           curved: Sequence[Surface] = ()) -> Scene:
    """
    Intersect the ray of every pixel with every surface; the generator only affects the colours.

    Curved surfaces have depth but no label.
    """
    ray_x, ray_y = (slopes.astype(np.float64) for slopes in pixel_rays(intrinsics))
    shape = (intrinsics.height, intrinsics.width)
    depth_m = np.full(shape, np.inf, np.float64)
    surface = np.full(shape, -1, np.int32)
    planes = np.array([_plane_towards_camera(*rectangle.in_camera(world_from_camera, position))
                       for rectangle in rectangles]).reshape(-1, 4)
    for k, thing in enumerate([*rectangles, *curved]):
        window = rows, columns = _window((thing.hull() - position) @ world_from_camera, intrinsics)
        z_m = thing.depth(ray_x[columns], ray_y[rows, None], world_from_camera, position)
        nearer = z_m < depth_m[window]
        depth_m[window][nearer] = z_m[nearer]
        surface[window][nearer] = k if k < len(rectangles) else -1
    depth_m[np.isinf(depth_m)] = np.nan
    visible, labels = np.unique(surface, return_inverse=True)
    labels = labels.reshape(shape).astype(np.int32) - int(visible[0] < 0)
    visible = visible[visible >= 0]
    planes = planes[visible]
    return Scene(_colour(labels, planes, rng), depth_m.astype(np.float32), labels, planes,
                 intrinsics, world_from_camera.T @ np.array([0.0, 0.0, -1.0]), visible,
                 float(position[2]))


def _window(hull_camera_m: np.ndarray, intrinsics: CameraIntrinsics) -> tuple[slice, slice]:
    """Return the rows and columns whose rays can meet the hull."""
    is_before = hull_camera_m[:, 2] > NEAREST_M
    before, behind = hull_camera_m[is_before], hull_camera_m[~is_before]
    if not len(before):
        return slice(0), slice(0)
    # Points where lines from vertices before to vertices behind cross the nearest depth.
    lines = before[:, None] - behind
    passing = behind + lines * ((NEAREST_M - behind[:, 2]) / lines[..., 2])[..., None]
    x, y, z = np.vstack([before, passing.reshape(-1, 3)]).T
    columns = intrinsics.fx * x / z + intrinsics.cx
    rows = intrinsics.fy * y / z + intrinsics.cy
    return tuple(slice(*np.clip([np.floor(k.min()), np.ceil(k.max()) + 1], 0, size).astype(int))
                 for k, size in ((rows, intrinsics.height), (columns, intrinsics.width)))


def _plane_towards_camera(corner: np.ndarray, edge_u: np.ndarray, edge_v: np.ndarray):
    normal = np.cross(edge_u, edge_v)
    normal /= np.linalg.norm(normal)
    offset_m = -normal @ corner
    return np.append(normal, offset_m) * (1.0 if offset_m >= 0 else -1.0)


def _along(ray_x, ray_y, z_m, corner, edge) -> np.ndarray:
    """Return the coordinate of the hit along an edge, 0 to 1 inside."""
    along = edge / (edge @ edge)
    return z_m * (along[0] * ray_x + along[1] * ray_y + along[2]) - along @ corner


def _colour(labels: np.ndarray, planes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Give each plane a colour, with slight pixel noise so that no area is perfectly uniform."""
    colours = rng.uniform(60, 220, (len(planes) + 1, 3)).astype(np.float32)
    grain = rng.normal(0, 6, labels.shape).astype(np.float32)
    return np.clip(colours[labels] + grain[..., None], 0, 255).astype(np.uint8)
