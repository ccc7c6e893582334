# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The data of the search for shapes, and compiled loops over the pixels of cells.

To the loops the image is given as the depth (H, W), the plane of each pixel (H, W), -1 for none,
and a mask (K + 1,) of planes that may be replaced; its last entry is for -1. The camera is given
as fx, fy, cx, cy, standard deviation of 1/depth, smallest standard deviation of depth, side of a
cell in pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.shapes.fitting import FittedShape, Pixels, Silhouette
from plane_detector.shapes.surface import DEVIATIONS, depth_on_ray, distance_deviation, turn_of
from plane_detector.shapes.surfels import Surfels
from plane_detector.types import CameraIntrinsics, Plane

# For speed only every third ray is tested.
THROUGH_STEP_PX = 3
# derived: the surface of a ball with a radius of 30 pixels ends with a step of this many pixels.
STEEP = 8.0


@kernel('UniTuple(float64, 2)(float64, float64[::1])')
def noise_at(z, camera):
    """Return the standard deviation of the depth z of a pixel, and the side of a pixel there."""
    return np.sqrt((camera[4] * z * z) ** 2 + camera[5] ** 2), z / camera[0]


@kernel('float64[::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), int64, int64, int64)')
def free_shares(image, size, rows, columns):
    """Return the share (rows * columns,) of each cell's pixels that are free."""
    depth, labels, may_take = image
    share = np.zeros(rows * columns)
    for v in range(min(depth.shape[0], rows * size)):
        for u in range(min(depth.shape[1], columns * size)):
            if np.isfinite(depth[v, u]) and may_take[labels[v, u]]:
                share[v // size * columns + u // size] += 1 / size**2
    return share


@kernel('int64[::1](float32[:, ::1], int32[:, ::1], boolean[:, ::1], int64, int64)')
def label_counts(depth, labels, cells, size, count):
    """Return the number of pixels of cells (R, C) with depth, by label; the last: no plane."""
    result = np.zeros(count + 1, np.int64)
    for row in range(cells.shape[0]):
        for column in range(cells.shape[1]):
            if cells[row, column]:
                for v in range(row * size, min((row + 1) * size, depth.shape[0])):
                    for u in range(column * size, min((column + 1) * size, depth.shape[1])):
                        if np.isfinite(depth[v, u]):
                            result[labels[v, u]] += 1
    return result


@kernel('int64[::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), int64[::1], int64, '
        'int64, int64)')
def free_pixels(image, cells, columns, size, step):
    """Return every step-th free pixel of cells (n,) as v * width + u."""
    depth, labels, may_take = image
    height, width = depth.shape
    area = size * size
    found = np.empty(len(cells) * area // step + 1, np.int64)
    count = 0
    for k in range(0, len(cells) * area, step):
        cell, place = cells[k // area], k % area
        v, u = cell // columns * size + place // size, cell % columns * size + place % size
        if (v < height and u < width and np.isfinite(depth[v, u])
                and may_take[labels[v, u]]):
            found[count] = v * width + u
            count += 1
    return found[:count].copy()


@kernel('float64[:, ::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), int64[::1], '
        'int64, float64[::1])')
def silhouette_rays(image, cells, columns, camera):
    """
    Return rays (M, 4) between free pixels of cells (n,) and a background far behind them.

    The columns are x and y at depth 1, depth of the free pixel, and its standard deviation.
    """
    depth, labels, may_take = image
    (height, width), size, count = depth.shape, int(camera[6]), 0
    found = np.empty((4 * len(cells) * size * size, 4))
    for cell in cells:
        top, left = cell // columns * size, cell % columns * size
        for v in range(top, min(top + size, height)):
            for u in range(left, min(left + size, width)):
                z = depth[v, u]
                for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                    y, x = v + down, u + right
                    if not (0 <= y < height and 0 <= x < width):
                        continue
                    step = depth[y, x] - z
                    if not (step > STEEP * z / camera[0] and may_take[labels[v, u]]):
                        continue  # NaN is not a step
                    sigma, behind = noise_at(z, camera)[0], noise_at(depth[y, x], camera)[0]
                    if step > DEVIATIONS * np.hypot(sigma, behind) + STEEP * z / camera[0]:
                        found[count, 0] = (u + right / 2 - camera[2]) / camera[0]
                        found[count, 1] = (v + down / 2 - camera[3]) / camera[1]
                        found[count, 2], found[count, 3] = z, sigma
                        count += 1
    return found[:count].copy()


@kernel('int64[::1](float32[:, ::1], int32[:, ::1], int64, int64)')
def plane_pixels(depth, labels, k, step):
    """Return the pixels of plane k with depth, every step-th row and column."""
    height, width = depth.shape
    found = np.empty(((height - 1) // step + 1) * ((width - 1) // step + 1), np.int64)
    count = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            if labels[v, u] == k and np.isfinite(depth[v, u]):
                found[count] = v * width + u
                count += 1
    return found[:count].copy()


@kernel('UniTuple(float64[:, ::1], 2)(float32[:, ::1], int64[::1], float64[::1])')
def points_of(depth, where, camera):
    """Return points (N, 3) of pixels v * width + u (N,), and their :func:`noise_at` (N, 2)."""
    count, width = len(where), depth.shape[1]
    points, noise = np.empty((count, 3)), np.empty((count, 2))
    for i in range(count):
        v, u = where[i] // width, where[i] % width
        z = depth[v, u]
        points[i, 0] = (u - camera[2]) / camera[0] * z
        points[i, 1] = (v - camera[3]) / camera[1] * z
        points[i, 2] = z
        noise[i, 0], noise[i, 1] = noise_at(z, camera)
    return points, noise


@kernel('uint8[:, ::1](Tuple((float32[:, ::1], int32[:, ::1], boolean[::1])), boolean[:, ::1], '
        'UniTuple(int64, 4), float64[::1], float64[::1])')
def pixels_on(image, cells, window, shape, camera):
    """Return which free pixels of cells (R, C) lie on a shape, (h, w) for v0, v1, u0, u1."""
    depth, labels, may_take = image
    v0, v1, u0, u1 = window
    size, turn = int(camera[6]), turn_of(shape)
    result = np.zeros((v1 - v0, u1 - u0), np.uint8)
    for v in range(v0, v1):
        ray_y = (v - camera[3]) / camera[1]
        for u in range(u0, u1):
            z = depth[v, u]
            if np.isfinite(z) and cells[v // size, u // size] and may_take[labels[v, u]]:
                point = (u - camera[2]) / camera[0] * z, ray_y * z, z
                distance, deviation = distance_deviation(shape, turn, point, noise_at(z, camera))
                result[v - v0, u - u0] = abs(distance) < DEVIATIONS * deviation
    return result


@kernel('int64(float32[:, ::1], boolean[:, ::1], float64[::1], UniTuple(float64, 2), '
        'float64[::1])')
def rays_through(depth, cells, shape, ends, camera):
    """Return the number of rays of cells (R, C) that pass through a shape between its ends."""
    through, size = 0, int(camera[6])
    for v in range(0, min(depth.shape[0], cells.shape[0] * size), THROUGH_STEP_PX):
        ray_y = (v - camera[3]) / camera[1]
        for column in range(cells.shape[1]):
            if not cells[v // size, column]:
                continue
            # First pixel of the cell at a multiple of the step from the border of the image.
            first = -(-column * size // THROUGH_STEP_PX) * THROUGH_STEP_PX
            for u in range(first, min((column + 1) * size, depth.shape[1]), THROUGH_STEP_PX):
                z = depth[v, u]
                if np.isfinite(z):
                    met = depth_on_ray(shape, (u - camera[2]) / camera[0], ray_y, *ends)
                    through += z - met > DEVIATIONS * noise_at(z, camera)[0]
    return through


Window = tuple[slice, slice]
Image = tuple[np.ndarray, np.ndarray, np.ndarray]
# Limits on the time of a fit and of the measurement of a shape.
# tuned: benchmark shapes --first-seed 100 --scenes 40; equal with 500 pixels and 200 rays.
FITTED_PIXELS, SILHOUETTE_RAYS, MEASURED_PIXELS = 300, 120, 2000
# derived: smooth noise is about equal in a cell and its eight neighbours.
CORRELATED_CELLS = 9.0


@dataclass(frozen=True)
class FoundShape:
    """
    A fitted shape.

    Attributes
    ----------
    fit : FittedShape
    members : (R * C,) bool
        Its cells.
    open_share : float
        Share of its border across which the surface continues.
    absorbed : (K,) bool
        Planes that it replaces.
    window, mask : (slice, slice), (h, w) bool
        Its position in the image.

    """

    fit: FittedShape
    members: np.ndarray
    open_share: float
    absorbed: np.ndarray
    window: Window = (slice(0, 0), slice(0, 0))
    mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))


@dataclass(frozen=True)
class DepthView:
    """
    Data of the search for shapes.

    Attributes
    ----------
    depth_m : (H, W) float32
    labels : (H, W) int32
        Plane of each pixel, or -1.
    planes : tuple of Plane
    is_open : (K,) bool
        Planes that a shape may replace.
    noise : Noise
    intrinsics : CameraIntrinsics
    shape : (int, int)
        Rows and columns of cells, R x C.
    size_px : int
        Side of a cell.
    surfels : Surfels

    """

    depth_m: np.ndarray
    labels: np.ndarray
    planes: tuple[Plane, ...]
    is_open: np.ndarray
    noise: Noise
    intrinsics: CameraIntrinsics
    shape: tuple[int, int]
    size_px: int
    surfels: Surfels

    @cached_property
    def camera(self) -> np.ndarray:
        """Camera and noise for :mod:`plane_detector.shapes.views`, (7,) float64."""
        camera, noise = self.intrinsics, self.noise
        return np.array([camera.fx, camera.fy, camera.cx, camera.cy,
                         (noise.mean_sigma**2 + noise.pixel_sigma**2) ** 0.5, noise.depth_floor_m,
                         self.size_px])

    @cached_property
    def correlated(self) -> float:
        """Number of pixels that carry the information of one with independent noise."""
        smooth, grain = self.noise.mean_sigma**2, self.noise.pixel_sigma**2
        floor = self.noise.variance_floor(self.surfels.median_disparity)
        return ((smooth * CORRELATED_CELLS * self.size_px**2 + grain + floor)
                / (smooth + grain + floor))

    def window_of(self, cells: np.ndarray) -> Window:
        """Return the smallest window that contains some cells (R, C) bool."""
        ends = [np.flatnonzero(cells.any(axis=axis))[[0, -1]] + [0, 1] for axis in (1, 0)]
        return tuple(slice(int(low) * self.size_px, min(int(high) * self.size_px, side))
                     for (low, high), side in zip(ends, self.labels.shape, strict=True))

    def label_counts(self, cells: np.ndarray) -> np.ndarray:
        """Return the number of pixels with depth in cells (R * C,) by plane; last: no plane."""
        return label_counts(self.depth_m, self.labels, cells.reshape(self.shape), self.size_px,
                            len(self.planes))

    @cached_property
    def image(self) -> Image:
        """The image for compiled loops, with the open planes."""
        return self.image_with(self.is_open)

    def image_with(self, open_planes: np.ndarray) -> Image:
        """Return the image for compiled loops, with planes (K,) bool that may be replaced."""
        # The additional last entry is for the label -1.
        return self.depth_m, self.labels, np.append(open_planes, True)

    def free_pixels(self, cells: np.ndarray, open_planes: np.ndarray | None = None,
                    ) -> tuple[Pixels, np.ndarray]:
        """
        Return a sample of the free pixels of some cells, at most FITTED_PIXELS, and their labels.

        Parameters
        ----------
        cells : (R * C,) bool
        open_planes : (K,) bool, optional
            Pixels are free if they have depth and no plane except one of these; default: the open
            planes of the view.

        """
        where = np.flatnonzero(cells)
        step = -(-len(where) * self.size_px**2 // FITTED_PIXELS) or 1
        # With a common divisor some rows and columns of the cells would never be sampled.
        while math.gcd(step, self.size_px) > 1:
            step += 1
        image = self.image if open_planes is None else self.image_with(open_planes)
        found = free_pixels(image, where, self.shape[1], self.size_px, step)
        return self._pixels(found, step), self.labels.ravel()[found]

    def silhouette(self, cells: np.ndarray, around: np.ndarray) -> Silhouette:
        """
        Return rays along the silhouette of some cells, at most SILHOUETTE_RAYS.

        Parameters
        ----------
        cells : (R * C,) bool
        around : (R, C) bool
            These cells and those that the silhouette may cross.

        """
        inside = cv2.erode(cells.reshape(self.shape).astype(np.uint8), np.ones((3, 3), np.uint8))
        border = np.flatnonzero(around & (inside == 0))
        rays = silhouette_rays(self.image, border, self.shape[1], self.camera)
        step = -(-len(rays) // SILHOUETTE_RAYS) or 1
        return Silhouette(np.ascontiguousarray(rays[::step]), 1 / self.intrinsics.fx)

    def plane_pixels(self, k: int, most: int) -> Pixels:
        """Return the pixels of a plane, subsampled to about ``most``."""
        step = max(1, int(np.sqrt(self.planes[k].inlier_count / most)))
        return self._pixels(plane_pixels(self.depth_m, self.labels, k, step), step * step)

    def points_in(self, window: Window, mask: np.ndarray) -> Pixels:
        """Return the points of pixels (h, w) bool in a window, at most MEASURED_PIXELS."""
        inside = np.flatnonzero(mask)
        step = -(-len(inside) // MEASURED_PIXELS) or 1
        v, u = np.divmod(inside[::step], mask.shape[1])
        where = (v + window[0].start) * self.labels.shape[1] + u + window[1].start
        return self._pixels(where, step)

    def is_free(self, window: Window) -> np.ndarray:
        """Return the pixels (h, w) bool that have depth and no plane, or an open one."""
        return self.image[2][self.labels[window]] & np.isfinite(self.depth_m[window])

    def _pixels(self, where: np.ndarray, step: int) -> Pixels:
        """Return the points of pixels v * W + u (N,), each representing ``step`` pixels."""
        return Pixels(*points_of(self.depth_m, where, self.camera),
                      len(where) * step / self.correlated)
