# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sphere, cylinder and cone as one surface with eight parameters.

A shape is a row: position (3), unit axis (3), radius, half angle. The position is the centre of a
sphere, a point on the axis of a cylinder, or the apex of a cone, whose axis points from the apex
into the cone. Parameters that a kind does not have are 0; then all three are

    distance = away cos(half angle) - along sin(half angle) - radius,

with the way along the axis and the distance away from it. Shapes are convex and seen from outside:
normals point away from the axis.

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
# Below this the determinant of three unit normals says that they lie in a plane.
_MIN_DETERMINANT = 1e-6


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
    freedoms : tuple of int
        What is fitted, of the seven steps of :func:`moved`.
    from_samples : callable
        Points and normals (H, sample_size, 3) to parameters (H, 8), NaN where degenerate.

    """

    type: ShapeType
    sample_size: int
    freedoms: tuple[int, ...]
    from_samples: Callable[[np.ndarray, np.ndarray], np.ndarray]


def surface_of(shapes: np.ndarray, points: np.ndarray) -> Surface:
    """Return how points (N, 3) lie to shapes (..., 8)."""
    along, away, outward = _about_axis(shapes, points)
    cosine, sine = np.cos(shapes[..., None, 7]), np.sin(shapes[..., None, 7])
    normal = cosine[..., None] * outward - sine[..., None] * shapes[..., None, 3:6]
    return Surface(away * cosine - along * sine - shapes[..., None, 6], normal, along)


def frame_of(shape: np.ndarray) -> np.ndarray:
    """Return an orthonormal frame (3, 3) whose last row is the axis of a shape (8,), if any."""
    axis = shape[AXIS]
    if not axis.any():
        return np.eye(3)
    return np.vstack([np.linalg.svd(axis[None])[2][1:], axis])


def moved(shape: np.ndarray, steps: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """
    Return a shape (8,) moved by seven steps.

    Parameters
    ----------
    shape : (8,) float64
    steps : (7,) float64
        Three of the position along the rows of the frame, two of the axis along the first two
        rows, the radius and the half angle.
    frame : (3, 3) float64
        Of :func:`frame_of`.

    """
    result = shape + np.concatenate([steps[:3] @ frame, steps[3:5] @ frame[:2], steps[5:]])
    length = np.linalg.norm(result[AXIS])
    result[AXIS] /= length if length > _TINY else 1.0
    return result


def jacobian(shape: np.ndarray, points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, 7) of the distances of points with respect to :func:`moved`."""
    along, away, outward = _about_axis(shape, points)
    cosine, sine = np.cos(shape[HALF_ANGLE]), np.sin(shape[HALF_ANGLE])
    position = -(cosine * outward - sine * shape[AXIS]) @ frame.T
    # Turning the axis changes both the way along it and the distance from it.
    turn = -(along * cosine + away * sine)[:, None] * (outward @ frame[:2].T)
    return np.column_stack([position, turn, np.full(len(points), -1.0),
                            -away * sine - along * cosine])


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
    regular = np.abs(determinant) > _MIN_DETERMINANT
    system = np.where(regular[:, None, None], normals, np.eye(3))
    apex = np.linalg.solve(system, (normals * points).sum(axis=2)[..., None])[..., 0]
    sides = _unit(points - apex[:, None])
    axis = _unit(np.cross(sides[:, 0] - sides[:, 1], sides[:, 0] - sides[:, 2]))
    cosine = (sides * axis[:, None]).sum(axis=2).mean(axis=1)
    axis = axis * np.sign(cosine)[:, None]
    half_angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    return _packed(apex, axis, 0.0, np.where(regular, half_angle, np.nan))


def _about_axis(shapes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return way along the axis, distance from it (..., N) and unit vectors away from it."""
    offset, axis = points - shapes[..., None, 0:3], shapes[..., 3:6]
    along = np.einsum('...nk,...k->...n', offset, axis)
    across = offset - along[..., None] * axis[..., None, :]
    away = np.sqrt(np.einsum('...k,...k->...', across, across))
    return along, away, across / np.maximum(away, _TINY)[..., None]


SPHERE = ShapeModel(ShapeType.SPHERE, 2, (0, 1, 2, 5), _sphere_from_samples)
CYLINDER = ShapeModel(ShapeType.CYLINDER, 2, (0, 1, 3, 4, 5), _cylinder_from_samples)
CONE = ShapeModel(ShapeType.CONE, 3, (0, 1, 2, 3, 4, 6), _cone_from_samples)
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
