# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Outlines of planes, projected onto the plane, and their enclosing rectangles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.types import CameraIntrinsics, Plane

_TOLERANCE_PX = 2.0


@dataclass(frozen=True)
class Polygon:
    """
    One outline of a plane.

    Attributes
    ----------
    corners_m : (N, 3) float64
        In order, on the plane; the first corner is not repeated.
    is_hole : bool

    """

    corners_m: np.ndarray
    is_hole: bool


@dataclass(frozen=True)
class Rectangle:
    """
    A rectangle in space.

    Attributes
    ----------
    centre_m : (3,) float64
    rotation : (3, 3) float64
        Its columns are the directions of width, height and normal.
    width_m, height_m : float
        The width is at least the height.

    """

    centre_m: np.ndarray
    rotation: np.ndarray
    width_m: float
    height_m: float


def all_polygons(labels: np.ndarray, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                 planes: Sequence[Plane]) -> tuple[tuple[Polygon, ...], ...]:
    """
    Return :func:`plane_polygons` of all planes of an image.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``; -1, or another index, for no plane.
    depth_m : (H, W) float32
        Depth.
    intrinsics : CameraIntrinsics
        Of the image.
    planes : sequence of Plane
        Planes that the outlines are projected onto.

    """
    labels = np.ascontiguousarray(labels, np.int32)
    boxes = _bounding_boxes(labels, len(planes)).tolist()
    outlines = [_simple_outlines(labels[top:bottom, left:right] == index, (top, left))
                if bottom > top else []
                for index, (top, bottom, left, right) in enumerate(boxes)]
    return _laid_onto(planes, outlines, depth_m, intrinsics)


def plane_polygons(mask: np.ndarray, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                   plane: Plane, first_pixel: tuple[int, int] = (0, 0)) -> tuple[Polygon, ...]:
    """
    Return the outlines of all connected parts of a plane, and of the holes in them.

    A border is traced in the image and simplified there to 2 pixels (Douglas and Peucker); the
    points of its corners are then projected onto the plane along the normal. Unlike a convex hull,
    this preserves the shape of an L-shaped floor.

    Parameters
    ----------
    mask : (h, w) bool
        Pixels of the plane, at least one, in a part of the image; their depth is valid.
    depth_m, intrinsics, plane
        As for :func:`all_polygons`.
    first_pixel : (int, int)
        Row and column of the image of the first pixel of the mask.

    Returns
    -------
    tuple of Polygon
        The largest part first, each followed by its holes. Outlines with fewer than three corners
        after simplification are dropped.

    Examples
    --------
    >>> camera = CameraIntrinsics(100.0, 100.0, 0.0, 0.0, 101, 51)
    >>> wall = Plane(np.array([0.0, 0.0, -1.0]), 2.0, np.zeros(3), 1, 0.0, 1.0, np.eye(4), 1.0)
    >>> mask = np.ones((51, 101), bool)
    >>> (polygon,) = plane_polygons(mask, 2.0 * mask, camera, wall)
    >>> polygon.corners_m[2]
    array([2., 1., 2.])

    """
    outlines = _simple_outlines(mask, first_pixel)
    return _laid_onto([plane], [outlines], depth_m, intrinsics)[0]


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


@kernel("int64[:, ::1](Array(int32, 2, 'C', readonly=True), int64)")
def _bounding_boxes(labels, count):
    """Return first row, row after the last, and the same of columns, of 0 to count - 1."""
    height, width = labels.shape
    boxes = np.zeros((count, 4), np.int64)
    for label in range(count):
        boxes[label, 0], boxes[label, 2] = height, width
    for v in range(height):
        first = 0  # of a run of equal labels
        for u in range(width):
            label = labels[v, u]
            if u + 1 < width and labels[v, u + 1] == label:
                continue
            if 0 <= label < count:
                box = boxes[label]
                box[0], box[1] = min(box[0], v), v + 1
                box[2], box[3] = min(box[2], first), max(box[3], u + 1)
            first = u + 1
    return boxes


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


def _laid_onto(planes: Sequence[Plane], outlines: Sequence[Sequence[tuple[np.ndarray, bool]]],
               depth_m: np.ndarray, intrinsics: CameraIntrinsics
               ) -> tuple[tuple[Polygon, ...], ...]:
    """Return the outlines of each plane in pixels, columns and rows, as polygons on the plane."""
    flat = [corners_px for of_plane in outlines for corners_px, _ in of_plane]
    if not flat:
        return ((),) * len(planes)
    counts = [sum(len(corners_px) for corners_px, _ in of_plane) for of_plane in outlines]
    column, row = np.concatenate(flat).T
    z_m = depth_m[row, column].astype(float)
    points_m = np.stack([(column - intrinsics.cx) / intrinsics.fx * z_m,
                         (row - intrinsics.cy) / intrinsics.fy * z_m, z_m], axis=-1)
    normals = np.repeat([plane.normal for plane in planes], counts, axis=0)
    offsets_m = np.repeat([plane.offset_m for plane in planes], counts)
    distances_m = (points_m * normals).sum(axis=1) + offsets_m
    laid_m = points_m - distances_m[:, None] * normals
    ends = itertools.accumulate(map(len, flat))
    corners_m = iter([laid_m[end - len(one):end] for one, end in zip(flat, ends, strict=True)])
    return tuple(tuple(Polygon(next(corners_m), is_hole) for _, is_hole in of_plane)
                 for of_plane in outlines)
