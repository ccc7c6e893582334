# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""An image as cells weighted by its noise, and the planes found, by cells and by pixels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.config import Config
from plane_detector.segmentation.cells.grid import (
    DD,
    XD,
    YD,
    CellGrid,
    D,
    DisparityImage,
    N,
    X,
    Y,
    add_moments,
    fit_planes,
)
from plane_detector.segmentation.cells.noise import MAX_STEEPNESS, DepthKind, Noise

# derived: columns of WeightedCells.table: means of x, y and d, dd/dx and dd/dy, the inverse
# variances of these means and slopes, the expected squared error of the pixels about a plane, and
# how many times the variance of the image's noise a cell has.
(MEAN_X, MEAN_Y, MEAN_D, SLOPE_X, SLOPE_Y, MEAN_WEIGHT, SLOPE_WEIGHT, SQUARED_ERROR,
 LOCAL_RATIO) = range(9)
# A cell whose pixels deviate from its own plane by more than two sigma straddles an edge.
# tuned: benchmark sensitivity of bb08c3e; flat to 1.4 times; at 0.7 times recall -0.011.
MAX_PIXEL_VARIANCES = 4.0
# Points within this many standard deviations of a plane are inliers.
# chosen: one normal deviate in 370 is larger.
MAX_DEVIATIONS = 3.0
# The mean of chi-squared of cells about a joint plane is 1 if they are coplanar.
# tuned: rooms, lived-in rooms, curved scenes and real frames; not flat: at 0.7 times precision
# -0.02, at 1.4 times 0.06 more of curved surfaces have labels at noise 0.01.
MAX_JOINT_VARIANCES = 2.0
# Stereo matches windows of pixels: within this many along a side, the shared lateral noise is the
# same, so the mean of a cell does not average it out; its slope averages half of it out.
# tuned: 16 frames of today's sensors: SC .957 with 4 px in the tilt, .942 with 1 px in it, .956
# with half in it; NYU frames .904 at 1 px, .911 to .915 from 2 to 9; ABW 12.9 from 1 to 4.
LATERAL_WINDOW_PX = 4.0
# A cell has at most this many times the variance of the image's noise: sensors lose darker
# surfaces.
# chosen: a twentieth of the amplitude is twenty times the noise (Foix et al. 2011).
MAX_LOCAL_RATIO = 400.0
# chosen: avoids division by 0 for cells without depth; any positive number works.
MIN_VARIANCE = 1e-30
# chosen: a sixteenth of the pixels; a patch that is narrower on the image holds few of them.
PATCH_SCALE = 4
NO_PATCHES = NO_FACETS = np.zeros((0, 0), np.int32)


class NoiseOfCells(NamedTuple):
    """
    The noise that cells are tested with, squared; lengths in image widths.

    Attributes
    ----------
    mean, slope, pixel : float
        Variances of a full cell's mean and slope, and of a pixel.
    depth : float
        Lower bound of the variance of depth.
    disparity, disparity_slope : float
        That of the variance of the disparity, and of a slope by it.
    place : float
        Variance of the lateral position that a pixel samples.
    steepest : float
        Largest slope over 1/z.
    shared_px : float
        Number of pixels that share the error of their position.
    unbent : float
        Share of the smooth noise that does not bend whole planes.
    per_own : float
        The inverse of the share of a pixel's variance that its neighbour does not share; 0: the
        noise is not local.

    """

    mean: float
    slope: float
    pixel: float
    depth: float
    disparity: float
    disparity_slope: float
    place: float
    steepest: float
    shared_px: float
    unbent: float
    per_own: float


@dataclass(frozen=True)
class WeightedCells:
    """The cells and their noise."""

    grid: CellGrid
    is_planar: np.ndarray  # (R * C,) bool: the cell lies on one plane
    # (R * C, 9) float64: mean x, y and d, slope along x and y, the weights of mean and slope, the
    # expected squared error of the cell's pixels about the plane of a larger region, and the ratio
    # of its noise to that of the image. See MEAN_X
    table: np.ndarray

    @cached_property
    def least_variance(self) -> float:
        """The smallest variance of the mean of a cell."""
        return 1 / max(float(self.table[:, MEAN_WEIGHT].max(initial=0.0)), MIN_VARIANCE)


@dataclass(frozen=True)
class PlaneRegions:
    """Planes found on the cells."""

    labels: np.ndarray  # (R, C) int32: index into ``coefficients``, -1 none
    coefficients: np.ndarray  # (K, 3) float64: 1/z = a x + b y + c


def weigh_cells(grid: CellGrid, noise: Noise) -> WeightedCells:
    """
    Weigh each cell by the noise that it is tested with.

    The lower bound of the depth noise is one of disparity that falls with 1/z**2. In a cell of n =
    s * s pixels it tilts a least-squares plane by sqrt(12 / n) / s per pixel. Neighbouring pixels
    have the same quantisation error, which tilts a cell as a whole. The variance of far cells is
    at least that of the error which near cells leave in a common plane. The lateral noise is that
    of a pixel, times the slope; the pixels of a window share it. Where neighbouring pixels differ
    by more than the noise of the image, as on dark surfaces in time of flight, their differences
    determine the pixel noise, and the smooth noise is larger by the same ratio.
    """
    size = grid.size_px / grid.width_px
    is_local = noise.own_share > 0 and len(grid.roughness) > 0
    of_cells = NoiseOfCells(
        noise.mean_sigma**2, noise.slope_sigma**2, noise.pixel_sigma**2,
        depth=noise.depth_floor_m**2, disparity=noise.disparity_floor**2,
        disparity_slope=(noise.disparity_floor / size)**2,
        place=(noise.lateral_px / grid.width_px)**2, steepest=(MAX_STEEPNESS / grid.lens[0])**2,
        shared_px=1 + noise.lateral_shared * (LATERAL_WINDOW_PX**2 - 1),
        unbent=noise.bending**-2, per_own=1 / noise.own_share if is_local else 0.0)
    table, is_planar = _weigh((grid.moments, grid.mean, grid.slope, grid.sparsity),
                              (grid.residual_rms, grid.roughness), grid.usable, tuple(of_cells),
                              12 / (grid.size_px * size) ** 2)
    return WeightedCells(grid, is_planar, table)


@kernel('Tuple((float64[:, ::1], boolean[::1]))(UniTuple(float64[:, ::1], 4), '
        'UniTuple(float64[::1], 2), boolean[::1], UniTuple(float64, 11), float64)', is_short=True)
def _weigh(cells, pixels, usable, noise, per_slope):
    """Return the table of the cells and which of them are planar."""
    (smooth, smooth_slope, pixel, depth, disparity, disparity_slope, place, steepest, shared_px,
     unbent, per_own) = noise  # in the order of NoiseOfCells
    (moments, mean, slope, sparsity), (residual_rms, roughness) = cells, pixels
    table, is_planar = np.zeros((len(usable), 9)), np.zeros(len(usable), np.bool_)
    of_plane, filled = 0.0, 0
    for i in range(len(usable)):
        of_plane += mean[i, 2] ** 4
        filled += moments[i, N] > 0
    of_plane *= depth / max(filled, 1) ** 2
    for i in range(len(usable)):
        if moments[i, N] == 0:
            continue
        for k in range(3):
            table[i, MEAN_X + k] = mean[i, k]
        table[i, SLOPE_X], table[i, SLOPE_Y] = slope[i, 0], slope[i, 1]
        floor = depth * mean[i, 2] ** 4 + disparity + of_plane
        tilt = min(slope[i, 0] ** 2 + slope[i, 1] ** 2, steepest * mean[i, 2] ** 2)
        lateral = place * tilt
        excess = 0.0
        if per_own > 0:
            shown = (roughness[i] * per_own - floor - lateral) / max(pixel, MIN_VARIANCE)
            excess = min(max(shown, 1.0), MAX_LOCAL_RATIO) - 1
        table[i, LOCAL_RATIO] = 1 + excess
        local, of_pixel = 1 + excess * unbent, pixel * (1 + excess)
        of_mean = (smooth * local + floor + of_pixel * sparsity[i, 0]
                   + lateral * min(shared_px / moments[i, N], 1.0))
        of_slope = (smooth_slope * local + floor * per_slope + disparity_slope
                    + of_pixel * sparsity[i, 1]
                    + lateral * shared_px**0.5 * (per_slope + sparsity[i, 1]))
        of_pixel += floor + lateral
        table[i, MEAN_WEIGHT] = 1 / max(of_mean, MIN_VARIANCE)
        table[i, SLOPE_WEIGHT] = 1 / max(of_slope, MIN_VARIANCE)
        table[i, SQUARED_ERROR] = (of_mean + of_pixel) * moments[i, N]
        is_planar[i] = usable[i] and residual_rms[i] ** 2 < MAX_PIXEL_VARIANCES * of_pixel
    return table, is_planar


@dataclass(frozen=True)
class Frame:
    """An image, or a part of one, with its noise and the memory of the previous image."""

    image: DisparityImage
    grid: CellGrid  # of this image
    noise: Noise  # of this image; before the search its lower bound
    min_pixels: float  # smallest plane
    config: Config
    rng: np.random.Generator
    # (h, 4) float64: planes of the previous image, fitted to this one, and the factor on their
    # support
    known: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))

    @cached_property
    def kind(self) -> DepthKind:
        """Kind of its depth errors."""
        return self.noise.kind(self.grid.typical_disparity)

    @cached_property
    def cells(self) -> WeightedCells:
        """The cells of the grid, weighted by the noise."""
        return weigh_cells(self.grid, self.noise)


@kernel('float64(float64[:, ::1], int64, float64, float64, float64)')
def residual(table, i, a, b, c):
    """Return the mean disparity of cell i minus that of the plane d = a x + b y + c there."""
    return table[i, MEAN_D] - (a * table[i, MEAN_X] + b * table[i, MEAN_Y] + c)


@kernel('float64(float64[:, ::1], int64, float64, float64, float64)')
def chi_squared(table, i, a, b, c):
    """
    Return the chi-squared misfit of cell i to the plane d = a x + b y + c.

    The squared residual of the cell's mean disparity over its variance, plus the same of its
    slope: a cell that crosses the plane at an angle does not fit it, however near it is.
    """
    offset = residual(table, i, a, b, c)
    tilt_x, tilt_y = table[i, SLOPE_X] - a, table[i, SLOPE_Y] - b
    return (offset * offset * table[i, MEAN_WEIGHT]
            + (tilt_x * tilt_x + tilt_y * tilt_y) * table[i, SLOPE_WEIGHT])


@kernel('float64[:, ::1](float64[:, ::1], int32[::1], boolean[::1], int64)', is_short=True)
def add_up(moments, labels, is_used, count):
    """Add up the moments of the used cells of each label, (count, 10)."""
    total = np.zeros((count, 10))
    for i in range(len(labels)):
        if is_used[i] and labels[i] >= 0:
            add_moments(total[labels[i]], moments[i])
    return total


@kernel('int32[:, ::1](int32[:, ::1], int32[::1])')
def renamed(labels, names):
    """Return the new names (K + 1,) of labels (R, C), those of no label first."""
    found = np.empty_like(labels)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            found[i, j] = names[np.uint32(labels[i, j] + 1)]  # unsigned: no wrap-around check
    return found


def fit_regions(cells: WeightedCells, labels: np.ndarray, count: int,
                min_pixels: float = 1.0) -> PlaneRegions:
    """Fit planes to labels (R, C) int32; drop labels with too few planar pixels or on a line."""
    return PlaneRegions(*_fit_regions(np.ascontiguousarray(labels), cells.grid.moments,
                                      cells.is_planar, count, max(min_pixels, 1.0)))


@kernel('Tuple((int32[:, ::1], float64[:, ::1]))(int32[:, ::1], float64[:, ::1], boolean[::1], '
        'int64, float64)', is_short=True)
def _fit_regions(labels, moments, is_planar, count, min_pixels):
    """Return the labels and planes of those that are kept."""
    total, names, n = (add_up(moments, labels.reshape(-1), is_planar, count),
                       np.full(count + 1, np.int32(-1)), 0)  # the first is that of no label
    planes = fit_planes(total)
    for k in range(count):
        if total[k, N] >= min_pixels and not np.isnan(planes[k, 0]):
            names[k + 1] = n
            for term in range(3):
                planes[n, term] = planes[k, term]
            n += 1
    return renamed(labels, names), planes[:n].copy()


def relabel_sequential(labels: np.ndarray, kept: np.ndarray, count: int) -> np.ndarray:
    """Return labels in which ``kept`` of ``count`` labels are 0, 1, ..., all others -1."""
    names = np.full(count, -1, np.int32)
    names[kept] = np.arange(len(kept))
    return rename_labels(labels, names)


def rename_labels(labels: np.ndarray, names: np.ndarray, none: int = -1) -> np.ndarray:
    """Return labels (H, W) int32 in which k is ``names[k]``, and -1 is ``none``."""
    if none == -1 and names.tolist() == list(range(len(names))):
        return labels
    return renamed(np.ascontiguousarray(labels, np.int32),
                    np.concatenate([[none], names]).astype(np.int32))


@kernel('boolean[:, ::1](int32[:, ::1])', is_short=True)
def at_borders(labels):
    """Return which labels (R, C) int32 have another one beside them or diagonally."""
    (rows, columns), found = labels.shape, np.empty(labels.shape, np.bool_)
    for row in range(rows):
        above, here, below = labels[max(row - 1, 0)], labels[row], labels[min(row + 1, rows - 1)]
        out = found[row]
        for c in range(1, columns - 1):
            out[c] = ((above[c - 1] != here[c]) | (above[c] != here[c]) | (above[c + 1] != here[c])
                      | (here[c - 1] != here[c]) | (here[c + 1] != here[c])
                      | (below[c - 1] != here[c]) | (below[c] != here[c])
                      | (below[c + 1] != here[c]))
        for c in (0, columns - 1):
            out[c] = False
            for k in range(max(c - 1, 0), min(c + 2, columns)):
                out[c] |= (above[k] != here[c]) | (here[k] != here[c]) | (below[k] != here[c])
    return found


def count_labels(grid: CellGrid, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the number of pixels of each label in each cell, (R * C, K) float64."""
    return _count(np.ascontiguousarray(labels), grid.size_px, count)


@kernel('float64[:, ::1](int32[:, ::1], int64, int64)')
def _count(labels, size, count):
    height, width = labels.shape
    columns = -(-width // size)
    counts = np.zeros((-(-height // size) * columns, count))
    for v in range(height):
        for column in range(columns):
            cell = v // size * columns + column
            for u in range(column * size, min(column * size + size, width)):
                if labels[v, u] >= 0:
                    counts[cell, labels[v, u]] += 1
    return counts


@dataclass(frozen=True)
class PixelRegions:
    """Regions of pixels, each on one plane, in the unit of the disparity."""

    disparity: np.ndarray  # (H, W) float32: 0 where invalid
    # (H, W) int32: index into ``coefficients``, -1 for no plane and where disparity is invalid
    labels: np.ndarray
    # (K, 3) float64: a, b, c of d = a x + b y + c in the coordinates of the cells; some may have
    # no pixels
    coefficients: np.ndarray
    grid: CellGrid  # of this disparity
    noise: Noise  # of this disparity
    # area over which the smooth part of the noise is the same, in pixels; 0: not known
    correlated_px: float = 0.0
    # float or (K,) float64: probability that the regions are oriented as their planes, unless
    # depth alone decides
    certainty: float | np.ndarray = 1.0
    # float or (K,) float64: probability that they are horizontal, vertical or neither as their
    # planes indicate; NaN: depth alone decides
    class_certainty: float | np.ndarray = np.nan
    # float or (K,) float64: angle by which normals of a network have rotated each from its depth
    rotated_rad: float | np.ndarray = 0.0
    # (h, w) int32: for every PATCH_SCALE-th row and column, the patch of one colour of the image,
    # each one surface of the scene; 0 none. Of no size if only the depth decides
    patches: np.ndarray = field(default_factory=NO_PATCHES.copy)
    # (H, W) int32: as ``labels``, for the pixels of curved surfaces, which are not planes, but
    # consist of pieces that are flat within the noise. Empty if there are none
    facets: np.ndarray = field(default_factory=NO_FACETS.copy)

    def rescaled(self, scale: float, shift: float) -> PixelRegions:
        """Return the same regions in the unit of 1/z = scale * disparity + shift, scale > 0."""
        if scale == 1 and shift == 0:
            return self
        return replace(self, disparity=np.float32(scale) * self.disparity + np.float32(shift),
                       coefficients=scale * self.coefficients + [0.0, 0.0, shift],
                       grid=_rescaled_grid(self.grid, scale, shift),
                       noise=self.noise.rescaled(scale))

    def mesh_shares(self, pixels: np.ndarray) -> np.ndarray:
        """Return the share (K,) of the pixels (K,) of each region that lie in cells of a mesh."""
        count, (height, width) = len(self.coefficients), self.labels.shape
        if not self.grid.is_mesh.any():
            return np.zeros(count)
        cells = self.grid.is_mesh.reshape(self.grid.shape)
        is_mesh = cells.repeat(self.grid.size_px, 0).repeat(self.grid.size_px, 1)[:height, :width]
        labels = self.labels[is_mesh]
        return np.bincount(labels[labels >= 0], minlength=count) / np.maximum(pixels, 1)

    def of_facets(self) -> PixelRegions:
        """Return the regions of the pieces of curved surfaces instead of those of planes."""
        return replace(self, labels=self.facets, facets=NO_FACETS)

    def restricted_to(self, valid: np.ndarray) -> PixelRegions:
        """Return the regions without the pixels where ``valid`` (H, W) bool is False."""
        facets = np.where(valid, self.facets, -1) if self.facets.size else self.facets
        return replace(self, labels=np.where(valid, self.labels, -1), facets=facets)


def _rescaled_grid(grid: CellGrid, scale: float, shift: float) -> CellGrid:
    """Substitute scale * d + shift for d in the sums over the pixels of each cell."""
    moments, mean = grid.moments.copy(), grid.mean.copy()
    n, x, y, d, xd, yd, dd = grid.moments[:, [N, X, Y, D, XD, YD, DD]].T
    moments[:, D] = scale * d + shift * n
    moments[:, XD], moments[:, YD] = scale * xd + shift * x, scale * yd + shift * y
    moments[:, DD] = scale * (scale * dd + 2 * shift * d) + shift**2 * n
    mean[:, 2] = moments[:, D] / np.maximum(n, 1)
    return replace(grid, moments=moments, mean=mean, slope=scale * grid.slope,
                   residual_rms=scale * grid.residual_rms, normal_slope=scale * grid.normal_slope)
