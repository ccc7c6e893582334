# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops over points that lie about one shape: distances, derivatives, rays."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel

TINY = 1e-12


@kernel('UniTuple(float64, 5)(float64[::1], float64, float64, float64)')
def about_axis(shape, x, y, z):
    """Return way along the axis of a shape (8,), distance from it and unit vector away from it."""
    x, y, z = x - shape[0], y - shape[1], z - shape[2]
    along = x * shape[3] + y * shape[4] + z * shape[5]
    x, y, z = x - along * shape[3], y - along * shape[4], z - along * shape[5]
    away = np.sqrt(x * x + y * y + z * z)
    scale = 1 / max(away, TINY)
    return along, away, x * scale, y * scale, z * scale


@kernel('UniTuple(float64, 4)(float64[::1], float64, float64, float64, float64, float64)')
def distance_normal(shape, cosine, sine, x, y, z):
    """Return the distance of a point from a shape and its gradient."""
    along, away, out_x, out_y, out_z = about_axis(shape, x, y, z)
    return (away * cosine - along * sine - shape[6], cosine * out_x - sine * shape[3],
            cosine * out_y - sine * shape[4], cosine * out_z - sine * shape[5])


@kernel('Tuple((float64[::1], float64[:, ::1], float64[::1]))(float64[::1], float64[:, ::1])')
def surface_at(shape, points):
    """Return distances (N,), normals (N, 3) and ways along the axis (N,) of points (N, 3)."""
    cosine, sine = np.cos(shape[7]), np.sin(shape[7])
    count = len(points)
    distance, normal, along = np.empty(count), np.empty((count, 3)), np.empty(count)
    for i in range(count):
        x, y, z = points[i]
        distance[i], normal[i, 0], normal[i, 1], normal[i, 2] = distance_normal(
            shape, cosine, sine, x, y, z)
        along[i] = about_axis(shape, x, y, z)[0]
    return distance, normal, along


@kernel('UniTuple(float64, 2)(float64[::1], float64, float64, float64, float64, float64, '
        'float64, float64)')
def distance_deviation(shape, cosine, sine, ray_x, ray_y, z, sigma, pixel):
    """
    Return the distance of a point from a shape and its standard deviation.

    Parameters
    ----------
    shape : (8,) float64
    cosine, sine : float
        Of its half angle.
    ray_x, ray_y, z : float
        The point is z (ray_x, ray_y, 1).
    sigma, pixel : float
        Deviation of z and side of the pixel at z.

    """
    distance, n_x, n_y, n_z = distance_normal(shape, cosine, sine, ray_x * z, ray_y * z, z)
    facing = abs(n_x * ray_x + n_y * ray_y + n_z)
    # A pixel of width w, seen at an angle, spans w * tan(angle) of depth.
    spread2 = pixel * pixel * (1 - min(facing, 1.0) ** 2) / 12
    return distance, np.sqrt((facing * sigma) ** 2 + spread2)


@kernel('UniTuple(float64[::1], 2)(float64[::1], float64[:, ::1], float64[:, ::1], float64[::1], '
        'float64[::1])')
def distances_deviations(shape, points, rays, sigma, pixel):
    """Return the distances (N,) of points (N, 3) on rays (N, 3) and their deviations (N,)."""
    cosine, sine = np.cos(shape[7]), np.sin(shape[7])
    distance, deviation = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        distance[i], deviation[i] = distance_deviation(
            shape, cosine, sine, rays[i, 0], rays[i, 1], points[i, 2], sigma[i], pixel[i])
    return distance, deviation


@kernel('float64[::1](float64[::1], float64[::1], float64[:, ::1])')
def moved(shape, steps, frame):
    """
    Return a shape (8,) moved by seven steps.

    Parameters
    ----------
    shape : (8,) float64
    steps : (7,) float64
        Three of the position along the rows of the frame, two of the axis along the first two
        rows, the radius and the half angle.
    frame : (3, 3) float64
        Of :func:`plane_detector.shapes.models.frame_of`.

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


@kernel('float64[::1](float64[::1], float64[:, ::1], float64[::1])')
def weighted_distances(shape, points, weight):
    """Return the distances (N,) of points (N, 3) from a shape (8,), times a weight (N,)."""
    cosine, sine = np.cos(shape[7]), np.sin(shape[7])
    result = np.empty(len(points))
    for i in range(len(points)):
        along, away, _, _, _ = about_axis(shape, points[i, 0], points[i, 1], points[i, 2])
        result[i] = (away * cosine - along * sine - shape[6]) * weight[i]
    return result


@kernel('float64[:, ::1](float64[::1], float64[:, ::1], float64[::1], float64[:, ::1])')
def weighted_jacobian(shape, points, weight, frame):
    """Return the derivatives (7, N) of weighted distances with respect to :func:`moved`."""
    cosine, sine = np.cos(shape[7]), np.sin(shape[7])
    result = np.empty((7, len(points)))
    for i in range(len(points)):
        along, away, x, y, z = about_axis(shape, points[i, 0], points[i, 1], points[i, 2])
        w = weight[i]
        n_x, n_y = cosine * x - sine * shape[3], cosine * y - sine * shape[4]
        n_z = cosine * z - sine * shape[5]
        # Turning the axis changes both the way along it and the distance from it.
        lever = -(along * cosine + away * sine) * w
        for k in range(3):
            result[k, i] = -(n_x * frame[k, 0] + n_y * frame[k, 1] + n_z * frame[k, 2]) * w
        for k in range(2):
            result[3 + k, i] = lever * (x * frame[k, 0] + y * frame[k, 1] + z * frame[k, 2])
        result[5, i] = -w
        result[6, i] = -(away * sine + along * cosine) * w
    return result


@kernel('float64[::1](float64[::1], int64[::1], float64[::1], float64[:, ::1])')
def stepped(values, freedoms, start, frame):
    """Return a shape (8,) moved by the steps (F,) that have these numbers (F,)."""
    steps = np.zeros(7)
    for k in range(len(freedoms)):
        steps[freedoms[k]] = values[k]
    return moved(start, steps, frame)


@kernel('float64[::1](float64[::1], int64[::1], float64[::1], float64[:, ::1], float64[:, ::1], '
        'float64[::1])')
def stepped_distances(values, freedoms, start, frame, points, weight):
    """Return the weighted distances (N,) of points (N, 3) from a shape after :func:`stepped`."""
    return weighted_distances(stepped(values, freedoms, start, frame), points, weight)


@kernel('float64[:, ::1](float64[::1], int64[::1], float64[::1], float64[:, ::1], '
        'float64[:, ::1], float64[::1])')
def stepped_jacobian(values, freedoms, start, frame, points, weight):
    """Return their derivatives (F, N) with respect to the steps (F,)."""
    whole = weighted_jacobian(stepped(values, freedoms, start, frame), points, weight, frame)
    return whole[freedoms]


@kernel('float64(float64[::1], float64, float64, float64, float64)')
def depth_on_ray(shape, ray_x, ray_y, low, high):
    """
    Return the depth at which a ray of depth 1 meets the near side of a shape (8,), else inf.

    With w = z r - position and h = w . axis, all three are |w|^2 - k h^2 = radius^2: k is 0 for a
    sphere, 1 for a cylinder and 1 + tan^2 of the half angle for a cone. The ends along the axis
    are low and high; a sphere, which has no axis, is met anywhere.
    """
    factor = 1 + np.tan(shape[7]) ** 2
    x, y, z = shape[0], shape[1], shape[2]
    towards = ray_x * shape[3] + ray_y * shape[4] + shape[5]
    start = x * shape[3] + y * shape[4] + z * shape[5]
    square = ray_x * ray_x + ray_y * ray_y + 1 - factor * towards * towards
    half = ray_x * x + ray_y * y + z - factor * towards * start
    rest = x * x + y * y + z * z - factor * start * start - shape[6] ** 2
    inside = half * half - square * rest
    nearest = np.inf
    if inside < 0 or square == 0:
        return nearest
    root = np.sqrt(inside)
    for z_m in ((half + root) / square, (half - root) / square):
        way = z_m * towards - start
        if z_m > 0 and way >= low and way <= high and z_m < nearest:
            nearest = z_m
    return nearest


@kernel('float64[::1](float64[::1], float64[:, ::1], float64, float64)')
def depth_on_rays_m(shape, rays, low, high):
    """Return the depths (N,) of :func:`depth_on_ray` on rays (N, 3)."""
    result = np.empty(len(rays))
    for i in range(len(rays)):
        result[i] = depth_on_ray(shape, rays[i, 0], rays[i, 1], low, high)
    return result
