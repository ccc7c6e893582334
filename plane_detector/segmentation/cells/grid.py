# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The picture as a grid of square cells, each summed up by the moments of its disparity.

A plane is affine in (x, y, 1/z), so the least-squares plane through any set of cells is a 3 x 3
solve of their added moments, and its squared error over any cell a dot product: no stage after
this one touches a pixel until the labels are brought back to full resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

# The cells' number hardly depends on the picture's size: with it grow their sides.
CELLS_PER_PICTURE = 4800
# A few lines of a lidar are enough of a cell, one line is not.
MIN_VALID_SHARE = 0.15
MIN_SPREAD = 0.01
# Columns of CellGrid.moments: sums over the pixels of 1, x, y, xx, xy, yy, d, xd, yd, dd.
N, X, Y, XX, XY, YY, D, XD, YD, DD = range(10)


@dataclass(frozen=True)
class CellGrid:
    """
    Moments and the local plane of each cell, row by row.

    x and y are pixels from the centre of the picture divided by its width, d is 1/depth.

    Attributes
    ----------
    size_px : int
        Side of a cell.
    width_px : int
        Width of the picture, the unit of x and y.
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
    inner_rms : (R * C,) float64
        Root mean square of d about that plane.
    usable : (R * C,) bool
        Enough of the cell is valid, and spread well enough, to determine its own plane.

    """

    size_px: int
    width_px: int
    origin: tuple[float, float]
    shape: tuple[int, int]
    moments: np.ndarray
    mean: np.ndarray
    slope: np.ndarray
    inner_rms: np.ndarray
    usable: np.ndarray

    @cached_property
    def typical_disparity(self) -> float:
        """The median disparity of the usable cells; 0 when there is none."""
        return median(self.mean[self.usable, 2]) if self.usable.any() else 0.0

    @cached_property
    def mean_moments(self) -> np.ndarray:
        """The moments (R * C, 10) of the cells' means, each cell counting as one pixel."""
        x, y, d = self.mean.T
        return np.array([np.ones_like(x), x, y, x * x, x * y, y * y, d, x * d, y * d, d * d]).T


def median(values: np.ndarray) -> float:
    """Return the median of some values (n,), none of them NaN, without numpy's overhead."""
    middle = len(values) // 2
    low, high = middle - 1 + len(values) % 2, middle
    ordered = np.partition(values, (low, high))
    return float((ordered[low] + ordered[high]) / 2)


def cell_size(shape: tuple[int, int]) -> int:
    """Return the side of the cells of a picture in pixels."""
    return max(1, round(np.sqrt(shape[0] * shape[1] / CELLS_PER_PICTURE)))


def picture_coordinates(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return x of each column (W,) and y of each row (H,) as the moments use them, float64."""
    height, width = shape
    return ((np.arange(width) - (width - 1) / 2) / width,
            (np.arange(height) - (height - 1) / 2) / width)


def make_cells(disparity: np.ndarray, valid: np.ndarray, size: int = 0,
               corner_px: tuple[int, int] = (0, 0),
               picture: tuple[int, int] | None = None) -> CellGrid:
    """
    Sum up a disparity image, or a cut-out of one.

    Parameters
    ----------
    disparity : (H, W) float32
        1/depth, 0 where not valid.
    valid : (H, W) bool
    size : int
        Side of the cells in pixels, 0: as :func:`cell_size` has it.
    corner_px : (int, int)
        Row and column in the picture of the first pixel of a cut-out.
    picture : (int, int), optional
        Height and width of the picture; default: those of the disparity image.

    Returns
    -------
    CellGrid

    """
    picture = picture or disparity.shape
    size, width = size or cell_size(picture), picture[1]
    y, x = picture_coordinates(picture)[::-1]
    origin = float(x[corner_px[1]]), float(y[corner_px[0]])
    shape = tuple(-(-side // size) for side in disparity.shape)
    local, middle = _local_moments(disparity, valid, size, width)
    slope, inner_rms, usable = _own_planes(local, size, width)
    moments = _shifted(local, *_cell_centres(shape, size, width, origin), middle)
    mean = moments[[X, Y, D]] / np.maximum(moments[N], 1)
    return CellGrid(size, width, origin, shape, moments.T, mean.T, slope, inner_rms, usable)


def blocks(image: np.ndarray, size: int, fill: float = 0) -> np.ndarray:
    """Return the image (H, W) as cells (R, s, C, s), filled up to whole ones."""
    missing = [(0, -side % size) for side in image.shape]
    if any(end for _, end in missing):
        image = np.pad(image, missing, constant_values=fill)
    return image.reshape(image.shape[0] // size, size, -1, size)


def pixels_of_cells(image: np.ndarray, size: int, at_row: np.ndarray | slice = np.s_[:],
                    at_column: np.ndarray | slice = np.s_[:], fill: float = 0) -> np.ndarray:
    """Return the pixels (n, s, s) of some cells (n,) of an image (H, W), or of all."""
    whole = np.ascontiguousarray(blocks(image, size, fill))
    # Each row of a cell moves as one item, several times faster than pixel by pixel.
    rows = whole.view(np.dtype((np.void, size * image.itemsize)))[..., 0].transpose(0, 2, 1)
    return np.ascontiguousarray(rows[at_row, at_column]).view(image.dtype).reshape(-1, size, size)


def around(labels: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Return the labels, of (R, C), of some cells (n,) and of their eight neighbours, (n, 9)."""
    return labels.ravel()[_neighbourhoods(labels.shape)[cell]]


@lru_cache(maxsize=8)
def _neighbourhoods(shape: tuple[int, int]) -> np.ndarray:
    """Return the nine cells around each; where the grid ends, its last ones again."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    padded = np.pad(index, 1, mode='edge')
    return np.stack([padded[i:i + shape[0], j:j + shape[1]].ravel()
                     for i in range(3) for j in range(3)], axis=1)


def block_coordinates(grid: CellGrid, at_row: np.ndarray,
                      at_column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x (n, 1, s) and y (n, s, 1) of the pixels of some cells (n,), float64."""
    offset = np.arange(grid.size_px)
    x, y = (first + (at[:, None] * grid.size_px + offset) / grid.width_px
            for first, at in zip(grid.origin, (at_column, at_row), strict=True))
    return x[:, None, :], y[:, :, None]


@lru_cache(maxsize=8)
def _cell_centres(shape: tuple[int, int], size: int, width: int,
                  origin: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the middle of each cell, (R * C,) each."""
    y, x = (first + (size * np.arange(count) + (size - 1) / 2) / width
            for first, count in zip(origin[::-1], shape, strict=True))
    return np.tile(x, shape[0]), np.repeat(y, shape[1])


def _local_moments(disparity: np.ndarray, valid: np.ndarray, size: int,
                   width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the moments (10, n) about each cell's centre and about ``middle`` (n,)."""
    basis = _pixel_basis(size, width)
    full = valid.all() and not any(side % size for side in valid.shape)
    disparity = pixels_of_cells(disparity, size).reshape(-1, size**2)
    if full:
        count = basis.sum(axis=0)[None]
    else:
        valid = pixels_of_cells(valid, size).reshape(-1, size**2)
        count = valid.astype(np.float32) @ basis
    # Brought to about zero cell by cell, float32 sums are exact enough.
    middle = disparity.sum(axis=1) / np.maximum(count[:, 0], 1)
    centred = disparity - middle[:, None]
    if not full:
        centred *= valid
    moments = np.empty((10, len(disparity)))
    moments[:6] = count.T
    moments[6:9] = (centred @ basis[:, :3]).T
    moments[9] = np.einsum('ns,ns->n', centred, centred)
    return moments, middle.astype(float)


@lru_cache(maxsize=8)
def _pixel_basis(size: int, width: int) -> np.ndarray:
    """Return 1, x, y, xx, xy, yy of a cell's pixels about its centre, (s * s, 6) float32."""
    offset = (np.arange(size) - (size - 1) / 2) / width
    x, y = np.tile(offset, size), np.repeat(offset, size)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1).astype(np.float32)


def _own_planes(local: np.ndarray, size: int,
                width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit each cell's own plane: slope (R * C, 2), rms about it (R * C,), usable (R * C,)."""
    n = np.maximum(local[N], 1)
    x, y, xx, xy, yy, d, xd, yd, dd = local[X:] / n
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    xd, yd, dd = xd - x * d, yd - y * d, dd - d * d
    determinant = xx * yy - xy * xy
    whole = ((size**2 - 1) / 12 / width**2) ** 2
    enough = ((local[N] >= max(MIN_VALID_SHARE * size**2, 4))
              & (determinant > MIN_SPREAD * whole))
    divisor = np.where(enough, determinant, 1.0)
    slope_x, slope_y = (yy * xd - xy * yd) / divisor, (xx * yd - xy * xd) / divisor
    variance = dd - slope_x * xd - slope_y * yd
    return (np.array([slope_x, slope_y]) * enough).T, np.sqrt(np.maximum(variance, 0)), enough


def _shifted(local: np.ndarray, x: np.ndarray, y: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Move the origin of each cell's moments (10, n): from its own centre to x, y, d = 0."""
    n, sum_x, sum_y, xx, xy, yy, sum_d, xd, yd, dd = local
    return np.array([
        n, sum_x + n * x, sum_y + n * y,
        xx + (2 * x * sum_x + n * x * x),
        xy + (x * sum_y + y * sum_x + n * x * y),
        yy + (2 * y * sum_y + n * y * y),
        sum_d + n * d,
        xd + (x * sum_d + d * sum_x + n * x * d),
        yd + (y * sum_d + d * sum_y + n * y * d),
        dd + (2 * d * sum_d + n * d * d)])


def fit_planes(moments: np.ndarray) -> np.ndarray:
    """
    Fit least-squares planes d = a x + b y + c.

    Parameters
    ----------
    moments : (10,) or (K, 10) float64
        Added up over the pixels of each plane.

    Returns
    -------
    (3,) or (K, 3) float64
        a, b, c; NaN where the pixels lie on a line or are fewer than three.

    """
    x, y, xx, xy, yy, d, xd, yd = moments.T[X:DD] / np.maximum(moments.T[N], 1)
    xx, xy, yy, xd, yd = xx - x * x, xy - x * y, yy - y * y, xd - x * d, yd - y * d
    determinant = xx * yy - xy * xy
    divisor = np.where(determinant > 1e-6 * (xx + yy) ** 2, determinant, np.nan)
    a, b = (yy * xd - xy * yd) / divisor, (xx * yd - xy * xd) / divisor
    return np.array([a, b, d - a * x - b * y]).T


def fit_plane(moments: np.ndarray) -> np.ndarray:
    """Fit one plane to moments (10,), as :func:`fit_planes` does, without its overhead; (3,)."""
    n, x, y, xx, xy, yy, d, xd, yd, _ = moments.tolist()
    n = max(n, 1.0)
    x, y, d = x / n, y / n, d / n
    xx, xy, yy, xd, yd = (xx / n - x * x, xy / n - x * y, yy / n - y * y, xd / n - x * d,
                          yd / n - y * d)
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6 * (xx + yy) ** 2:
        return np.full(3, np.nan)
    a, b = (yy * xd - xy * yd) / determinant, (xx * yd - xy * xd) / determinant
    return np.array([a, b, d - a * x - b * y])


def error_weights(planes: np.ndarray) -> np.ndarray:
    """Return the weights, (10,) or (K, 10), of the moments in the squared error of planes."""
    a, b, c = planes.T
    return np.array([c * c, 2 * a * c, 2 * b * c, a * a, 2 * a * b, b * b, -2 * c, -2 * a, -2 * b,
                     np.ones_like(a)]).T


def squared_error(planes: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Return the squared error, () or (K,), of planes over the pixels of moments (K, 10+)."""
    return (error_weights(planes).T * moments.T[:10]).sum(axis=0)
