# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The outlines of a plane's pixels, laid onto the plane, and the rectangle around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from plane_detector.types import CameraIntrinsics, Plane

_TOLERANCE_PX = 2.0


@dataclass(frozen=True)
class Polygon:
    """
    One outline of a plane.

    Attributes
    ----------
    corners_m : (N, 3) float64
        In order, on the plane; the first one is not repeated.
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
        Its columns are the directions of the width, of the height and of the normal.
    width_m, height_m : float
        The width is not the smaller one.

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
        Where the outlines are laid.

    """
    boxes = ndimage.find_objects(labels + 1, len(planes))
    return tuple(() if box is None else plane_polygons(
        labels[box] == index, depth_m, intrinsics, plane, (box[0].start, box[1].start))
        for index, (plane, box) in enumerate(zip(planes, boxes, strict=True)))


def plane_polygons(mask: np.ndarray, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                   plane: Plane, first_pixel: tuple[int, int] = (0, 0)) -> tuple[Polygon, ...]:
    """
    Return the outlines of all patches of a plane, and of the holes in them.

    A border is followed in the image and simplified there to 2 pixels (Douglas and Peucker); then
    the points of its corners are brought onto the plane along the normal. Unlike a convex hull it
    keeps an L-shaped floor L-shaped.

    Parameters
    ----------
    mask : (h, w) bool
        The plane's pixels, at least one, in a part of the image; their depth is valid.
    depth_m, intrinsics, plane
        As for :func:`all_polygons`.
    first_pixel : (int, int)
        Row and column of the image where the mask begins.

    Returns
    -------
    tuple of Polygon
        The largest patch first, each followed by its holes. What has fewer than three corners,
        once it is simplified, is left out.

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
    if not outlines:
        return ()
    corners_m = _corners_on_plane(np.concatenate([corners_px for corners_px, _ in outlines]),
                                  depth_m, intrinsics, plane)
    starts = np.cumsum([len(corners_px) for corners_px, _ in outlines])[:-1]
    return tuple(Polygon(of_one, is_hole) for of_one, (_, is_hole) in zip(
        np.split(corners_m, starts), outlines, strict=True))


def enclosing_rectangle(corners_m: np.ndarray, normal: np.ndarray,
                        centroid_m: np.ndarray) -> Rectangle:
    """
    Return the smallest rectangle around points on a plane.

    Parameters
    ----------
    corners_m : (N, 3) float64
        At least one.
    normal : (3,) float64
        Of the plane, unit.
    centroid_m : (3,) float64
        A point of the plane.

    """
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    across = _cross(normal, helper)
    across /= np.linalg.norm(across)
    axes = np.stack([across, _cross(normal, across)])
    flat_m = ((corners_m - centroid_m) @ axes.T).astype(np.float32)
    centre_m, (width_m, height_m), angle_deg = cv2.minAreaRect(flat_m)
    turn = np.radians(angle_deg + (0.0 if width_m >= height_m else 90.0))
    x_axis = np.array([np.cos(turn), np.sin(turn)]) @ axes
    return Rectangle(centroid_m + np.asarray(centre_m) @ axes,
                     np.stack([x_axis, _cross(normal, x_axis), normal], axis=1),
                     max(width_m, height_m), min(width_m, height_m))


def _simple_outlines(mask: np.ndarray, first_pixel: tuple[int, int]
                     ) -> list[tuple[np.ndarray, bool]]:
    """Return corners (N, 2), column and row, and whether it is a hole, of each outline."""
    contours, hierarchy = cv2.findContours(
        np.ascontiguousarray(mask).view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE,
        offset=first_pixel[::-1])
    parents = hierarchy[0, :, 3].tolist()
    patches = [index for index, parent in enumerate(parents) if parent < 0]
    patches.sort(key=lambda index: -cv2.contourArea(contours[index]))
    order = [index for patch in patches for index in
             (patch, *(hole for hole, parent in enumerate(parents) if parent == patch))]
    simple = ((cv2.approxPolyDP(contours[index], _TOLERANCE_PX, True).reshape(-1, 2),
               parents[index] >= 0) for index in order)
    return [(corners_px, is_hole) for corners_px, is_hole in simple if len(corners_px) > 2]


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the cross product of two vectors (3,), without the overhead of numpy's."""
    (a, b, c), (d, e, f) = first.tolist(), second.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])


def _corners_on_plane(corners_px: np.ndarray, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                      plane: Plane) -> np.ndarray:
    """Return pixels (N, 2), column and row, as points (N, 3) brought onto the plane."""
    column, row = corners_px.T
    z_m = depth_m[row, column].astype(float)
    points_m = np.stack([(column - intrinsics.cx) / intrinsics.fx * z_m,
                         (row - intrinsics.cy) / intrinsics.fy * z_m, z_m], axis=-1)
    return points_m - np.outer(points_m @ plane.normal + plane.offset_m, plane.normal)
