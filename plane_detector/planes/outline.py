# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Outlines of planes and their enclosing rectangles, in the frame of the camera or placed by its
pose.

Their corners are the intersections of the rays of pixels with the plane, so the depth noise of
single pixels does not move them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.rigid_transform import RigidTransform, quaternions
from plane_detector.plane_fields import Columns, Moves, Published, column
from plane_detector.planes.region_samples import MIN_COSINE
from plane_detector.types import CameraIntrinsics, Detection, Planes, Shape

_TOLERANCE_PX = 2.0
# derived: a smaller part or hole has no shape within the tolerance.
_SMALLEST_PX2 = _TOLERANCE_PX**2


@dataclass(frozen=True)
class Polygon:
    """One outline: corners (N, 3) on the plane, in order, the first one not repeated."""

    corners_m: np.ndarray
    is_hole: bool
    area_px: float = math.nan  # inside it in the image; NaN: not from one image


@dataclass(frozen=True)
class Rectangle:
    """A rectangle; the columns of its rotation are the directions of width, height and normal."""

    centre_m: np.ndarray
    rotation: np.ndarray
    width_m: float  # at least the height
    height_m: float


@dataclass(frozen=True, eq=False)
class Rectangles(Columns, Sequence[Rectangle]):
    """K rectangles as arrays; indexing and iteration give each."""

    # (K, 3), (K, 3, 3), (K,) and (K,), as of a rectangle.
    centres_m: np.ndarray = column(
        'centre_m', Published('rect_x rect_y rect_z'), unit='m', shape=(3,), moves=Moves.POINT,
        doc='centre of the smallest rectangle around all pixels of the plane')
    rotations: np.ndarray = column(
        'rotation', Published('rect_qx rect_qy rect_qz rect_qw', of=quaternions), shape=(3, 3),
        moves=Moves.ROTATION, doc='its orientation, a quaternion: x along the width, y along the '
                                  'height, z along the normal')
    widths_m: np.ndarray = column('width_m', Published('rect_width', 'width'), unit='m',
                                  doc='its longer side')
    heights_m: np.ndarray = column('height_m', Published('rect_height', 'height'), unit='m',
                                   doc='its shorter side')

    def __getitem__(self, index: int) -> Rectangle:
        return Rectangle(*self.row(index))


def all_polygons(labels: np.ndarray, ends: np.ndarray, intrinsics: CameraIntrinsics,
                 planes: Planes) -> tuple[tuple[Polygon, ...], ...]:
    """
    Return the outlines of each plane: of all its connected parts, and of the holes in them.

    A border is traced in the image and simplified to 2 pixels (Douglas and Peucker). Unlike a
    convex hull, this preserves the shape of an L-shaped floor.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``; -1, or another index, for no plane.
    ends : (K, H, 2) int32
        Of these labels, by :func:`row_ends`.
    intrinsics : CameraIntrinsics
        Of the image.
    planes : Planes

    Returns
    -------
    tuple of tuple of Polygon
        Of each plane the largest part first, each followed by its holes. Outlines of less than
        4 square pixels, and with fewer than three corners after simplification, are dropped.

    Examples
    --------
    >>> camera = CameraIntrinsics(100.0, 100.0, 0.0, 0.0, 101, 51)
    >>> from plane_detector.types import METRIC, Plane
    >>> wall = Plane(np.array([0.0, 0.0, -1.0]), 2.0, np.zeros(3), 1, 0.0, 1.0, np.eye(4), 1.0)
    >>> labels = np.zeros((51, 101), np.int32)
    >>> ((polygon,),) = all_polygons(labels, row_ends(labels, 1), camera, Planes.of([wall]))
    >>> polygon.corners_m[2]
    array([2., 1., 2.])

    """
    outlines = []
    for index, (top, bottom, left, right) in enumerate(_boxes(ends).tolist()):
        mask = labels[top:bottom, left:right] == index
        outlines.append(_simple_outlines(mask, (top, left)) if mask.size else [])
    corners_m = iter(_on_planes(
        [corners_px for of_plane in outlines for corners_px, *_ in of_plane],
        planes, np.repeat(np.arange(len(planes)), [len(one) for one in outlines]), intrinsics))
    return tuple(tuple(Polygon(next(corners_m), *others) for _, *others in of_plane)
                 for of_plane in outlines)


def _boxes(ends: np.ndarray) -> np.ndarray:
    """Return first row, last row + 1, first column, last column + 1 of each plane, (K, 4)."""
    has = ends[:, :, 1] >= 0
    top, bottom = has.argmax(axis=1), ends.shape[1] - has[:, ::-1].argmax(axis=1)
    left = np.where(has, ends[:, :, 0], np.iinfo(np.int32).max).min(axis=1)
    return np.column_stack([top, np.where(has.any(axis=1), bottom, top), left,
                            ends[:, :, 1].max(axis=1) + 1])


def _on_planes(pixels: Sequence[np.ndarray], planes: Planes, of_plane: np.ndarray,
               intrinsics: CameraIntrinsics) -> list[np.ndarray]:
    """Return the points (N, 3) where rays of pixels (N, 2), column and row, meet their planes."""
    if not pixels:
        return []
    counts = [len(one) for one in pixels]
    index = np.repeat(of_plane, counts)
    normals, offsets_m = planes.normals[index], planes.offsets_m[index]
    rays = np.ones((len(normals), 3))
    rays[:, :2] = ((np.concatenate(pixels) - [intrinsics.cx, intrinsics.cy])
                   / [intrinsics.fx, intrinsics.fy])
    facing = -(rays * normals).sum(axis=1)
    points_m = (offsets_m / np.maximum(facing, MIN_COSINE))[:, None] * rays
    # This changes only rays that see the plane edge-on.
    points_m -= ((points_m * normals).sum(axis=1) + offsets_m)[:, None] * normals
    return np.split(points_m, np.cumsum(counts)[:-1])


def enclosing_rectangles(ends: np.ndarray, intrinsics: CameraIntrinsics,
                         planes: Planes) -> Rectangles:
    """
    Return the smallest rectangle around the pixels of each plane, with their borders.

    Parameters
    ----------
    ends, intrinsics, planes
        As for :func:`all_polygons`.

    """
    camera = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    table = _rectangles(ends, planes.normals, planes.offsets_m, planes.centroids_m, camera)
    return Rectangles(table[:, :3].copy(), table[:, 3:12].reshape(-1, 3, 3).copy(),
                      table[:, 12].copy(), table[:, 13].copy())


def row_ends(labels: np.ndarray, count: int) -> np.ndarray:
    """Return the first and last pixel (K, H, 2) int32 of each label in each row, -1 for none."""
    return _row_ends(np.ascontiguousarray(labels, np.int32), count)


@kernel("int32[:, :, ::1](Array(int32, 2, 'C', readonly=True), int64)")
def _row_ends(labels, count):
    height, width = labels.shape
    ends = np.full((count, height, 2), np.int32(-1))
    for v in range(height):
        first = 0  # of a run of equal labels
        for u in range(width):
            label = labels[v, u]
            if u + 1 < width and labels[v, u + 1] == label:
                continue
            if 0 <= label < count:
                if ends[label, v, 0] < 0:
                    ends[label, v, 0] = first
                ends[label, v, 1] = u
            first = u + 1
    return ends


@kernel('float64[:, ::1](int32[:, :, ::1], float64[:, ::1], float64[::1], float64[:, ::1], '
        'UniTuple(float64, 4))', is_short=True)
def _rectangles(ends, normals, offsets_m, centroids_m, camera):
    """
    Return rectangles (K, 14): centre, rotation by rows, width and height.

    One side of the smallest rectangle lies on a side of the convex hull, which is convex on the
    plane as well as in the image. The centroid, which noise may move outside, is enclosed too.
    """
    table, flat_m = np.zeros((len(ends), 14)), np.empty((4 * ends.shape[1] + 1, 2))
    axes = np.empty((3, 3))
    for k in range(len(ends)):
        corners = _hull_px(ends[k])
        _set_axes_across(normals[k], axes)
        for i in range(len(corners)):
            x, y = (corners[i, 0] - camera[2]) / camera[0], (corners[i, 1] - camera[3]) / camera[1]
            facing = -(x * normals[k, 0] + y * normals[k, 1] + normals[k, 2])
            z_m = offsets_m[k] / max(facing, MIN_COSINE)
            for axis in range(2):
                flat_m[i, axis] = (axes[axis, 0] * (x * z_m - centroids_m[k, 0])
                                   + axes[axis, 1] * (y * z_m - centroids_m[k, 1])
                                   + axes[axis, 2] * (z_m - centroids_m[k, 2]))
        flat_m[len(corners)] = 0.0
        _write_smallest(flat_m[:len(corners) + 1], axes, centroids_m[k], table[k])
    return table


@kernel('void(float64[:, ::1], float64[:, ::1], float64[::1], float64[::1])')
def _write_smallest(flat_m, axes, origin_m, row):
    """Write the smallest rectangle around points (N, 2) in the axes of a plane."""
    best, count = np.inf, len(flat_m) - 1
    for i in range(max(count, 1)):
        x, y = flat_m[i]
        dx, dy = flat_m[(i + 1) % max(count, 1), 0] - x, flat_m[(i + 1) % max(count, 1), 1] - y
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = (dx / length, dy / length) if length > 0 else (1.0, 0.0)
        low_u = low_v = np.inf
        high_u = high_v = -np.inf
        for j in range(len(flat_m)):
            u, v = dx * flat_m[j, 0] + dy * flat_m[j, 1], dx * flat_m[j, 1] - dy * flat_m[j, 0]
            low_u, high_u = min(low_u, u), max(high_u, u)
            low_v, high_v = min(low_v, v), max(high_v, v)
        width, height = high_u - low_u, high_v - low_v
        if width * height >= best:
            continue
        best = width * height
        middle_u, middle_v = (low_u + high_u) / 2, (low_v + high_v) / 2
        is_wide = width >= height
        row[12], row[13] = max(width, height), min(width, height)
        for axis in range(3):
            along = dx * axes[0, axis] + dy * axes[1, axis]
            across = dx * axes[1, axis] - dy * axes[0, axis]
            row[axis] = origin_m[axis] + middle_u * along + middle_v * across
            row[3 + 3 * axis] = along if is_wide else across
            row[4 + 3 * axis] = across if is_wide else -along
            row[5 + 3 * axis] = axes[2, axis]


@kernel('void(float64[::1], float64[:, ::1])')
def _set_axes_across(normal, axes):
    """Write two unit vectors perpendicular to a unit one and to each other, and that one."""
    least = 0
    for axis in range(3):
        axes[2, axis] = normal[axis]
        least = axis if abs(normal[axis]) < abs(normal[least]) else least
    length = np.sqrt(1 - normal[least] ** 2)
    for axis in range(3):
        axes[0, axis] = ((1.0 if axis == least else 0.0) - normal[least] * normal[axis]) / length
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        axes[1, axis] = normal[i] * axes[0, j] - normal[j] * axes[0, i]


@kernel('float64[:, ::1](int32[:, ::1])')
def _hull_px(ends):
    """
    Return the convex hull (N, 2) of a plane's pixels with their borders, around it.

    The ends of the rows are sorted already (Andrew's monotone chain). First are the corners of the
    left side, downwards, then those of the right side, upwards.
    """
    corners, count, first = np.empty((4 * len(ends), 2)), 0, 0
    for side in range(2):
        first, turn = count, 1.0 - 2.0 * side
        for v in range(2 * len(ends)):
            if ends[v // 2, side] < 0:
                continue
            x, y = ends[v // 2, side] + side - 0.5, v // 2 + v % 2 - 0.5
            while count > first + 1:
                x0, y0 = corners[count - 2, 0], corners[count - 2, 1]
                if turn * ((corners[count - 1, 0] - x0) * (y - y0)
                           - (corners[count - 1, 1] - y0) * (x - x0)) < 0:
                    break
                count -= 1
            corners[count, 0], corners[count, 1], count = x, y, count + 1
    found = corners[:count].copy()
    for i in range(first, count):
        for axis in range(2):  # an assignment of an array takes three seconds to compile
            found[i, axis] = corners[count - 1 - (i - first), axis]
    return found


def _simple_outlines(mask: np.ndarray, first_pixel: tuple[int, int]
                     ) -> list[tuple[np.ndarray, bool, float]]:
    """Return corners (N, 2), column and row, whether it is a hole, and area, of each outline."""
    contours, hierarchy = cv2.findContours(
        np.ascontiguousarray(mask).view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE,
        offset=first_pixel[::-1])
    parents = hierarchy[0, :, 3].tolist()
    parts = [index if parent < 0 else parent for index, parent in enumerate(parents)]
    areas_px = [cv2.contourArea(contour) for contour in contours]
    order = sorted((index for index, area_px in enumerate(areas_px) if area_px >= _SMALLEST_PX2),
                   key=lambda index: (-areas_px[parts[index]], parts[index], parents[index] >= 0))
    simple = ((cv2.approxPolyDP(contours[index], _TOLERANCE_PX, True).reshape(-1, 2),
               parents[index] >= 0, areas_px[index]) for index in order)
    return [outline for outline in simple if len(outline[0]) > 2]


@dataclass(frozen=True)
class PlacedDetection:
    """
    A detection with the pose of its camera; what is derived is computed on first access.

    Without a pose, "placed" means in the frame of the image.

    Examples
    --------
    >>> from plane_detector.types import METRIC, Plane
    >>> wall = Plane(np.array([0, 0, -1.0]), 2.0, np.array([0, 0, 2.0]), 9, 0.0, 1.0, np.eye(4), 1)
    >>> found = Detection(Planes.of([wall]), np.zeros((3, 3), np.int32), 0.0,
    ...                   np.full((3, 3), 2.0, np.float32), METRIC)
    >>> forward = RigidTransform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    >>> placed = PlacedDetection(found, CameraIntrinsics(3.0, 3.0, 1.0, 1.0, 3, 3), forward)
    >>> placed.planes.centroids_m, [round(one.width_m, 3) for one in placed.rectangles]
    (array([[0., 0., 3.]]), [2.0])

    """

    detection: Detection  # in the frame of the image
    intrinsics: CameraIntrinsics  # of the image
    # From the frame of the image into another one; None: unknown, or the same.
    pose: RigidTransform | None = None
    stamp_s: float = float('nan')  # time of the image; NaN: unknown

    def placed(self, points_m: np.ndarray) -> np.ndarray:
        """Return points (..., 3) of the frame of the image, transformed by the pose."""
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
