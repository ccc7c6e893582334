# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sphere, cylinder and cone as one surface with eight parameters, and its geometry, compiled.

A shape is a row: position (3), unit axis (3), radius, half angle. The position is the centre of a
sphere, a point on the axis of a cylinder, or the apex of a cone, whose axis points from the apex
into the cone. Parameters that a kind does not have are 0. The surface of all three is the zero of

    distance = away cos(half angle) - along sin(half angle) - radius,

where ``along`` is the coordinate along the axis and ``away`` the distance from it. Shapes are
convex and seen from outside: normals point away from the axis.

References
----------
R. Schnabel, R. Wahl, R. Klein: Efficient RANSAC for Point-Cloud Shape Detection, 2007.

"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.types import ShapeType

POSITION, AXIS, RADIUS, HALF_ANGLE = np.s_[..., 0:3], np.s_[..., 3:6], np.s_[..., 6], np.s_[..., 7]
TINY = 1e-12
FREEDOMS = {ShapeType.SPHERE: np.array([0, 1, 2, 5]),
            ShapeType.CYLINDER: np.array([0, 1, 3, 4, 5]),
            ShapeType.CONE: np.array([0, 1, 2, 3, 4, 6])}
"""Fitted parameters of each kind, as indices of the seven steps of :func:`moved`."""
# after: the usual limit of three standard deviations.
DEVIATIONS = 3.0


class Surface(NamedTuple):
    """Points (N, 3) relative to a shape."""

    distance_m: np.ndarray  # (N,), positive outside
    normal: np.ndarray  # (N, 3), the gradient of the distance
    along_m: np.ndarray  # (N,) along the axis from the position; 0 for a sphere


def surface_of(shape: np.ndarray, points: np.ndarray) -> Surface:
    """Return points (N, 3) relative to a shape (8,)."""
    return Surface(*surface_at(shape, np.ascontiguousarray(points, float)))


@kernel('UniTuple(float64, 5)(float64[::1], float64, float64, float64)')
def about_axis(shape, x, y, z):
    """Return the coordinate along the axis (8,), the distance and the unit vector from it."""
    x, y, z = x - shape[0], y - shape[1], z - shape[2]
    along = x * shape[3] + y * shape[4] + z * shape[5]
    x, y, z = x - along * shape[3], y - along * shape[4], z - along * shape[5]
    away = np.sqrt(x * x + y * y + z * z)
    scale = 1 / max(away, TINY)
    return along, away, x * scale, y * scale, z * scale


@kernel('UniTuple(float64, 4)(float64[::1], UniTuple(float64, 2), float64, float64, float64)')
def distance_normal(shape, turn, x, y, z):
    """Return the distance of a point from a shape and its gradient; turn is :func:`turn_of`."""
    along, away, out_x, out_y, out_z = about_axis(shape, x, y, z)
    cosine, sine = turn
    return (away * cosine - along * sine - shape[6], cosine * out_x - sine * shape[3],
            cosine * out_y - sine * shape[4], cosine * out_z - sine * shape[5])


@kernel('UniTuple(float64, 2)(float64[::1])')
def turn_of(shape):
    """Return cosine and sine of the half angle of a shape (8,)."""
    return np.cos(shape[7]), np.sin(shape[7])


@kernel('Tuple((float64[::1], float64[:, ::1], float64[::1]))(float64[::1], float64[:, ::1])')
def surface_at(shape, points):
    """Return distances (N,), normals (N, 3) and axis coordinates (N,) of points (N, 3)."""
    turn, count = turn_of(shape), len(points)
    distance, normal, along = np.empty(count), np.empty((count, 3)), np.empty(count)
    for i in range(count):
        x, y, z = points[i]
        distance[i], normal[i, 0], normal[i, 1], normal[i, 2] = distance_normal(
            shape, turn, x, y, z)
        along[i] = about_axis(shape, x, y, z)[0]
    return distance, normal, along


@kernel('UniTuple(float64, 2)(float64[::1], UniTuple(float64, 2), UniTuple(float64, 3), '
        'UniTuple(float64, 2))')
def distance_deviation(shape, turn, point, noise):
    """
    Return the distance of a point from a shape and its standard deviation.

    Noise moves a point along its ray; the closer the ray is to a tangent, the less this changes
    the distance. Then the side of the pixel and the curvature dominate. The noise is the standard
    deviation of z, and the side of the pixel at z.
    """
    x, y, z = point
    along, away, out_x, out_y, out_z = about_axis(shape, x, y, z)
    cosine, sine = turn
    distance = away * cosine - along * sine - shape[6]
    outward = (out_x * x + out_y * y + out_z * z) / z
    facing = abs(cosine * outward - sine * (shape[3] * x + shape[4] * y + shape[5] * z) / z)
    slant2 = 1 - min(facing, 1.0) ** 2
    # A pixel of width w on a surface inclined by an angle covers w * tan(angle) of depth.
    spread2 = noise[1] * noise[1] * slant2 / 12
    # A change n of the depth also changes the distance by n^2 / 2 times the curvature along the
    # ray; for a normal variable the mean square of that factor is 3 / 4.
    bend = slant2 * noise[0] * noise[0] / max(away, TINY)
    return distance, np.sqrt((facing * noise[0]) ** 2 + spread2 + 0.75 * bend * bend)


@kernel('float64[:, ::1](float64[::1])')
def frame_of(shape):
    """Return an orthonormal frame (3, 3) with the axis of a shape (8,), if any, as last row."""
    x, y, z = shape[3], shape[4], shape[5]
    frame = np.eye(3)
    if x == 0 and y == 0 and z == 0:
        return frame
    side = np.hypot(x, y)
    if side > abs(z) / 2:
        frame[0] = np.array([-y / side, x / side, 0.0])
    else:
        side = np.hypot(y, z)
        frame[0] = np.array([0.0, z / side, -y / side])
    frame[1] = np.array([y * frame[0, 2] - z * frame[0, 1], z * frame[0, 0] - x * frame[0, 2],
                         x * frame[0, 1] - y * frame[0, 0]])
    frame[2] = shape[3:6]
    return frame


@kernel('float64[::1](float64[::1], float64[::1], float64[:, ::1])')
def moved(shape, steps, frame):
    """
    Return a shape (8,) moved by seven steps.

    These are three of the position along the rows of the frame, as returned by :func:`frame_of`,
    two of the axis towards its first two rows, the radius and the half angle.
    """
    result = shape.copy()
    for k in range(3):
        for row in range(3):
            result[k] += steps[row] * frame[row, k]
        result[3 + k] += steps[3] * frame[0, k] + steps[4] * frame[1, k]
    result[6] += steps[5]
    result[7] += steps[6]
    length = np.sqrt(result[3] ** 2 + result[4] ** 2 + result[5] ** 2)
    if length > TINY:
        result[3:6] /= length
    return result


@kernel('float64(float64[::1], UniTuple(float64, 2), float64, float64)')
def nearest_on_ray(shape, turn, ray_x, ray_y):
    """
    Return the depth at which a ray of depth 1 is closest to the surface, or deepest inside.

    Along the ray the distance is cos(half angle) sqrt(A t^2 + D) - sin(half angle) (E t + ...),
    with t measured from the point closest to the axis.
    """
    towards = ray_x * shape[3] + ray_y * shape[4] + shape[5]
    start = shape[0] * shape[3] + shape[1] * shape[4] + shape[2] * shape[5]
    across = ray_x * ray_x + ray_y * ray_y + 1 - towards * towards
    product = ray_x * shape[0] + ray_y * shape[1] + shape[2] - towards * start
    middle = product / max(across, TINY)
    square = shape[0] ** 2 + shape[1] ** 2 + shape[2] ** 2 - start * start - product * middle
    slope = turn[1] / turn[0] * towards
    if slope * slope >= across:  # steeper than the cone: enters its open end
        return middle
    return middle + slope * np.sqrt(max(square, 0.0) / (across * (across - slope * slope)))


def depths_on_rays(shape: np.ndarray, rays: np.ndarray,
                   ends: tuple[float, float] = (-np.inf, np.inf)) -> np.ndarray:
    """
    Return the depths (N,) at which rays, x and y at depth 1 (N, 2), meet a shape's near side.

    With w = z r - position and h = w . axis, all three are |w|^2 - k h^2 = radius^2: k is 0 for a
    sphere, 1 for a cylinder and 1 + tan^2 of the half angle for a cone. Rays that miss it, or
    meet it beyond its ends along the axis, get inf.
    """
    position, axis, factor = shape[POSITION], shape[AXIS], 1 + np.tan(shape[HALF_ANGLE]) ** 2
    towards, start = rays @ axis[:2] + axis[2], position @ axis
    square = (rays**2).sum(axis=1) + 1 - factor * towards**2
    half = rays @ position[:2] + position[2] - factor * towards * start
    rest = position @ position - factor * start**2 - shape[RADIUS] ** 2
    with np.errstate(invalid='ignore', divide='ignore'):
        root = np.sqrt(half**2 - square * rest)
        depth = np.stack([half + root, half - root]) / square
        along = depth * towards - start
        is_met = (depth > 0) & (along >= ends[0]) & (along <= ends[1])
    return np.where(is_met, depth, np.inf).min(axis=0)
