# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The search's view of an image: the pixels of cells, the silhouette, rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import dilated
from plane_detector.segmentation.cells.noise import CORRELATED_CELLS, Noise
from plane_detector.shapes.fitting import FittedShape, Pixels, Silhouette, shape_residuals
from plane_detector.shapes.surface import DEVIATIONS, depths_on_rays
from plane_detector.shapes.surfels import Surfels, depth_sigma_m
from plane_detector.types import CameraIntrinsics, Planes

# For speed only every fourth ray is tested.
_THROUGH_STEP_PX = 4
# derived: the surface of a ball with a radius of 30 pixels ends with a step of this many pixels.
_STEEP = 8.0
# Limits on the time of a fit and of the measurement of a shape.
# tuned: benchmark shapes --first-seed 100 --scenes 40; equal with 500 pixels and 200 rays.
_FITTED_PIXELS, _SILHOUETTE_RAYS, _MEASURED_PIXELS = 300, 120, 2000
# derived: cells cut by the silhouette are not members; they form a border of at most two cells.
_BORDER_CELLS = 2

Window = tuple[slice, slice]


@kernel('float64[:, ::1](float32[:, ::1], boolean[:, ::1], int64[::1], int64, float64[::1])')
def silhouette_rays(depth, is_free, cells, columns, camera):
    """
    Return rays (M, 4) between free pixels of cells (n,) and a background far behind them.

    The columns are x and y at depth 1, depth of the free pixel, and its standard deviation. The
    camera is fx, fy, cx, cy, variances of 1/depth and of the floor of depth, side of a cell.
    """
    (height, width), size, count = depth.shape, int(camera[6]), 0
    found = np.empty((4 * len(cells) * size * size, 4))
    for cell in cells:
        top, left = cell // columns * size, cell % columns * size
        for v in range(top, min(top + size, height)):
            for u in range(left, min(left + size, width)):
                z = depth[v, u]
                for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                    y, x = v + down, u + right
                    if not (is_free[v, u] and 0 <= y < height and 0 <= x < width):
                        continue
                    step = depth[y, x] - z - _STEEP * z / camera[0]
                    of_near = camera[4] * z**4 + camera[5]
                    of_far = camera[4] * depth[y, x]**4 + camera[5]
                    if step > DEVIATIONS * np.sqrt(of_near + of_far):  # NaN is not a step
                        found[count, 0] = (u + right / 2 - camera[2]) / camera[0]
                        found[count, 1] = (v + down / 2 - camera[3]) / camera[1]
                        found[count, 2], found[count, 3] = z, np.sqrt(of_near)
                        count += 1
    return found[:count].copy()


@dataclass(frozen=True)
class FoundShape:
    """A fitted shape with its place in the image."""

    fit: FittedShape
    members: np.ndarray  # (R * C,) bool, its cells
    open_share: float  # of its border, across which the surface continues
    absorbed: np.ndarray  # (K,) bool, planes that it replaces
    window: Window = (slice(0, 0), slice(0, 0))
    mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))  # in the window


@dataclass(frozen=True)
class DepthView:
    """Data of the search for shapes."""

    depth_m: np.ndarray  # (H, W) float32
    labels: np.ndarray  # (H, W) int32, plane of each pixel, or -1
    planes: Planes
    is_open: np.ndarray  # (K,) bool, planes that a shape may replace
    noise: Noise
    intrinsics: CameraIntrinsics
    size_px: int  # side of a cell
    surfels: Surfels  # of R x C cells

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells, R x C."""
        return self.surfels.shape

    @cached_property
    def correlated(self) -> float:
        """Number of pixels that carry the information of one with independent noise."""
        smooth, grain = self.noise.mean_sigma**2, self.noise.pixel_sigma**2
        floor = self.noise.variance_floor(self.surfels.median_disparity)
        return ((smooth * CORRELATED_CELLS * self.size_px**2 + grain + floor)
                / (smooth + grain + floor))

    @cached_property
    def is_free(self) -> np.ndarray:
        """Pixels (H, W) bool that have depth and no plane, or one that a shape may replace."""
        is_free = self.labels < 0
        for k in np.flatnonzero(self.is_open):
            is_free |= self.labels == k
        return is_free & np.isfinite(self.depth_m)

    def free_shares(self) -> np.ndarray:
        """Return the share (R * C,) of each cell's pixels that are free."""
        sides = [self.size_px * count for count in self.shape]
        whole = np.zeros(sides, np.float32)
        free = self.is_free[:sides[0], :sides[1]]
        whole[:free.shape[0], :free.shape[1]] = free
        return cv2.resize(whole, self.shape[::-1], interpolation=cv2.INTER_AREA).ravel()

    def window_of(self, cells: np.ndarray) -> Window:
        """Return the smallest window that contains some cells (R, C) bool."""
        ends = [np.flatnonzero(cells.any(axis=axis))[[0, -1]] + [0, 1] for axis in (1, 0)]
        return tuple(slice(int(low) * self.size_px, min(int(high) * self.size_px, side))
                     for (low, high), side in zip(ends, self.labels.shape, strict=True))

    def around(self, cells: np.ndarray) -> np.ndarray:
        """Return the cells (R, C) bool that the silhouette of some cells (R * C,) may cross."""
        return dilated(cells.reshape(self.shape), _BORDER_CELLS).astype(bool)

    def _pixels_of(self, cells: np.ndarray, step: int) -> np.ndarray:
        """Return every step-th pixel v * W + u of cells (n,) int, cell by cell."""
        (height, width), size = self.labels.shape, self.size_px
        number = np.arange(0, len(cells) * size**2, step)
        cell, place = cells[number // size**2], number % size**2
        v = cell // self.shape[1] * size + place // size
        u = cell % self.shape[1] * size + place % size
        return (v * width + u)[(v < height) & (u < width)]

    def free_pixels(self, cells: np.ndarray, open_planes: np.ndarray | None = None,
                    ) -> tuple[Pixels, np.ndarray]:
        """
        Return a sample of the free pixels of cells (R * C,), and their labels.

        Pixels are free if they have depth and no plane except one of ``open_planes``, (K,) bool;
        default: the open planes of the view.
        """
        cells = np.flatnonzero(cells)
        step = -(-len(cells) * self.size_px**2 // _FITTED_PIXELS) or 1
        # With a common divisor some rows and columns of the cells would never be sampled.
        while math.gcd(step, self.size_px) > 1:
            step += 1
        where = self._pixels_of(cells, step)
        if open_planes is None:
            where = where[self.is_free.ravel()[where]]
        else:
            where = where[np.append(open_planes, True)[self.labels.ravel()[where]]
                          & np.isfinite(self.depth_m.ravel()[where])]
        return self.pixels_at(where, step), self.labels.ravel()[where]

    def plane_pixels(self, k: int, most: int) -> Pixels:
        """Return the pixels of a plane, subsampled to about ``most``."""
        step = max(1, int(np.sqrt(self.planes.counts[k] / most)))
        v, u = step * np.array(np.nonzero((self.labels[::step, ::step] == k)
                                          & np.isfinite(self.depth_m[::step, ::step])))
        return self.pixels_at(v * self.labels.shape[1] + u, step * step)

    def points_in(self, window: Window, mask: np.ndarray) -> Pixels:
        """Return the points of pixels (h, w) bool in a window, at most _MEASURED_PIXELS."""
        where = self._in_window(window, mask)
        step = -(-len(where) // _MEASURED_PIXELS) or 1
        return self.pixels_at(where[::step], step)

    def _in_window(self, window: Window, mask: np.ndarray) -> np.ndarray:
        """Return the pixels v * W + u of a mask (h, w) in a window."""
        v, u = np.nonzero(mask)
        return (v + window[0].start) * self.labels.shape[1] + u + window[1].start

    def pixels_at(self, where: np.ndarray, step: int = 1) -> Pixels:
        """Return the points of pixels v * W + u (N,), each representing ``step`` pixels."""
        z_m = self.depth_m.ravel()[where].astype(float)
        points_m, noise_m = np.empty((len(where), 3)), np.empty((len(where), 2))
        points_m[:, :2], points_m[:, 2] = self._rays(where) * z_m[:, None], z_m
        noise_m[:, 0], noise_m[:, 1] = self._sigma_m(z_m), z_m / self.intrinsics.fx
        return Pixels(points_m, noise_m, len(where) * step / self.correlated)

    def _rays(self, where: np.ndarray) -> np.ndarray:
        """Return x / z and y / z of pixels v * W + u (N,), (N, 2)."""
        camera, v, rays = self.intrinsics, where // self.labels.shape[1], np.empty((len(where), 2))
        rays[:, 0] = (where - v * self.labels.shape[1] - camera.cx) / camera.fx
        rays[:, 1] = (v - camera.cy) / camera.fy
        return rays

    def _sigma_m(self, depth_m: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the depth of single pixels."""
        return depth_sigma_m(depth_m, math.hypot(self.noise.mean_sigma, self.noise.pixel_sigma),
                             self.noise.depth_floor_m)

    def mask_on(self, shape: np.ndarray, cells: np.ndarray, window: Window,
                absorbed: np.ndarray) -> np.ndarray:
        """Return which pixels of cells (R, C), free or absorbed, lie on a shape, (h, w) bool."""
        rows, columns = (np.arange(side.start, side.stop) // self.size_px for side in window)
        mask = (cells[np.ix_(rows, columns)] & np.isfinite(self.depth_m[window])
                & np.append(absorbed, True)[self.labels[window]])
        off = shape_residuals(shape, self.pixels_at(self._in_window(window, mask)))
        mask[mask] = np.abs(off) < DEVIATIONS
        return mask

    def silhouette(self, cells: np.ndarray, around: np.ndarray) -> Silhouette:
        """
        Return a sample of the rays between free pixels and a background far behind them.

        The cells are (R * C,); ``around`` (R, C) also includes cells that the silhouette may
        cross.
        """
        inside = cv2.erode(cells.reshape(self.shape).astype(np.uint8), np.ones((3, 3), np.uint8))
        camera, noise = self.intrinsics, self.noise
        rays = silhouette_rays(
            self.depth_m, self.is_free, np.flatnonzero(around & (inside == 0)), self.shape[1],
            np.array([camera.fx, camera.fy, camera.cx, camera.cy, noise.mean_sigma**2
                      + noise.pixel_sigma**2, noise.depth_floor_m**2, self.size_px]))
        step = -(-len(rays) // _SILHOUETTE_RAYS) or 1
        return Silhouette(np.ascontiguousarray(rays[::step]), 1 / camera.fx)

    def seen_through_cost(self, shape: np.ndarray, cells: np.ndarray,
                          ends_m: tuple[float, float]) -> float:
        """
        Return the cost of rays of cells (R, C) that pass through a shape (8,) between its ends.

        A cylinder may fit the depth of a cone, but not its silhouette. Each such ray counts as an
        outlier.
        """
        v, u = (np.arange(0, min(side, count * self.size_px), _THROUGH_STEP_PX)
                for side, count in zip(self.labels.shape, self.shape, strict=True))
        row, column = np.nonzero(cells[np.ix_(v // self.size_px, u // self.size_px)])
        where = v[row] * self.labels.shape[1] + u[column]
        z_m = self.depth_m.ravel()[where].astype(float)
        met_m = depths_on_rays(shape, self._rays(where), ends_m)
        through = np.count_nonzero(z_m - met_m > DEVIATIONS * self._sigma_m(z_m))
        return DEVIATIONS**2 * through * _THROUGH_STEP_PX**2 / self.correlated
