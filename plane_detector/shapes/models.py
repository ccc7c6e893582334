# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sphere, cylinder and cone: from oriented points, to distances and their derivatives.

A shape is a row of eight parameters: position (3), unit axis (3), radius, half angle. The position
is the centre of a sphere, a point on the axis of a cylinder, or the apex of a cone, whose axis
points from the apex into the cone. Parameters that a kind does not have are 0. Shapes are convex
and seen from outside: normals point away from the axis.

References
----------
R. Schnabel, R. Wahl, R. Klein: Efficient RANSAC for Point-Cloud Shape Detection, 2007.

"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plane_detector.types import ShapeType

POSITION, AXIS, RADIUS, HALF_ANGLE = np.s_[..., 0:3], np.s_[..., 3:6], np.s_[..., 6], np.s_[..., 7]
_TINY = 1e-12


@dataclass(frozen=True)
class Surface:
    """
    Points (N, 3) as one shape sees them.

    Attributes
    ----------
    distance_m : (..., N) float64
        Signed distance from the surface, positive outside.
    normal : (..., N, 3) float64
        Gradient of the distance.
    along_m : (..., N) float64
        Way along the axis from the position; 0 for a sphere.

    """

    distance_m: np.ndarray
    normal: np.ndarray
    along_m: np.ndarray


@dataclass(frozen=True)
class ShapeModel:
    """
    One kind of shape.

    Attributes
    ----------
    type : ShapeType
    sample_size : int
        Oriented points that determine it.
    freedoms : int
        Parameters that are fitted: columns of the Jacobian.
    from_samples : callable
        Points and normals (H, sample_size, 3) to parameters (H, 8), NaN where degenerate.
    surface : callable
        Parameters (..., 8) and points (N, 3) to a :class:`Surface`.
    jacobian : callable
        Parameters (8,), points (N, 3) and the :func:`tangents` (2, 3) of its axis to the
        derivatives (N, freedoms) of the distance.
    moved : callable
        Parameters (8,), a step (freedoms,) and these tangents to parameters (8,).

    """

    type: ShapeType
    sample_size: int
    freedoms: int
    from_samples: Callable[[np.ndarray, np.ndarray], np.ndarray]
    surface: Callable[[np.ndarray, np.ndarray], Surface]
    jacobian: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    moved: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def tangents(axis: np.ndarray) -> np.ndarray:
    """Return two unit vectors (2, 3) square to an axis (3,) and to each other, or zeros."""
    if not axis.any():
        return np.zeros((2, 3))
    return np.linalg.svd(axis[None])[2][1:]


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > _TINY, length, np.nan)


def _packed(position: np.ndarray, axis: np.ndarray | float, radius: np.ndarray | float,
            half_angle: np.ndarray | float) -> np.ndarray:
    shapes = np.zeros((*position.shape[:-1], 8))
    shapes[POSITION], shapes[AXIS] = position, axis
    shapes[RADIUS], shapes[HALF_ANGLE] = radius, half_angle
    return shapes


def _radius_of_pair(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the radius (H,) for which points less radius times normals (H, 2, 3) coincide."""
    apart, turn = points[:, 0] - points[:, 1], normals[:, 0] - normals[:, 1]
    square = (turn**2).sum(axis=1)
    return (apart * turn).sum(axis=1) / np.where(square > _TINY, square, np.nan)


def _sphere_from_samples(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    radius = _radius_of_pair(points, normals)
    return _packed((points - radius[:, None, None] * normals).mean(axis=1), 0.0, radius, 0.0)


def _cylinder_from_samples(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    axis = _unit(np.cross(normals[:, 0], normals[:, 1]))
    along = (points * axis[:, None]).sum(axis=2, keepdims=True)
    radius = _radius_of_pair(points - along * axis[:, None], normals)
    on_axis = (points - radius[:, None, None] * normals).mean(axis=1)
    return _packed(on_axis, axis, radius, 0.0)


def _cone_from_samples(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    determinant = np.linalg.det(normals)
    regular = np.abs(determinant) > 1e-6
    system = np.where(regular[:, None, None], normals, np.eye(3))
    apex = np.linalg.solve(system, (normals * points).sum(axis=2)[..., None])[..., 0]
    sides = _unit(points - apex[:, None])
    axis = _unit(np.cross(sides[:, 0] - sides[:, 1], sides[:, 0] - sides[:, 2]))
    cosine = (sides * axis[:, None]).sum(axis=2).mean(axis=1)
    axis = axis * np.sign(cosine)[:, None]
    half_angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    return _packed(apex, axis, 0.0, np.where(regular, half_angle, np.nan))


def _sphere_surface(shapes: np.ndarray, points: np.ndarray) -> Surface:
    offset = points - shapes[..., None, 0:3]
    away = np.sqrt(np.einsum('...k,...k->...', offset, offset))
    normal = offset / np.maximum(away, _TINY)[..., None]
    return Surface(away - shapes[..., None, 6], normal, np.zeros_like(away))


def _about_axis(shapes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return way along the axis, distance from it (..., N) and unit vectors away from it."""
    offset, axis = points - shapes[..., None, 0:3], shapes[..., 3:6]
    along = np.einsum('...nk,...k->...n', offset, axis)
    across = offset - along[..., None] * axis[..., None, :]
    away = np.sqrt(np.einsum('...k,...k->...', across, across))
    return along, away, across / np.maximum(away, _TINY)[..., None]


def _cylinder_surface(shapes: np.ndarray, points: np.ndarray) -> Surface:
    along, away, outward = _about_axis(shapes, points)
    return Surface(away - shapes[..., None, 6], outward, along)


def _cone_surface(shapes: np.ndarray, points: np.ndarray) -> Surface:
    along, away, outward = _about_axis(shapes, points)
    cosine, sine = np.cos(shapes[..., None, 7]), np.sin(shapes[..., None, 7])
    normal = cosine[..., None] * outward - sine[..., None] * shapes[..., None, 3:6]
    return Surface(away * cosine - along * sine, normal, along)


def _sphere_jacobian(shape: np.ndarray, points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    normal = _sphere_surface(shape, points).normal
    return np.column_stack([-normal, -np.ones(len(points))])


def _cylinder_jacobian(shape: np.ndarray, points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    along, _, outward = _about_axis(shape, points)
    across = outward @ frame.T
    return np.column_stack([-across, -along[:, None] * across, -np.ones(len(points))])


def _cone_jacobian(shape: np.ndarray, points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    along, away, outward = _about_axis(shape, points)
    cosine, sine = np.cos(shape[HALF_ANGLE]), np.sin(shape[HALF_ANGLE])
    across = outward @ frame.T
    # Turning the axis changes both the way along it and the distance from it.
    turn = -(along * cosine + away * sine)[:, None] * across
    apex = -(cosine * outward - sine * shape[AXIS])
    return np.column_stack([apex, turn, -away * sine - along * cosine])


def _sphere_moved(shape: np.ndarray, step: np.ndarray, frame: np.ndarray) -> np.ndarray:
    return _packed(shape[POSITION] + step[:3], 0.0, shape[RADIUS] + step[3], 0.0)


def _cylinder_moved(shape: np.ndarray, step: np.ndarray, frame: np.ndarray) -> np.ndarray:
    return _packed(shape[POSITION] + step[:2] @ frame,
                   _unit(shape[AXIS] + step[2:4] @ frame), shape[RADIUS] + step[4], 0.0)


def _cone_moved(shape: np.ndarray, step: np.ndarray, frame: np.ndarray) -> np.ndarray:
    return _packed(shape[POSITION] + step[:3], _unit(shape[AXIS] + step[3:5] @ frame), 0.0,
                   shape[HALF_ANGLE] + step[5])


SPHERE = ShapeModel(ShapeType.SPHERE, 2, 4, _sphere_from_samples, _sphere_surface,
                    _sphere_jacobian, _sphere_moved)
CYLINDER = ShapeModel(ShapeType.CYLINDER, 2, 5, _cylinder_from_samples, _cylinder_surface,
                      _cylinder_jacobian, _cylinder_moved)
CONE = ShapeModel(ShapeType.CONE, 3, 6, _cone_from_samples, _cone_surface, _cone_jacobian,
                  _cone_moved)
MODELS = {model.type: model for model in (SPHERE, CYLINDER, CONE)}


def depth_on_rays_m(shape: np.ndarray, rays: np.ndarray,
                    along_m: tuple[float, float]) -> np.ndarray:
    """
    Return the depth (N,) at which rays of depth 1 meet the near side of a shape (8,), else inf.

    With w = z r - position and h = w . axis, all three are |w|^2 - k h^2 = radius^2: k is 0 for a
    sphere, 1 for a cylinder and 1 + tan^2 of the half angle for a cone.

    Parameters
    ----------
    shape : (8,) float64
    rays : (N, 3) float64
    along_m : (float, float)
        The ends along the axis; a sphere, which has no axis, is met anywhere.

    """
    position, axis = shape[POSITION], shape[AXIS]
    factor = 1 + np.tan(shape[HALF_ANGLE]) ** 2
    towards, start = rays @ axis, position @ axis
    square = np.einsum('nk,nk->n', rays, rays) - factor * towards**2
    half = rays @ position - factor * towards * start
    rest = position @ position - factor * start**2 - shape[RADIUS] ** 2
    nearest = np.full(len(rays), np.inf)
    with np.errstate(divide='ignore', invalid='ignore'):
        root = np.sqrt(half**2 - square * rest)
        for z_m in ((half + root) / square, (half - root) / square):
            way_m = z_m * towards - start
            hit = (z_m > 0) & (way_m >= along_m[0]) & (way_m <= along_m[1]) & (z_m < nearest)
            nearest[hit] = z_m[hit]
    return nearest
