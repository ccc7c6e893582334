# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sphere, cylinder and cone as one surface with eight parameters.

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

from dataclasses import dataclass

import numpy as np

from plane_detector.shapes.surface import surface_at
from plane_detector.types import ShapeType

POSITION, AXIS, RADIUS, HALF_ANGLE = np.s_[..., 0:3], np.s_[..., 3:6], np.s_[..., 6], np.s_[..., 7]


@dataclass(frozen=True)
class Surface:
    """
    Points (N, 3) relative to a shape.

    Attributes
    ----------
    distance_m : (N,) float64
        Signed distance from the surface, positive outside.
    normal : (N, 3) float64
        Gradient of the distance.
    along_m : (N,) float64
        Coordinate along the axis from the position; 0 for a sphere.

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
    freedoms : tuple of int
        Fitted parameters, as indices of the seven steps of
        :func:`plane_detector.shapes.surface.moved`.

    """

    type: ShapeType
    freedoms: tuple[int, ...]


def surface_of(shape: np.ndarray, points: np.ndarray) -> Surface:
    """Return points (N, 3) relative to a shape (8,)."""
    return Surface(*surface_at(shape, np.ascontiguousarray(points, float)))


SPHERE = ShapeModel(ShapeType.SPHERE, (0, 1, 2, 5))
CYLINDER = ShapeModel(ShapeType.CYLINDER, (0, 1, 3, 4, 5))
CONE = ShapeModel(ShapeType.CONE, (0, 1, 2, 3, 4, 6))
MODELS = {model.type: model for model in (SPHERE, CYLINDER, CONE)}
