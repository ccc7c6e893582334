# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The image as a grid of square cells, each summarised by the moments of its disparity.

A plane is affine in (x, y, 1/z). The least-squares plane of any set of cells is therefore a 3 x 3
solve of their summed moments, and its squared error over a cell is a dot product. Later stages
read no pixels until the labels return to full resolution.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import median
from plane_detector.types import CameraIntrinsics

# The number of cells hardly depends on the image size: the cells grow with the image.
# tuned: benchmark sensitivity of bb08c3e; not flat: precision -0.044 at 0.7 times, -0.013 at
# 1.4 times.
CELLS_PER_IMAGE = 4800
# tuned: rooms and lived-in rooms of seeds below 9000: flat from 0.05 to 0.5; of lidar frames 0.05
# of the pixels lose their label at 0.3, 0.27 at 0.5, and none gains one at 0.05.
MIN_VALID_SHARE = 0.15
# derived: a cell with one pixel in five missing still has more than the three that determine its
# plane, so its residuals show noise.
MIN_CELL_SIDE_PX = 3
# Focal lengths over the image width, and x and y of the principal point, if the camera is not
# known.
# chosen: 64 degrees; most cameras of robots and phones are within a third of it.
TYPICAL_LENS = np.array([0.8, 0.8, 0.0, 0.0])
# derived: columns of moments, sums over pixels of 1, x, y, xx, xy, yy, d, xd, yd and dd.
N, X, Y, XX, XY, YY, D, XD, YD, DD = range(10)

# chosen: far above the rounding of float64. A smaller eigenvalue, relative to the largest one,
# counts as zero: the pixels lie on a line, or there are too few cells for the fit.
MIN_EIGENVALUE = 1e-10


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
    """

    size_px: int  # side of a cell
    width_px: int  # width of the image, the unit of x and y
    origin: tuple[float, float]  # x and y of the first pixel
    shape: tuple[int, int]  # rows and columns of cells, R x C
    # (R * C, 10) float64: sums over the valid pixels, see N
    moments: np.ndarray
    mean: np.ndarray  # (R * C, 3) float64: mean x, y and d of the valid pixels
    slope: np.ndarray  # (R * C, 2) float64: dd/dx and dd/dy of the cell's own least-squares plane
    residual_rms: np.ndarray  # (R * C,) float64: root mean square of d about that plane
    # (R * C,) bool: the valid pixels are enough, and not on one line, to determine the cell's own
    # plane
    usable: np.ndarray
    # (R * C, 2) float64: additional variances of the cell's mean and slope due to missing pixels,
    # as multiples of the variance of a pixel; 0 for full cells
    sparsity: np.ndarray
    # (R * C, 2) float64: dd/dx and dd/dy from the normals of a network, NaN where there are none;
    # (0, 2) without normals
    normal_slope: np.ndarray
    # (4,) float64: focal lengths along x and y, and x and y of the principal point
    lens: np.ndarray
    # (R * C,) float64: half the mean squared difference of neighbouring pixels in and around the
    # cell, see :func:`~plane_detector.segmentation.cells.noise.roughness_of`; (0,) if not measured
    roughness: np.ndarray = field(default_factory=lambda: np.empty(0))
    # (R * C,) bool: pixels behind a mesh were left out; (0,) if there are none
    is_mesh: np.ndarray = field(default_factory=lambda: np.empty(0, bool))

    @cached_property
    def typical_disparity(self) -> float:
        """The median disparity of the usable cells; 0 when there is none."""
        return median(self.mean[:, 2][self.usable]) if self.usable.any() else 0.0

    def planes_in_pixels(self, planes: np.ndarray) -> np.ndarray:
        """Return a, b, c (K, 3) of d = a u + b v + c in columns and rows of the image."""
        pixel = 1 / self.width_px
        return planes @ np.array([[pixel, 0, self.origin[0]], [0, pixel, self.origin[1]],
                                  [0, 0, 1]])


def lens_of(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the lens (4,) in the coordinates of the cells: f_x, f_y, x and y of its centre."""
    width, height = intrinsics.width, intrinsics.height
    return np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx - (width - 1) / 2,
                     intrinsics.cy - (height - 1) / 2]) / width


def pixel_frame(shape: tuple[int, int], first_row: int = 0) -> tuple[float, float, float]:
    """Return the width of an image in pixels, and x and y of the first pixel of a row of it."""
    height, width = shape
    return float(width), -(width - 1) / 2 / width, (first_row - (height - 1) / 2) / width


def build_cell_grid(image: DisparityImage, size: int = 0, wanted: np.ndarray | None = None,
                    frame: tuple[float, float, float] | None = None,
                    lens: np.ndarray = TYPICAL_LENS) -> CellGrid:
    """
    Build the grid of cells of a disparity image.

    Parameters
    ----------
    image : DisparityImage
    size : int
        Side of the cells in pixels; 0: by CELLS_PER_IMAGE.
    wanted : (R * C,) bool, optional
        Cells to fill; the others stay empty. Default: all.
    frame : (float, float, float), optional
        If the image is some rows of another one: the :func:`pixel_frame` of these.
    lens : (4,) float64
        See :func:`lens_of`.

    """
    height, width = image.valid.shape
    size = size or max(MIN_CELL_SIDE_PX, round((height * width / CELLS_PER_IMAGE) ** 0.5))
    frame = frame or pixel_frame((height, width))
    shape = -(-height // size), -(-width // size)
    if wanted is None:
        wanted = np.ones(shape[0] * shape[1], bool)
    moments = _sum_up(image.values, image.valid, size, frame, wanted)
    return CellGrid(size, int(frame[0]), frame[1:], shape, moments,
                    *_fit_cells(moments, size, int(frame[0])), np.empty((0, 2)), lens)


@kernel('float64[:, ::1](float32[:, ::1], boolean[:, ::1], int64, UniTuple(float64, 3), '
        'boolean[::1])')
def _sum_up(disparity, valid, size, frame, wanted):
    """Return the moments (R * C, 10) of the wanted cells."""
    rows, columns = -(-disparity.shape[0] // size), -(-disparity.shape[1] // size)
    width_px, first_x, first_y = frame
    moments, pixel = np.zeros((rows * columns, 10)), 1 / width_px
    sums = np.empty((6, columns * size), np.float32)
    reference = np.empty(columns * size, np.float32)
    for row in range(rows):
        end, y = 0, first_y + (row * size + (size - 1) / 2) * pixel
        while end < columns:
            begin, is_wanted = end, wanted[row * columns + end]
            while end < columns and wanted[row * columns + end] == is_wanted:
                end += 1
            if not is_wanted:
                continue
            band = row * size, size, begin * size, end * size
            _sum_up_columns(disparity, valid, band, reference, sums)
            for column in range(begin, end):
                left = column * size
                centre = first_x + (left + (size - 1) / 2) * pixel, y, np.float64(reference[left])
                _sum_up_cell(sums, (left, size), centre, pixel, moments[row * columns + column])
    return moments


@kernel('void(float32[:, ::1], boolean[:, ::1], UniTuple(int64, 4), float32[::1], '
        'float32[:, ::1])')
def _sum_up_columns(disparity, valid, band, reference, sums):
    """
    Sum up the columns of some cells of a row, ``band``: its top, their side, its left and right.

    Writes the sums of n, y, yy, d, yd and dd of each column, with y in pixels from the centre of
    the cells and d relative to ``reference``, the valid value nearest to the middle of each cell.
    """
    top, size, begin, end = band
    bottom, right = min(top + size, disparity.shape[0]), min(end, disparity.shape[1])
    n, d = np.zeros(end - begin, np.float32), np.zeros(end - begin, np.float32)
    middle = (top + bottom) // 2
    for left in range(begin, right, size):
        u, v, end_u = left, middle, min(left + size, right)
        while not valid[v, u]:
            u += 1
            if u == end_u:  # the next row, after the last one the first
                u, v = left, v + 1 if v + 1 < bottom else top
                if v == middle:
                    break
        value = disparity[v, u]
        for k in range(left, left + size):
            reference[k] = value
    sums[:, begin:end] = 0
    here = reference[begin:end]
    for v in range(top, bottom):
        row, is_valid = disparity[v, begin:right], valid[v, begin:right]
        for u in range(len(row)):
            n[u] = np.float32(is_valid[u])
            d[u] = (row[u] - here[u]) * n[u]
        _add_powers(n, d, np.float32(v - top - (size - 1) / 2), sums, begin)


@kernel('void(float32[::1], float32[::1], float32, float32[:, ::1], int64)')
def _add_powers(n, d, y, sums, begin):
    """Add n, y n, y**2 n, d, y d and d**2 to the sums; so few arrays at once are vectorised."""
    end = begin + len(n)
    sum_n, sum_y, sum_yy = sums[0, begin:end], sums[1, begin:end], sums[2, begin:end]
    sum_d, sum_yd, sum_dd = sums[3, begin:end], sums[4, begin:end], sums[5, begin:end]
    for u in range(len(n)):
        sum_n[u] += n[u]
        sum_y[u] += n[u] * y
        sum_yy[u] += n[u] * (y * y)
    for u in range(len(n)):
        sum_d[u] += d[u]
        sum_yd[u] += d[u] * y
        sum_dd[u] += d[u] * d[u]


@kernel('void(float32[:, ::1], UniTuple(int64, 2), UniTuple(float64, 3), float64, float64[::1])')
def _sum_up_cell(sums, extent, centre, pixel, out):
    """Write the moments of a cell from the sums of its columns about its centre x, y, d."""
    left, size = extent
    n = m_x = m_y = xx = xy = yy = m_d = xd = yd = dd = np.float32(0)
    middle = np.float32((size - 1) / 2)
    for k in range(size):
        u, x = np.uint64(left + k), np.float32(k) - middle  # unsigned: no wrap-around check
        n += sums[0, u]
        m_x += sums[0, u] * x
        m_y += sums[1, u]
        xx += sums[0, u] * (x * x)
        xy += sums[1, u] * x
        yy += sums[2, u]
        m_d += sums[3, u]
        xd += sums[3, u] * x
        yd += sums[4, u]
        dd += sums[5, u]
    x, y, d = centre
    of_x, of_y, of_d = m_x * pixel, m_y * pixel, np.float64(m_d)
    sum_x, sum_y = of_x + n * x, of_y + n * y
    out[N], out[X], out[Y], out[D] = n, sum_x, sum_y, of_d + n * d
    out[XX] = xx * pixel**2 + x * (of_x + sum_x)
    out[XY] = xy * pixel**2 + x * of_y + y * sum_x
    out[YY] = yy * pixel**2 + y * (of_y + sum_y)
    out[XD] = xd * pixel + x * of_d + d * sum_x
    out[YD] = yd * pixel + y * of_d + d * sum_y
    out[DD] = dd + d * (2 * of_d + n * d)


@kernel('Tuple((float64[:, ::1], float64[:, ::1], float64[::1], boolean[::1], float64[:, ::1]))'
        '(float64[:, ::1], int64, int64)', is_short=True)
def _fit_cells(moments, size, width):
    """Return the fields of the cells from ``mean`` to ``sparsity``."""
    count, area = len(moments), np.float64(size * size)
    mean, slope, rms = np.zeros((count, 3)), np.zeros((count, 2)), np.zeros(count)
    usable, sparsity = np.zeros(count, np.bool_), np.zeros((count, 2))
    of_full = 12 * width**2 / (area * (area - 1))
    for i in range(count):
        if moments[i, N] == 0:
            continue
        m, per = moments[i], 1 / moments[i, N]  # no reference to a row across branches: faster
        n, x, y, d = m[N], m[X] * per, m[Y] * per, m[D] * per
        xx, xy, yy = m[XX] * per - x * x, m[XY] * per - x * y, m[YY] * per - y * y
        mean[i, 0], mean[i, 1], mean[i, 2] = x, y, d
        a, b, c = fit_plane(m)
        square = max(squared_error(a, b, c, m), 0.0)
        usable[i] = n >= max(MIN_VALID_SHARE * area, 4.0) and not np.isnan(a)
        if usable[i]:
            slope[i, 0], slope[i, 1], rms[i] = a, b, np.sqrt(square * per)
        if usable[i] and n < area:
            sparsity[i, 0] = per - 1 / area
            sparsity[i, 1] = max((xx + yy) / 2 * per / (xx * yy - xy * xy) - of_full, 0.0)
    return mean, slope, rms, usable, sparsity


@kernel('void(float64[::1], float64[::1])')
def add_moments(total, moments):
    """Add moments (10,); on a row of a matrix six times as fast as with its index in the loop."""
    for j in range(10):
        total[j] += moments[j]


@kernel('UniTuple(float64, 3)(float64[::1])')
def fit_plane(moments):
    """
    Fit the least-squares plane d = a x + b y + c.

    Parameters
    ----------
    moments : (10,) float64
        Sums over pixels.

    Returns
    -------
    a, b, c : float
        NaN where the pixels lie on a line or are fewer than three.

    """
    per = 1 / max(moments[N], 1.0)
    x, y, d = moments[X] * per, moments[Y] * per, moments[D] * per
    xx, xy, yy = moments[XX] * per - x * x, moments[XY] * per - x * y, moments[YY] * per - y * y
    xd, yd = moments[XD] * per - x * d, moments[YD] * per - y * d
    determinant = xx * yy - xy * xy
    if not determinant > MIN_EIGENVALUE * (xx + yy) ** 2:
        return np.nan, np.nan, np.nan
    inverse = 1 / determinant
    a, b = (yy * xd - xy * yd) * inverse, (xx * yd - xy * xd) * inverse
    return a, b, d - a * x - b * y


@kernel('UniTuple(float64, 3)(float64, float64, float64, float64[::1])')
def normal_of(a, b, c, lens):
    """Return a normal of the plane 1/z = a x + b y + c, as long as 1 over its distance."""
    return a * lens[0], b * lens[1], a * lens[2] + b * lens[3] + c


@kernel('float64(float64, float64, float64, float64[::1])')
def squared_error(a, b, c, moments):
    """Return the squared error of a plane over the pixels of moments (10,)."""
    return (moments[DD] + c * (c * moments[N] + 2 * (a * moments[X] + b * moments[Y] - moments[D]))
            + a * (a * moments[XX] + 2 * (b * moments[XY] - moments[XD]))
            + b * (b * moments[YY] - 2 * moments[YD]))


@kernel('float64[:, ::1](float64[:, ::1])', is_short=True)
def fit_planes(moments):
    """Fit a plane to each row of moments (K, 10), as :func:`fit_plane` does; (K, 3)."""
    planes = np.empty((len(moments), 3))
    for k in range(len(moments)):
        planes[k, 0], planes[k, 1], planes[k, 2] = fit_plane(moments[k])
    return planes


@kernel('float64(float64[:, ::1], int64, float64[::1])')
def solve_least_squares(products, terms, coefficients):
    """
    Solve a linear least-squares problem by Gauss-Jordan elimination.

    Parameters
    ----------
    products : (m, m) float64
        Sums of the products of any two columns: the terms, and last the values.
    terms : int
        How many of the first terms to use.
    coefficients : (m,) float64
        Output: the first ``terms`` are written; 0 for terms that the data do not determine.

    Returns
    -------
    float
        Squared error.

    """
    last = len(products) - 1
    work = products.copy()
    for k in range(terms):
        pivot = work[k, k]
        is_open = pivot <= MIN_EIGENVALUE * products[k, k]
        for j in range(last + 1):
            work[k, j] = 0.0 if is_open else work[k, j] / pivot
        for i in range(last + 1):
            factor = 0.0 if i == k else work[i, k]
            for j in range(last + 1):
                work[i, j] -= factor * work[k, j]
    for k in range(terms):
        coefficients[k] = work[k, last]
    return max(work[last, last], 0.0)
