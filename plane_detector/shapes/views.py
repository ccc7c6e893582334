# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The depth image as cells and as pixels of cells, for the search for shapes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from plane_detector.segmentation.cells.noise import Noise
from plane_detector.shapes.refinement import FittedShape, Pixels, Silhouette
from plane_detector.shapes.surfels import Surfels
from plane_detector.shapes.windows import (
    free_pixels,
    label_counts,
    plane_pixels,
    points_of,
    silhouette_rays,
)
from plane_detector.types import CameraIntrinsics, Plane

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
        """Camera and noise for :mod:`plane_detector.shapes.windows`, (7,) float64."""
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
