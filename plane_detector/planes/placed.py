# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What was found in an image, and where its camera was: for outputs and for a map of planes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.outline import (
    Polygon,
    Rectangles,
    all_polygons,
    enclosing_rectangles,
    row_ends,
)
from plane_detector.types import CameraIntrinsics, Detection, Planes, Shape


@dataclass(frozen=True)
class PlacedDetection:
    """
    A detection with the pose of its camera; what is derived is computed on first access.

    Without a pose, "placed" means in the frame of the image.

    Examples
    --------
    >>> from plane_detector.types import Plane
    >>> wall = Plane(np.array([0, 0, -1.0]), 2.0, np.array([0, 0, 2.0]), 9, 0.0, 1.0, np.eye(4), 1)
    >>> found = Detection(Planes.of([wall]), np.zeros((3, 3), np.int32), 0.0,
    ...                   np.full((3, 3), 2.0, np.float32), 'metric')
    >>> forward = RigidTransform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    >>> placed = PlacedDetection(found, CameraIntrinsics(3.0, 3.0, 1.0, 1.0, 3, 3), forward)
    >>> placed.planes.centroids_m, [round(one.width_m, 3) for one in placed.rectangles]
    (array([[0., 0., 3.]]), [2.0])

    """

    detection: Detection  # in the frame of the image
    intrinsics: CameraIntrinsics  # of the image
    # From the frame of the image into another one; None: not known, or the same.
    pose: RigidTransform | None = None
    stamp_s: float = float('nan')  # time of the image; NaN: not known

    def placed(self, points_m: np.ndarray) -> np.ndarray:
        """Return points (..., 3) of the frame of the image where the pose puts them."""
        return points_m if self.pose is None else self.pose.points(points_m)

    @cached_property
    def planes(self) -> Planes:
        """The planes, placed."""
        planes = self.detection.planes
        return planes if self.pose is None else planes.moved(self.pose)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes, placed."""
        if self.pose is None:
            return self.detection.shapes
        return tuple(replace(shape, position_m=self.pose.points(shape.position_m),
                             axis=self.pose.rotation @ shape.axis)
                     for shape in self.detection.shapes)

    @cached_property
    def camera_polygons(self) -> tuple[tuple[Polygon, ...], ...]:
        """Outlines of each plane in the frame of the image."""
        found = self.detection
        return all_polygons(found.labels, self._row_ends, self.intrinsics, found.planes)

    @cached_property
    def polygons(self) -> tuple[tuple[Polygon, ...], ...]:
        """Outlines of each plane, placed."""
        if self.pose is None:
            return self.camera_polygons
        return tuple(tuple(replace(polygon, corners_m=self.placed(polygon.corners_m))
                           for polygon in of_plane) for of_plane in self.camera_polygons)

    @cached_property
    def rectangles(self) -> Rectangles:
        """Smallest rectangle around the pixels of each plane, placed."""
        found = enclosing_rectangles(self._row_ends, self.intrinsics, self.detection.planes)
        return found if self.pose is None else found.moved(self.pose)

    @cached_property
    def _row_ends(self) -> np.ndarray:
        return row_ends(self.detection.labels, len(self.detection.planes))
