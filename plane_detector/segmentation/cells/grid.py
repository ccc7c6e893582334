# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The image as a grid of square cells, each summarised by the moments of its disparity.

A plane is affine in (x, y, 1/z). The least-squares plane of any set of cells is therefore a 3 x 3
solve of their summed moments, and its squared error over a cell is a dot product. Later stages
read no pixels until the labels return to full resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.geometry.robust import median
from plane_detector.segmentation.cells.plane_fit import MIN_EIGENVALUE

# The number of cells hardly depends on the image size: the cells grow with the image.
# tuned: benchmark sensitivity; not flat: precision -0.044 at 0.7 times, -0.013 at 1.4 times.
CELLS_PER_IMAGE = 4800
# tuned: rooms and lived-in rooms of seeds below 9000: flat from 0.05 to 0.5; of lidar frames 0.05
# of the pixels lose their label at 0.3, 0.27 at 0.5, and none gains one at 0.05.
MIN_VALID_SHARE = 0.15
# Columns of CellGrid.moments: sums over the pixels of 1, x, y, xx, xy, yy, d, xd, yd, dd.
N, X, Y, XX, XY, YY, D, XD, YD, DD = range(10)


@dataclass(frozen=True)
class DisparityImage:
    """Disparity (H, W) float32, and where it is valid, (H, W) bool."""

    values: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True)
class CellGrid:
    """
    Moments and the local plane of each cell, row by row.

    x and y are pixels from the image centre divided by the image width, d is 1/depth.

    Attributes
    ----------
    size_px : int
        Side of a cell.
    width_px : int
        Width of the image, the unit of x and y.
    origin : (float, float)
        x and y of the first pixel.
    shape : (int, int)
        Rows and columns of cells, R x C.
    moments : (R * C, 10) float64
        See the column names of this module.
    mean : (R * C, 3) float64
        Mean x, y and d of the valid pixels.
    slope : (R * C, 2) float64
        dd/dx and dd/dy of the cell's own least-squares plane.
    residual_rms : (R * C,) float64
        Root mean square of d about that plane.
    usable : (R * C,) bool
        The valid pixels are enough, and not on one line, to determine the cell's own plane.
    sparsity : (R * C, 2) float64
        Additional variances of the cell's mean and slope due to missing pixels, as multiples of
        the variance of a pixel; 0 for full cells.
    normal_slope : (R * C, 2) float64
        dd/dx and dd/dy by the normals of a network; NaN where it gives none.

    """

    size_px: int
    width_px: int
    origin: tuple[float, float]
    shape: tuple[int, int]
    moments: np.ndarray
    mean: np.ndarray
    slope: np.ndarray
    residual_rms: np.ndarray
    usable: np.ndarray
    sparsity: np.ndarray
    normal_slope: np.ndarray

    @cached_property
    def typical_disparity(self) -> float:
        """The median disparity of the usable cells; 0 when there is none."""
        return median(self.mean[:, 2][self.usable]) if self.usable.any() else 0.0

    def planes_in_pixels(self, planes: np.ndarray) -> np.ndarray:
        """Return a, b, c (K, 3) of d = a u + b v + c in columns and rows of the image."""
        pixel = 1 / self.width_px
        return planes @ np.array([[pixel, 0, self.origin[0]], [0, pixel, self.origin[1]],
                                  [0, 0, 1]])


def cell_size(shape: tuple[int, int]) -> int:
    """Return the side of the cells of an image in pixels."""
    return max(1, round((shape[0] * shape[1] / CELLS_PER_IMAGE) ** 0.5))


def pixel_frame(shape: tuple[int, int],
                part: tuple[slice, slice] = np.s_[0:, 0:]) -> tuple[float, float, float]:
    """Return the width of an image in pixels, and x and y of the first pixel of a part of it."""
    height, width = shape
    return (float(width), (part[1].start - (width - 1) / 2) / width,
            (part[0].start - (height - 1) / 2) / width)


def build_cell_grid(image: DisparityImage, size: int = 0, wanted: np.ndarray | None = None,
                    frame: tuple[float, float, float] | None = None) -> CellGrid:
    """
    Build the grid of cells of a disparity image.

    Parameters
    ----------
    image : DisparityImage
    size : int
        Side of the cells in pixels; 0: that of :func:`cell_size`.
    wanted : (R * C,) bool, optional
        Cells to fill; the others stay empty. Default: all.
    frame : (float, float, float), optional
        If the image is a part of another one: the :func:`pixel_frame` of this part.

    """
    height, width = image.valid.shape
    size = size or cell_size((height, width))
    frame = frame or pixel_frame((height, width))
    shape = -(-height // size), -(-width // size)
    if wanted is None:
        wanted = np.ones(shape[0] * shape[1], bool)
    fields = _sum_up(image.values, image.valid, size, frame, wanted)
    no_slopes = np.full((len(wanted), 2), np.nan)
    return CellGrid(size, int(frame[0]), frame[1:], shape, *fields, no_slopes)


@kernel('Tuple((float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1], boolean[::1], '
        'float64[:, ::1]))(float32[:, ::1], boolean[:, ::1], int64, UniTuple(float64, 3), '
        'boolean[::1])')
def _sum_up(disparity, valid, size, frame, wanted):
    """Return the fields of the cells from ``moments`` to ``sparsity``."""
    rows, columns = -(-disparity.shape[0] // size), -(-disparity.shape[1] // size)
    moments, mean = np.zeros((rows * columns, 10)), np.zeros((rows * columns, 3))
    slope, rms = np.zeros((rows * columns, 2)), np.zeros(rows * columns)
    usable, sparsity = np.zeros(rows * columns, np.bool_), np.zeros((rows * columns, 2))
    sums, m = np.empty((6, columns * size), np.float32), np.empty(10)
    reference, pixel = np.empty(columns * size, np.float32), 1 / frame[0]
    for row in range(rows):
        first, last = columns, -1
        for column in range(columns):
            if wanted[row * columns + column]:
                first, last = min(first, column), column
        if last >= 0:
            _sum_up_columns(disparity, valid, (row * size, size, first, last), reference, sums)
        y = frame[2] + (row * size + (size - 1) / 2) * pixel
        for column in range(first, last + 1):
            i, left = row * columns + column, column * size
            if not wanted[i] or not _sum_up_cell(sums, left, size, m):
                continue
            usable[i], rms[i], slope[i, 0], slope[i, 1], sparsity[i, 0], sparsity[i, 1] = (
                _fit_cell(m, size, frame[0]))
            _shift(m, frame[1] + (left + (size - 1) / 2) * pixel, y, reference[left], pixel,
                   moments[i])
            per = 1 / m[0]
            mean[i, 0], mean[i, 1], mean[i, 2] = (moments[i, 1] * per, moments[i, 2] * per,
                                                  moments[i, 6] * per)
    return moments, mean, slope, rms, usable, sparsity


@kernel('Tuple((boolean, float64, float64, float64, float64, float64))'
        '(float64[::1], int64, float64)')
def _fit_cell(m, size, width):
    """Return if a cell of moments m, in pixels, is usable, its rms, its slope, its sparsity."""
    area, n, per = np.float64(size * size), m[0], 1 / m[0]
    whole = (area - 1) * (1 / 12)
    mx, my, md = m[1] * per, m[2] * per, m[6] * per
    xx, xy, yy = m[3] * per - mx * mx, m[4] * per - mx * my, m[5] * per - my * my
    xd, yd, dd = m[7] * per - mx * md, m[8] * per - my * md, m[9] * per - md * md
    determinant = xx * yy - xy * xy
    is_usable = (n >= max(MIN_VALID_SHARE * area, 4.0)) & (
        determinant > MIN_EIGENVALUE * whole * whole)
    slope_x = slope_y = of_mean = of_slope = 0.0
    if is_usable:
        inverse = 1 / determinant
        slope_x, slope_y = (yy * xd - xy * yd) * inverse, (xx * yd - xy * xd) * inverse
        if n < area:
            of_mean = per - 1 / area
            of_slope = max((xx + yy) / 2 * per * inverse - 1 / (area * whole), 0.0) * width**2
    rms = np.sqrt(max(dd - slope_x * xd - slope_y * yd, 0.0))
    return is_usable, rms, slope_x * width, slope_y * width, of_mean, of_slope


@kernel('void(float32[:, ::1], boolean[:, ::1], UniTuple(int64, 4), float32[::1], '
        'float32[:, ::1])')
def _sum_up_columns(disparity, valid, band, reference, sums):
    """
    Sum up the columns of some cells of a row, ``band``: its top, their side, the first, the last.

    Writes the sums of n, y, yy, d, yd and dd of each column, with y in pixels from the centre of
    the cells and d relative to ``reference``, a value in the middle row of each cell.
    """
    top, size, first, last = band
    bottom, end = min(top + size, disparity.shape[0]), min((last + 1) * size, disparity.shape[1])
    middle = (top + bottom) // 2
    sums[:, first * size:(last + 1) * size] = 0
    for left in range(first * size, end, size):
        u = left
        while u < min(left + size, end) - 1 and not valid[middle, u]:
            u += 1
        for k in range(left, left + size):
            reference[k] = disparity[middle, u]
    n, d = np.empty(end - first * size, np.float32), np.empty(end - first * size, np.float32)
    here = reference[first * size:end]
    for v in range(top, bottom):
        row, is_valid = disparity[v, first * size:end], valid[v, first * size:end]
        for u in range(len(n)):
            n[u] = np.float32(is_valid[u])
            d[u] = (row[u] - here[u]) * n[u]
        _add_powers(n, d, np.float32(v - top - (size - 1) / 2), sums, first * size)


@kernel('void(float32[::1], float32[::1], float32, float32[:, ::1], int64)')
def _add_powers(n, d, y, sums, first):
    """Add n, y n, y**2 n, d, y d and d**2 to the sums; so few arrays at once are vectorised."""
    end = first + len(n)
    sum_n, sum_y, sum_yy = sums[0, first:end], sums[1, first:end], sums[2, first:end]
    sum_d, sum_yd, sum_dd = sums[3, first:end], sums[4, first:end], sums[5, first:end]
    for u in range(len(n)):
        sum_n[u] += n[u]
        sum_y[u] += n[u] * y
        sum_yy[u] += n[u] * (y * y)
    for u in range(len(n)):
        sum_d[u] += d[u]
        sum_yd[u] += d[u] * y
        sum_dd[u] += d[u] * d[u]


@kernel('boolean(float32[:, ::1], int64, int64, float64[::1])')
def _sum_up_cell(sums, left, size, m):
    """Write the moments of a cell about its centre, in pixels; return whether it has any."""
    n = m_x = m_y = xx = xy = yy = d = xd = yd = dd = np.float32(0)
    middle = np.float32((size - 1) / 2)
    for k in range(size):
        u, x = np.uint64(left + k), np.float32(k) - middle  # unsigned: no wrap-around check
        n += sums[0, u]
        m_x += sums[0, u] * x
        m_y += sums[1, u]
        xx += sums[0, u] * (x * x)
        xy += sums[1, u] * x
        yy += sums[2, u]
        d += sums[3, u]
        xd += sums[3, u] * x
        yd += sums[4, u]
        dd += sums[5, u]
    m[0], m[1], m[2], m[3], m[4], m[5] = n, m_x, m_y, xx, xy, yy
    m[6], m[7], m[8], m[9] = d, xd, yd, dd
    return n > 0


@kernel('void(float64[::1], float64, float64, float64, float64, float64[::1])')
def _shift(m, x, y, d, pixel, out):
    """Write moments (10,) with the origin at 0 of m, in pixels, whose origin is at x, y, d."""
    n, m_x, m_y, m_d = m[0], m[1] * pixel, m[2] * pixel, m[6]
    sum_x, sum_y = m_x + n * x, m_y + n * y
    out[0], out[1], out[2] = n, sum_x, sum_y
    out[3] = m[3] * pixel**2 + x * (m_x + sum_x)
    out[4] = m[4] * pixel**2 + x * m_y + y * sum_x
    out[5] = m[5] * pixel**2 + y * (m_y + sum_y)
    out[6] = m_d + n * d
    out[7] = m[7] * pixel + x * m_d + d * sum_x
    out[8] = m[8] * pixel + y * m_d + d * sum_y
    out[9] = m[9] + d * (2 * m_d + n * d)
