# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Cells of the depth image as points with normals and noise, and their smooth connections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import N
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
    """
    One oriented point per cell.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of cells, R x C.
    table : (R * C, 13) float64
        Columns as listed in this module. Points are in the optical frame, in metres; rays have
        depth 1; normals point to the camera.
    usable : (R * C,) bool

    """

    shape: tuple[int, int]
    table: np.ndarray
    usable: np.ndarray

    @property
    def points_m(self) -> np.ndarray:
        """The points, (R * C, 3) float64."""
        return self.table[:, POINT:NORMAL]

    @property
    def count(self) -> np.ndarray:
        """Number of pixels with depth, (R * C,) float64."""
        return self.table[:, COUNT]

    @cached_property
    def median_disparity(self) -> float:
        """1/depth of the median cell; 0 if there is none."""
        z_m = self.table[self.usable, POINT + 2]
        return 1 / float(np.median(z_m)) if z_m.size else 0.0


def depth_sigma_m(depth_m: np.ndarray, disparity_sigma: float, floor_m: float) -> np.ndarray:
    """Return the standard deviation of depths: constant in 1/depth, with a lower bound."""
    return np.sqrt((disparity_sigma * np.square(depth_m)) ** 2 + floor_m**2)


def surfels_of_grid(grid: CellGrid, intrinsics: CameraIntrinsics, noise: Noise) -> Surfels:
    """
    Return the cells of a grid as oriented points.

    Parameters
    ----------
    grid : CellGrid
        Of 1/depth in 1/m.
    intrinsics : CameraIntrinsics
    noise : Noise
        Noise of the cells of this grid.

    """
    camera = np.array([
        intrinsics.fx, intrinsics.fy, intrinsics.cx - (intrinsics.width - 1) / 2,
        intrinsics.cy - (intrinsics.height - 1) / 2, grid.width_px, grid.size_px])
    sigmas = np.array([noise.mean_sigma, noise.slope_sigma, noise.pixel_sigma,
                       noise.depth_floor_m])
    cells = np.column_stack([grid.mean, grid.slope, grid.residual_rms, grid.moments[:, N]])
    table, usable = surfel_table(cells, grid.usable, camera, sigmas)
    return Surfels(grid.shape, table, usable)


@kernel('Tuple((float64[:, ::1], boolean[::1]))(float64[:, ::1], boolean[::1], float64[::1], '
        'float64[::1])')
def surfel_table(cells, usable, camera, sigmas):
    """
    Return the table (n, 13) of cells (n, 7), and which of them are usable.

    Parameters
    ----------
    cells : (n, 7) float64
        Mean x, y and 1/depth, their slopes, rms about the cell's plane, pixels.
    usable : (n,) bool
    camera : (6,) float64
        fx, fy, cx and cy from the centre of the image, unit of x and y, side of a cell; pixels.
    sigmas : (4,) float64
        Noise of means, slopes and pixels, 1/m, and the lower bound of the depth noise in metres.

    """
    table, good = np.full((len(cells), 13), np.nan), np.zeros(len(cells), np.bool_)
    slope_sigma = sigmas[1] * (camera[0] + camera[1]) / 2 / camera[4]
    for i in range(len(cells)):
        disparity, row = cells[i, 2], table[i]
        row[COUNT] = cells[i, 6]
        if not (usable[i] and disparity > 0):
            continue
        z = 1 / disparity
        # 1/z = a r_x + b r_y + c is the plane (a, b, c) . p = 1.
        row[RAY] = (cells[i, 0] * camera[4] - camera[2]) / camera[0]
        row[RAY + 1] = (cells[i, 1] * camera[4] - camera[3]) / camera[1]
        row[RAY + 2] = 1.0
        a, b = cells[i, 3] * camera[0] / camera[4], cells[i, 4] * camera[1] / camera[4]
        c = disparity - a * row[RAY] - b * row[RAY + 1]
        length = np.sqrt(a * a + b * b + c * c)
        row[NORMAL], row[NORMAL + 1], row[NORMAL + 2] = -a / length, -b / length, -c / length
        row[POINT], row[POINT + 1], row[POINT + 2] = row[RAY] * z, row[RAY + 1] * z, z
        width = camera[5] / camera[0] * z
        row[SIGMA], row[CURVED] = np.hypot(sigmas[0] * z * z, sigmas[3]), _CELL_TOLERANCE * width
        tolerance_rad = _NORMAL_TOLERANCE_RAD + DEVIATIONS * slope_sigma / length
        row[MIN_COSINE] = np.cos(min(tolerance_rad, 1.0))
        # A step within a cell bends it more than any curved surface that cells can resolve.
        grain = np.hypot(sigmas[2] * z * z, sigmas[3])
        good[i] = cells[i, 5] * z * z < np.hypot(DEVIATIONS * grain, _MAX_GAP_SHARE * width)
    return table, good


@kernel('boolean(float64[::1], float64[::1])')
def goes_on(one, other):
    """
    Return whether the surface continues without a step between adjacent cells, rows of the table.

    The gap between two cells is the distance of each centre from the plane of the other.
    """
    square = first = second = 0.0
    for k in range(3):
        apart = other[POINT + k] - one[POINT + k]
        square += apart * apart
        first += apart * one[NORMAL + k]
        second += apart * other[NORMAL + k]
    allowed = (DEVIATIONS * one[SIGMA]) ** 2 + _MAX_GAP_SHARE**2 * square
    return max(first * first, second * second) < allowed


@kernel('int64[::1](float64[:, ::1], boolean[::1], int64)')
def smooth_components(table, free, columns):
    """Return the component (n,) of smoothly connected free cells, -1 for other cells."""
    component, stack = np.full(len(free), -1), np.empty(len(free), np.int64)
    count = 0
    for start in range(len(free)):
        if not free[start] or component[start] >= 0:
            continue
        component[start], stack[0], top = count, start, 1
        while top:
            top -= 1
            here = stack[top]
            column = here % columns
            for there in (here - columns, here + columns, here - 1 if column else -1,
                          here + 1 if column < columns - 1 else -1):
                if (0 <= there < len(free) and free[there] and component[there] < 0
                        and goes_on(table[min(here, there)], table[max(here, there)])):
                    component[there], stack[top] = count, there
                    top += 1
        count += 1
    return component
