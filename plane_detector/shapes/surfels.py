# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells of the depth image as points with normals and noise, and their smooth connections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid, N
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.shapes.surface import DEVIATIONS
from plane_detector.types import CameraIntrinsics

# derived: if the planes of two cells meet at less than 90 degrees, each deviates at the other's
# centre by less than half the distance of the centres; a larger gap in depth is a step.
_MAX_GAP_SHARE = 0.5
# after: Schnabel 2007 uses 10 to 20 degrees between the normals of a point and of the shape.
_NORMAL_TOLERANCE_RAD = np.radians(15.0)
# derived: on a ball four cells wide the mean of a cell is 1/8 of the cell's side below the
# surface.
_CELL_TOLERANCE = 0.125
# Columns of Surfels.table: point (3), normal (3), ray (3), deviation of the depth, tolerance for
# the curvature of a cell, smallest cosine between normals, pixels.
POINT, NORMAL, RAY, SIGMA, CURVED, MIN_COSINE, COUNT = 0, 3, 6, 9, 10, 11, 12


@dataclass(frozen=True)
class Surfels:
    """One oriented point per cell."""

    shape: tuple[int, int]  # rows and columns of cells, R x C
    # (R * C, 13) float64, columns as listed above. Points are in the optical frame, in metres;
    # rays have depth 1; normals point to the camera.
    table: np.ndarray
    usable: np.ndarray  # (R * C,) bool

    @property
    def points_m(self) -> np.ndarray:
        """The points, (R * C, 3) float64."""
        return self.table[:, POINT:NORMAL]

    @property
    def normals(self) -> np.ndarray:
        """The normals, (R * C, 3) float64."""
        return self.table[:, NORMAL:RAY]

    @property
    def count(self) -> np.ndarray:
        """Number of pixels with depth, (R * C,) float64."""
        return self.table[:, COUNT]

    @cached_property
    def median_disparity(self) -> float:
        """1/depth of the median cell; 0 if there is none."""
        z_m = self.table[self.usable, POINT + 2]
        return 1 / float(np.median(z_m)) if z_m.size else 0.0

    def mask(self, cells: np.ndarray) -> np.ndarray:
        """Return cells (n,) int as a mask (R, C) bool."""
        mask = np.zeros(self.shape, bool)
        mask.flat[cells] = True
        return mask


def depth_sigma_m(depth_m: np.ndarray, disparity_sigma: float, floor_m: float) -> np.ndarray:
    """Return the standard deviation of depths: constant in 1/depth, with a lower bound."""
    return np.sqrt((disparity_sigma * np.square(depth_m)) ** 2 + floor_m**2)


def surfels_of_grid(grid: CellGrid, intrinsics: CameraIntrinsics, noise: Noise) -> Surfels:
    """Return the cells of a grid of 1/depth in 1/m as oriented points, with this noise."""
    camera, unit_px = intrinsics, grid.width_px
    table = np.full((len(grid.usable), 13), np.nan)
    table[:, COUNT] = grid.moments[:, N]
    usable = grid.usable & (grid.mean[:, 2] > 0)
    x, y, disparity = grid.mean[usable].T
    slope_x, slope_y = grid.slope[usable].T
    ray_x = (x * unit_px - camera.cx + (camera.width - 1) / 2) / camera.fx
    ray_y = (y * unit_px - camera.cy + (camera.height - 1) / 2) / camera.fy
    # 1/z = a r_x + b r_y + c is the plane (a, b, c) . p = 1.
    a, b = slope_x * (camera.fx / unit_px), slope_y * (camera.fy / unit_px)
    c, depth_m = disparity - a * ray_x - b * ray_y, 1 / disparity
    length = np.sqrt(a * a + b * b + c * c)
    width_m = grid.size_px / camera.fx * depth_m
    slope_sigma = noise.slope_sigma * (camera.fx + camera.fy) / 2 / unit_px
    tolerance_rad = _NORMAL_TOLERANCE_RAD + DEVIATIONS * slope_sigma / length
    table[usable, :COUNT] = np.stack([
        ray_x * depth_m, ray_y * depth_m, depth_m, -a / length, -b / length, -c / length,
        ray_x, ray_y, np.ones_like(depth_m),
        depth_sigma_m(depth_m, noise.mean_sigma, noise.depth_floor_m), _CELL_TOLERANCE * width_m,
        np.cos(np.minimum(tolerance_rad, 1.0))], axis=1)
    # A step within a cell bends it more than any curved surface that cells can resolve.
    grain_m = depth_sigma_m(depth_m, noise.pixel_sigma, noise.depth_floor_m)
    usable[usable] = (grid.residual_rms[usable] * depth_m**2
                      < np.sqrt((DEVIATIONS * grain_m)**2 + (_MAX_GAP_SHARE * width_m)**2))
    return Surfels(grid.shape, table, usable)


def smooth_components(surfels: Surfels, free: np.ndarray) -> np.ndarray:
    """Return the component (R * C,) of smoothly connected free cells (R * C,), -1 for others."""
    # Imported here, because a node that only detects planes does not need it: scipy takes 46 MB.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    cells = np.arange(len(free)).reshape(surfels.shape)
    one = np.concatenate([cells[:, :-1].ravel(), cells[:-1].ravel()])
    other = np.concatenate([cells[:, 1:].ravel(), cells[1:].ravel()])
    both = free[one] & free[other]
    one, other = one[both], other[both]
    joined = _goes_on(surfels.table[one], surfels.table[other])
    graph = coo_array((joined[joined], (one[joined], other[joined])), (len(free),) * 2)
    return np.where(free, connected_components(graph, directed=False)[1], -1)


def _goes_on(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return whether the surface continues without a step between adjacent cells, table rows."""
    # The gap between two cells is the distance of each centre from the plane of the other.
    apart_m = other[:, POINT:NORMAL] - one[:, POINT:NORMAL]
    gap_m = np.maximum(*(np.abs((apart_m * cell[:, NORMAL:RAY]).sum(axis=1))
                         for cell in (one, other)))
    allowed_m2 = (DEVIATIONS * one[:, SIGMA])**2 + _MAX_GAP_SHARE**2 * (apart_m**2).sum(axis=1)
    return gap_m**2 < allowed_m2
