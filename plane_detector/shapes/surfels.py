# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells of the depth image as points with normals and noise, and which of them go on smoothly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid, N
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.types import CameraIntrinsics

# derived: the planes of two cells that meet at less than 90 degrees deviate at each other's centre
# by less than half the distance of the centres; a larger gap in depth is a step.
_MAX_GAP_SHARE = 0.5
# after: the usual three deviations of a normal distribution.
DEVIATIONS = 3.0
# after: Schnabel 2007 uses 10 to 20 degrees between the normal of a point and of the shape.
_NORMAL_TOLERANCE_RAD = np.radians(15.0)
# derived: the mean of a cell on a ball as wide as four cells lies 1/8 of the cell's side below it.
_CELL_TOLERANCE = 0.125


@dataclass(frozen=True)
class Surfels:
    """
    One oriented point per cell.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of cells, R x C.
    points_m, normals : (R * C, 3) float64
        In the optical frame; normals look at the camera.
    rays : (R * C, 3) float64
        The rays through the points, of depth 1.
    count : (R * C,) float64
        Valid pixels of each cell.
    width_m : (R * C,) float64
        Side of the cell at the depth of the point.
    depth_sigma_m : (R * C,) float64
        Standard deviation of the depth of the point.
    normal_sigma_rad : (R * C,) float64
        Standard deviation of the normal.
    usable : (R * C,) bool

    """

    shape: tuple[int, int]
    points_m: np.ndarray
    normals: np.ndarray
    rays: np.ndarray
    count: np.ndarray
    width_m: np.ndarray
    depth_sigma_m: np.ndarray
    normal_sigma_rad: np.ndarray
    usable: np.ndarray

    @cached_property
    def table(self) -> np.ndarray:
        """
        What :func:`plane_detector.shapes.hypotheses.agrees` asks of the cells, (R * C, 13).

        Point (3), normal (3), ray (3), deviation of the depth, what a curved cell may lie off,
        least cosine between the normals, pixels.
        """
        turn_rad = np.minimum(_NORMAL_TOLERANCE_RAD + DEVIATIONS * self.normal_sigma_rad, 1.0)
        return np.ascontiguousarray(np.column_stack([
            self.points_m, self.normals, self.rays, self.depth_sigma_m,
            _CELL_TOLERANCE * self.width_m, np.cos(turn_rad), self.count]))

    @cached_property
    def median_disparity(self) -> float:
        """1/depth of the middle cell; 0 where there is none."""
        z_m = self.points_m[self.usable, 2]
        return 1 / float(np.median(z_m)) if z_m.size else 0.0


def depth_sigma_m(depth_m: np.ndarray, disparity_sigma: float, floor_m: float) -> np.ndarray:
    """Return the standard deviation of depths: noise is constant in 1/depth, with a floor."""
    return np.sqrt((disparity_sigma * np.square(depth_m)) ** 2 + floor_m**2)


def surfels_of_grid(grid: CellGrid, intrinsics: CameraIntrinsics, noise: Noise) -> Surfels:
    """
    Return the cells as oriented points.

    Parameters
    ----------
    grid : CellGrid
        Of 1/depth in 1/m.
    intrinsics : CameraIntrinsics
    noise : Noise
        Of the cells of this grid.

    """
    x, y, disparity = grid.mean.T
    usable = grid.usable & (disparity > 0)
    z_m = 1 / np.where(usable, disparity, np.nan)
    middle = (intrinsics.width - 1) / 2, (intrinsics.height - 1) / 2
    rays = np.column_stack([
        (x * grid.width_px + middle[0] - intrinsics.cx) / intrinsics.fx,
        (y * grid.width_px + middle[1] - intrinsics.cy) / intrinsics.fy, np.ones_like(x)])
    # 1/z = a r_x + b r_y + c is the plane (a, b, c) . p = 1.
    focal = np.array([intrinsics.fx, intrinsics.fy]) / grid.width_px
    a, b = (grid.slope * focal).T
    plane = np.column_stack([a, b, disparity - a * rays[:, 0] - b * rays[:, 1]])
    length = np.linalg.norm(plane, axis=1).clip(1e-12)
    width_m = grid.size_px / intrinsics.fx * z_m
    grain_m = depth_sigma_m(z_m, noise.pixel_sigma, noise.depth_floor_m)
    # A step within a cell bends it by more than any curved surface that the cell can show.
    usable &= grid.inner_rms * z_m**2 < np.hypot(DEVIATIONS * grain_m, _MAX_GAP_SHARE * width_m)
    return Surfels(
        grid.shape, rays * z_m[:, None], -plane / length[:, None], rays, grid.moments[:, N],
        width_m, depth_sigma_m(z_m, noise.mean_sigma, noise.depth_floor_m),
        noise.slope_sigma * focal.mean() / length, usable)


def smooth_links(surfels: Surfels) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the pairs of adjacent cells (L,), (L,) between which the surface goes on without a step.

    The gap between two cells is how far each centre lies off the plane of the other.
    """
    index = np.arange(surfels.usable.size).reshape(surfels.shape)
    first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    both = surfels.usable[first] & surfels.usable[second]
    first, second = first[both], second[both]
    apart = surfels.points_m[second] - surfels.points_m[first]
    gap_m = np.maximum(np.abs((apart * surfels.normals[first]).sum(axis=1)),
                       np.abs((apart * surfels.normals[second]).sum(axis=1)))
    distance_m = np.linalg.norm(apart, axis=1)
    allowed_m = np.hypot(DEVIATIONS * surfels.depth_sigma_m[first], _MAX_GAP_SHARE * distance_m)
    joined = gap_m < allowed_m
    return first[joined], second[joined]
