# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Outlines of planes and their enclosing rectangles.

Their corners are where the rays of pixels meet the plane, which the noise of the depth of a single
pixel does not move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.planes.region_samples import MIN_COSINE
from plane_detector.types import CameraIntrinsics, Planes

_TOLERANCE_PX = 2.0


@dataclass(frozen=True)
class Polygon:
    """One outline: corners (N, 3) on the plane, in order, the first one not repeated."""

    corners_m: np.ndarray
    is_hole: bool


@dataclass(frozen=True)
class Rectangle:
    """A rectangle; the columns of its rotation are the directions of width, height and normal."""

    centre_m: np.ndarray
    rotation: np.ndarray
    width_m: float  # at least the height
    height_m: float


def all_polygons(labels: np.ndarray, ends: np.ndarray, intrinsics: CameraIntrinsics,
                 planes: Planes) -> tuple[tuple[Polygon, ...], ...]:
    """
    Return the outlines of each plane: of all its connected parts, and of the holes in them.

    A border is traced in the image and simplified there to 2 pixels (Douglas and Peucker). Unlike
    a convex hull, this preserves the shape of an L-shaped floor.

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
        Of each plane the largest part first, each followed by its holes. Outlines with fewer than
        three corners after simplification are dropped.

    Examples
    --------
    >>> camera = CameraIntrinsics(100.0, 100.0, 0.0, 0.0, 101, 51)
    >>> from plane_detector.types import Plane
    >>> wall = Plane(np.array([0.0, 0.0, -1.0]), 2.0, np.zeros(3), 1, 0.0, 1.0, np.eye(4), 1.0)
    >>> labels = np.zeros((51, 101), np.int32)
    >>> ((polygon,),) = all_polygons(labels, row_ends(labels, 1), camera, Planes.of([wall]))
    >>> polygon.corners_m[2]
    array([2., 1., 2.])

    """
    outlines = []
    for index, of_plane in enumerate(ends):
        rows = np.flatnonzero(of_plane[:, 1] >= 0)
        if not len(rows):
            outlines.append([])
            continue
        top, bottom, left = int(rows[0]), rows[-1] + 1, int(of_plane[rows, 0].min())
        mask = labels[top:bottom, left:of_plane[rows, 1].max() + 1] == index
        outlines.append(_simple_outlines(mask, (top, left)))
    corners_m = iter(_on_planes(
        [corners_px for of_plane in outlines for corners_px, _ in of_plane],
        planes, np.repeat(np.arange(len(planes)), [len(one) for one in outlines]), intrinsics))
    return tuple(tuple(Polygon(next(corners_m), is_hole) for _, is_hole in of_plane)
                 for of_plane in outlines)


def hulls(ends: np.ndarray, intrinsics: CameraIntrinsics,
          planes: Planes) -> list[np.ndarray]:
    """
    Return the corners (N, 3) of the convex hull of the pixels of each plane, with their borders.

    Parameters
    ----------
    ends, intrinsics, planes
        As for :func:`all_polygons`.

    """
    return _on_planes([_hull_px(of_plane) for of_plane in ends], planes,
                      np.arange(len(planes)), intrinsics)


def _on_planes(pixels: Sequence[np.ndarray], planes: Planes, of_plane: np.ndarray,
               intrinsics: CameraIntrinsics) -> list[np.ndarray]:
    """Return where the rays of pixels (N, 2), column and row, meet the plane of each, (N, 3)."""
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
    # No change but for rays that see the plane edge-on.
    points_m -= ((points_m * normals).sum(axis=1) + offsets_m)[:, None] * normals
    return np.split(points_m, np.cumsum(counts)[:-1])


def enclosing_rectangle(corners_m: np.ndarray, normal: np.ndarray,
                        centroid_m: np.ndarray) -> Rectangle:
    """
    Return the smallest rectangle around points on a plane.

    Parameters
    ----------
    corners_m : (N, 3) float64
        At least one.
    normal : (3,) float64
        Unit normal of the plane.
    centroid_m : (3,) float64
        A point of the plane.

    """
    across, along = _axes_across(normal.tolist())
    axes = np.array([across, along])
    flat_m = ((corners_m - centroid_m) @ axes.T).astype(np.float32)
    (x_m, y_m), (width_m, height_m), angle_deg = cv2.minAreaRect(flat_m)
    turn = math.radians(angle_deg + (0.0 if width_m >= height_m else 90.0))
    x_axis = [math.cos(turn) * a + math.sin(turn) * b for a, b in zip(across, along, strict=True)]
    y_axis = _cross(normal.tolist(), x_axis)
    return Rectangle(centroid_m + [x_m, y_m] @ axes, np.array([x_axis, y_axis, normal]).T,
                     max(width_m, height_m), min(width_m, height_m))


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


@kernel('float64[:, ::1](int32[:, ::1])', is_short=True)
def _hull_px(ends):
    """
    Return the convex hull (N, 2) of a plane's pixels with their borders, column and row.

    The ends of the rows are sorted already (Andrew's monotone chain). First are the corners of the
    left side, downwards, then those of the right side, downwards too.
    """
    corners, count = np.empty((4 * len(ends), 2)), 0
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
    return corners[:count].copy()


def _simple_outlines(mask: np.ndarray, first_pixel: tuple[int, int]
                     ) -> list[tuple[np.ndarray, bool]]:
    """Return corners (N, 2), column and row, and whether it is a hole, of each outline."""
    contours, hierarchy = cv2.findContours(
        np.ascontiguousarray(mask).view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE,
        offset=first_pixel[::-1])
    parents = hierarchy[0, :, 3].tolist()
    families = {index: [index] for index, parent in enumerate(parents) if parent < 0}
    for index, parent in enumerate(parents):
        if parent >= 0:
            families[parent].append(index)
    patches = sorted(families, key=lambda index: -cv2.contourArea(contours[index]))
    order = [index for patch in patches for index in families[patch]]
    simple = ((cv2.approxPolyDP(contours[index], _TOLERANCE_PX, True).reshape(-1, 2),
               parents[index] >= 0) for index in order if len(contours[index]) > 2)
    return [(corners_px, is_hole) for corners_px, is_hole in simple if len(corners_px) > 2]


def _axes_across(normal: list[float]) -> tuple[list[float], list[float]]:
    """Return two unit vectors that are perpendicular to a unit one and to each other."""
    helper = [0.0, 0.0, 0.0]
    helper[min(range(3), key=lambda axis: abs(normal[axis]))] = 1.0
    across = _cross(normal, helper)
    length = math.hypot(*across)
    across = [value / length for value in across]
    return across, _cross(normal, across)


def _cross(first: list[float], second: list[float]) -> list[float]:
    """Return the cross product of two vectors (3,); faster than numpy.cross."""
    (a, b, c), (d, e, f) = first, second
    return [b * f - c * e, c * d - a * f, a * e - b * d]
