# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A plane of the map: heights with covariance over a frame, and its observed cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.mapping.cells import Cells, CellSums
from plane_detector.mapping.heights import PlaneFrames
from plane_detector.planes.outline import Polygon, Rectangles
from plane_detector.types import PlaneClass, Planes

CLASSES = len(PlaneClass)


@dataclass(frozen=True)
class MapPlane:
    """One surface of the map."""

    label: int  # above 0, never used again
    # Frame of the coefficients and cells, in the frame of the map; it never moves.
    origin_m: np.ndarray  # (3,) float64
    axes: np.ndarray  # (3, 3) float64: rows u, v and normal, which points to the observed side
    coefficients: np.ndarray  # (3,) float64: the height is a u + b v + c, metres
    covariance: np.ndarray  # (3, 3) float64
    cells: Cells
    views: int  # images in which it was detected
    first_seen_s: float
    last_seen_s: float
    first_image: int  # number of the image in which it was first detected
    votes: np.ndarray  # (CLASSES,) float64, weight of the images that gave it each class
    apart: frozenset[int] = frozenset()  # labels of planes that one image showed separately

    @property
    def plane_class(self) -> PlaneClass:
        """The class with the most votes."""
        return PlaneClass(int(np.argmax(self.votes)))

    @property
    def centroid_m(self) -> np.ndarray:
        """Mean of its cells, (3,), in the frame of the map."""
        return self.points(self.cells.centroid_m[None])[0]

    def points(self, flat_m: np.ndarray) -> np.ndarray:
        """Return points (N, 3) of the plane at coordinates u and v (N, 2)."""
        u, v = flat_m.T
        a, b, c = self.coefficients
        return self.origin_m + np.column_stack([u, v, a * u + b * v + c]) @ self.axes

    def flat(self, points_m: np.ndarray) -> np.ndarray:
        """Return the coordinates u and v (N, 2) of points (N, 3)."""
        return (points_m - self.origin_m) @ self.axes[:2].T


def polygons_of(plane: MapPlane) -> tuple[Polygon, ...]:
    """Return the outlines of a plane in the frame of the map, each followed by its holes."""
    return tuple(Polygon(plane.points(corners_m), is_hole)
                 for corners_m, is_hole in plane.cells.outlines)


def rectangles_of(planes: Sequence[MapPlane]) -> Rectangles:
    """Return the smallest rectangle around the cells of each plane, in the frame of the map."""
    normals = frames_of(planes).as_planes()[0]
    centres_m, rotations = np.zeros((len(planes), 3)), np.zeros((len(planes), 3, 3))
    sides_m = np.zeros((len(planes), 2))
    for k, plane in enumerate(planes):
        middle, sides, angle_deg = cv2.minAreaRect(plane.cells.hull_m().astype(np.float32))
        turn = np.radians(angle_deg + (0.0 if sides[0] >= sides[1] else 90.0))
        along = np.array([np.cos(turn), np.sin(turn)])
        centres_m[k], ahead_m = plane.points(np.array([middle, middle + along]))
        x_axis = ahead_m - centres_m[k]
        x_axis /= np.linalg.norm(x_axis)
        rotations[k] = np.column_stack([x_axis, np.cross(normals[k], x_axis), normals[k]])
        sides_m[k] = max(sides), min(sides)
    return Rectangles(centres_m, rotations, sides_m[:, 0], sides_m[:, 1])


def frames_of(planes: Sequence[MapPlane]) -> PlaneFrames:
    """Stack the frames of planes."""
    return PlaneFrames(np.array([plane.origin_m for plane in planes]).reshape(-1, 3),
                       np.array([plane.axes for plane in planes]).reshape(-1, 3, 3),
                       np.array([plane.coefficients for plane in planes]).reshape(-1, 3),
                       np.array([plane.covariance for plane in planes]).reshape(-1, 3, 3))


def as_planes(planes: Sequence[MapPlane]) -> Planes:
    """
    Return planes in the frame of the map as arrays.

    Counts are numbers of cells; the confidence is the share of their observations that were hits.
    """
    frames = frames_of(planes)
    normals, offsets_m, covariances = frames.as_planes()
    sums, centroids_m = centroids_of(planes, frames)
    sizes_m = np.array([plane.cells.size_m for plane in planes])
    votes = np.array([plane.votes for plane in planes]).reshape(-1, CLASSES)
    return Planes(
        normals, offsets_m, centroids_m, sums.cells,
        np.zeros(len(planes)), sums.cells * sizes_m**2, covariances,
        sums.hits / np.maximum(sums.looks, 1), classes=votes.argmax(axis=1).astype(np.uint8),
        labels=np.array([plane.label for plane in planes], np.int64))


def centroids_of(planes: Sequence[MapPlane], frames: PlaneFrames
                 ) -> tuple[CellSums, np.ndarray]:
    """Return :attr:`Cells.sums` of all planes, each (M,), and the means (M, 3) of the cells."""
    sums = CellSums(*np.array([plane.cells.sums for plane in planes],
                              np.int64).reshape(-1, len(CellSums._fields)).T)
    sizes_m = np.array([plane.cells.size_m for plane in planes])
    lows = np.array([plane.cells.low for plane in planes]).reshape(-1, 2)
    middles = np.ones((len(planes), 3))  # u, v and the height there
    middles[:, :2] = (np.stack([sums.columns, sums.rows]) / np.maximum(sums.cells, 1)).T
    middles[:, :2] = sizes_m[:, None] * (middles[:, :2] + lows + 0.5)
    middles[sums.cells == 0, :2] = 0.0
    middles[:, 2] = (frames.coefficients * middles).sum(axis=1)
    return sums, frames.origins_m + (middles[:, None] @ frames.axes)[:, 0]


def new_axes(normals: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return the axes (K, 3, 3) of planes; where a plane is upright, v points up."""
    across = up - (normals @ up)[:, None] * normals
    # chosen: of a level plane, within 20 degrees, v is along any axis of the map.
    level = (across * across).sum(axis=1) < 0.1
    helper = np.eye(3)[np.argmin(abs(normals[level]), axis=1)]
    across[level] = helper - (helper * normals[level]).sum(axis=1)[:, None] * normals[level]
    v = across / np.sqrt((across * across).sum(axis=1))[:, None]
    u = np.stack([v[:, 1] * normals[:, 2] - v[:, 2] * normals[:, 1],
                  v[:, 2] * normals[:, 0] - v[:, 0] * normals[:, 2],
                  v[:, 0] * normals[:, 1] - v[:, 1] * normals[:, 0]], axis=1)
    return np.stack([u, v, normals], axis=1)
