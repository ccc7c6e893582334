# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The depth image as the search for shapes looks at it: by cells, and by the pixels of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.segmentation.cells.noise import Noise
from plane_detector.shapes.refinement import FittedShape, Pixels
from plane_detector.shapes.surfels import Surfels, depth_sigma_m
from plane_detector.types import CameraIntrinsics, Plane

Window = tuple[slice, slice]
# derived: smooth noise is about the same in a cell and its eight neighbours.
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
        Share of its border across which the surface goes on.
    absorbed : (K,) bool
        The planes that it takes the place of.

    """

    fit: FittedShape
    members: np.ndarray
    open_share: float
    absorbed: np.ndarray


@dataclass(frozen=True)
class DepthView:
    """
    What the search works on.

    Attributes
    ----------
    depth_m : (H, W) floating
    labels : (H, W) int32
        Plane of each pixel, -1 none.
    planes : tuple of Plane
    is_open : (K,) bool
        The planes that a shape may take the place of.
    noise : Noise
    intrinsics : CameraIntrinsics
    shape : (int, int)
        Rows and columns of cells, R x C.
    size_px : int
        Side of a cell.
    surfels : Surfels
    links : ((L,) int, (L,) int)
        Adjacent cells between which the surface goes on.

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
    links: tuple[np.ndarray, np.ndarray]

    def pixels_of_cells(self, cells: np.ndarray) -> tuple[Window, np.ndarray]:
        """Return the window around some cells (R * C,) and its pixels (h, w) that are theirs."""
        grid = cells.reshape(self.shape)
        ends = [np.flatnonzero(grid.any(axis=axis))[[0, -1]] + [0, 1] for axis in (1, 0)]
        inside = grid[slice(*ends[0]), slice(*ends[1])]
        mask = inside.repeat(self.size_px, axis=0).repeat(self.size_px, axis=1)
        window = tuple(slice(low * self.size_px, min(high * self.size_px, side))
                       for (low, high), side in zip(ends, self.labels.shape, strict=True))
        height, width = (side.stop - side.start for side in window)
        return window, mask[:height, :width]

    def pixels(self, window: Window, mask: np.ndarray) -> Pixels:
        """Return the points of the pixels (h, w) bool of a window."""
        v, u = np.nonzero(mask)
        z_m = self.depth_m[window][v, u].astype(np.float64)
        camera = self.intrinsics
        rays = np.column_stack([(u + window[1].start - camera.cx) / camera.fx,
                                (v + window[0].start - camera.cy) / camera.fy, np.ones(len(u))])
        smooth, grain = self.noise.mean_sigma**2, self.noise.pixel_sigma**2
        sigma_m = depth_sigma_m(z_m, (smooth + grain) ** 0.5, self.noise.depth_floor_m)
        floor = self.noise.variance_floor(self.surfels.median_disparity)
        correlated = ((smooth * CORRELATED_CELLS * self.size_px**2 + grain + floor)
                      / (smooth + grain + floor))
        return Pixels(rays * z_m[:, None], rays, sigma_m, z_m / camera.fx, len(u) / correlated)

    def free_pixels(self, cells: np.ndarray) -> Pixels:
        """Return the pixels of some cells that have a depth and no plane but an open one."""
        window, mask = self.pixels_of_cells(cells)
        return self.pixels(window, mask & self.is_free(window, self.is_open))

    def is_free(self, window: Window, open_planes: np.ndarray) -> np.ndarray:
        """Say which pixels (h, w) have a depth and no plane but one of the open (K,) bool."""
        # The last entry serves the label -1.
        may_take = np.append(open_planes, True)
        return may_take[self.labels[window]] & np.isfinite(self.depth_m[window])

    def plane_pixels(self, k: int, most: int) -> Pixels:
        """Return the pixels of a plane, thinned to about so many."""
        step = max(1, int(np.sqrt(self.planes[k].inlier_count / most)))
        mask = np.zeros(self.labels.shape, bool)
        mask[::step, ::step] = self.labels[::step, ::step] == k
        return self.pixels((slice(0, mask.shape[0]), slice(0, mask.shape[1])), mask)
