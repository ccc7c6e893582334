# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Cells of a network's depth labelled anew by planes of known orientation.

With the normal known a plane has one unknown, its distance, so that hypotheses are one-dimensional
modes; and where two of them compete, the normal tells what the depth alone does not.

1. For each axis and each of its sides, cells whose depth leans that way vote for the distance of
   the plane they would be on; each mode of the votes is a hypothesis, as are the planes found
   before that lie along no axis.
2. Each cell gets the hypothesis of the least cost: how far its depth, and its smoothed normal, are
   from the plane's, plus the neighbours that disagree (Potts), by iterated conditional modes.
3. A wall that the network tilts is a staircase of hypotheses of one normal: adjacent ones are one
   plane unless the depth jumps between them.
4. Pixels choose among the planes of the cells around them, by depth.

References
----------
Furukawa, Curless, Seitz, Szeliski: Manhattan-world stereo, CVPR 2009 (the hypotheses).
Besag: On the statistical analysis of dirty pictures, J. R. Stat. Soc. B 48, 1986 (the labelling).

"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.planes.cell_parts import MIN_COSINE, dot, join_slices
from plane_detector.planes.measurement import ray_plane_jacobian
from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.types import CameraIntrinsics

# Cells are off a plane by this, as angle of the normal and logarithm of the depth.
# tuned: python -m plane_detector.evaluation.benchmark orientation --only planes; the
# purity stays within .02 from 20 to 25 and from 0.04 to 0.06.
NORMAL_DEVIATION_RAD, DEPTH_DEVIATION = np.radians(20.0), 0.06
# Cost of a cell on no plane, and of a neighbour on another one. tuned: as above, 1 to 2 the same.
NO_PLANE_COST, NEIGHBOUR_COST = 4.0, 1.0
# Planes across no axis are rarer, and no other depth confirms their normals. tuned: as above;
# flat from 2 to 3; below 1 walls of living rooms stay as the network has them.
OTHER_COST = 3.0
# derived: a normal as far from a plane's as two walls are counts no more when it is farther.
MOST_COST = 8.0
ROUNDS = 8
# Bins of the logarithm of the distance, their smoothing, and what a mode needs: a hundredth of
# the image. Neighbouring modes are two deviations of the depth apart.
BIN, BINS, SMOOTHING_BINS, MODE_REACH_BINS = 0.02, 350, 2, 6
LEAST_LOG_DISTANCE, MIN_MODE_SHARE = -3.0, 0.01
# The window, in cells, of the median of the slopes.
WINDOW_CELLS = 5


@dataclass(frozen=True)
class _Cells:
    rays: np.ndarray            # (M, 3)
    log_disparity: np.ndarray   # (M,), NaN where unusable
    normals: np.ndarray         # (M, 3), smoothed


@dataclass(frozen=True)
class Hypotheses:
    """
    Planes that cells may be on.

    Attributes
    ----------
    normals : (C, 3) float64
    log_offsets : (C,) float64
        Logarithm of their distance.

    """

    normals: np.ndarray
    log_offsets: np.ndarray


def label_along_axes(regions: PixelRegions, axes: np.ndarray, others: Hypotheses,
                     intrinsics: CameraIntrinsics) -> PixelRegions:
    """
    Label pixels by planes across axes, and by other planes found before.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in one unit; only their disparity and grid are used.
    axes : (A, 3) float64
        Unit directions.
    others : Hypotheses
        Planes across no axis.
    intrinsics : CameraIntrinsics

    """
    cells = _read_cells(regions.grid, intrinsics)
    found = _propose(cells, np.vstack([axes, -axes]))
    normals = np.vstack([found.normals, others.normals])
    if not len(normals):
        return regions
    cost = _costs(*_arrays(cells), normals,
                  np.concatenate([found.log_offsets, others.log_offsets]))
    cost[:, len(found.normals):-1] += OTHER_COST
    labels = _compete(cost, regions.grid.shape, NEIGHBOUR_COST)
    region, first = join_slices(labels, regions.grid.shape, cells.rays, cells.log_disparity,
                                normals)
    return _refitted(regions, cells, region, normals[first], intrinsics)


def _arrays(cells: _Cells) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return cells.rays, cells.log_disparity, cells.normals


def _read_cells(grid: CellGrid, intrinsics: CameraIntrinsics) -> _Cells:
    """Return rays, disparity and smoothed normals of the cells."""
    jacobian = ray_plane_jacobian(intrinsics)
    # The coordinates of the cells and those of rays differ as the coefficients' jacobian says.
    x, y, d = grid.mean.T
    rays = np.stack([x, y, np.ones_like(x)], axis=1) @ np.linalg.inv(jacobian)
    usable = grid.usable & (d > 0)
    d = np.where(usable, d, 1.0)
    slopes = np.where(usable[:, None], grid.slope / d[:, None], 0.0).astype(np.float32)
    smooth = [cv2.medianBlur(np.ascontiguousarray(column.reshape(grid.shape)), WINDOW_CELLS)
              for column in slopes.T]
    slope_x, slope_y = (column.ravel().astype(float) for column in smooth)
    planes = -np.column_stack([slope_x, slope_y, 1 - slope_x * x - slope_y * y]) @ jacobian.T
    normals = planes / np.linalg.norm(planes, axis=1, keepdims=True)
    return _Cells(rays, np.where(usable, np.log(d), np.nan), normals)


def _propose(cells: _Cells, normals: np.ndarray) -> Hypotheses:
    """Return the modes of the distances that cells give planes of these normals (A, 3)."""
    votes = _votes(*_arrays(cells), np.ascontiguousarray(normals))
    reach = 3 * SMOOTHING_BINS
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SMOOTHING_BINS) ** 2)
    found, log_offsets = [], []
    for normal, histogram in zip(normals, votes, strict=True):
        smooth = np.convolve(histogram, window, 'same')
        while smooth.max() > MIN_MODE_SHARE * len(cells.rays):
            mode = int(smooth.argmax())
            found.append(normal)
            log_offsets.append(LEAST_LOG_DISTANCE + (mode + 0.5) * BIN)
            smooth[max(0, mode - MODE_REACH_BINS):mode + MODE_REACH_BINS + 1] = 0.0
    return Hypotheses(np.array(found).reshape(-1, 3), np.array(log_offsets))


@kernel('float64[:, ::1](float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1])')
def _votes(rays, log_disparity, own, normals):
    """Return histograms (A, BINS) of the logarithm of the distance of planes of these normals."""
    votes = np.zeros((len(normals), BINS))
    for i in range(len(rays)):
        if np.isnan(log_disparity[i]):
            continue
        for k in range(len(normals)):
            cosine = -dot(normals[k], rays[i])
            turn = 2 * (1 - dot(normals[k], own[i])) / NORMAL_DEVIATION_RAD**2
            if cosine > MIN_COSINE and turn < 2.5**2:
                log_offset = np.log(cosine) - log_disparity[i]
                column = int((log_offset - LEAST_LOG_DISTANCE) / BIN)
                if 0 <= column < BINS:
                    votes[k, column] += np.exp(-0.5 * turn)
    return votes


@kernel('float64[:, ::1](float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], '
        'float64[::1])')
def _costs(rays, log_disparity, own, normals, log_offsets):
    """Return the cost (M, C + 1) of each cell on each hypothesis, the last one is no plane."""
    count = len(normals)
    costs = np.zeros((len(rays), count + 1))
    for i in range(len(rays)):
        if np.isnan(log_disparity[i]):
            costs[i, :count] = np.inf
            continue
        costs[i, count] = NO_PLANE_COST
        for k in range(count):
            cosine = -dot(normals[k], rays[i])
            if cosine < MIN_COSINE:
                costs[i, k] = MOST_COST
                continue
            depth = (np.log(cosine) - log_offsets[k] - log_disparity[i]) / DEPTH_DEVIATION
            # The square of the chord is that of the angle, nearly.
            turn = 2 * (1 - dot(normals[k], own[i])) / NORMAL_DEVIATION_RAD**2
            costs[i, k] = min(0.5 * (depth * depth + turn), MOST_COST)
    return costs


@kernel('int32[:, ::1](float64[:, ::1], UniTuple(int64, 2), float64)')
def _compete(costs, shape, neighbour_cost):
    """Return the hypothesis (R, C) of each cell, -1 none, by iterated conditional modes."""
    rows, columns = shape
    count = costs.shape[1]
    labels = np.empty((rows, columns), np.int32)
    for i in range(rows * columns):
        labels[i // columns, i % columns] = np.argmin(costs[i])
    energy = np.empty(count)
    for _ in range(ROUNDS):
        for r in range(rows):
            for c in range(columns):
                energy[:] = costs[r * columns + c]
                for dr in range(-1, 2):
                    for dc in range(-1, 2):
                        if (dr or dc) and 0 <= r + dr < rows and 0 <= c + dc < columns:
                            energy[labels[r + dr, c + dc]] -= neighbour_cost * (
                                0.7 if dr and dc else 1.0)
                labels[r, c] = np.argmin(energy)
    for r in range(rows):
        for c in range(columns):
            if labels[r, c] == count - 1:
                labels[r, c] = -1
    return labels


def _refitted(regions: PixelRegions, cells: _Cells, region: np.ndarray, normals: np.ndarray,
              intrinsics: CameraIntrinsics) -> PixelRegions:
    """Return pixel labels and coefficients of regions of cells of known normals (K, 3)."""
    cosine = -(normals[region.ravel()] * cells.rays).sum(1)
    offset = np.maximum(cosine, MIN_COSINE) / np.exp(cells.log_disparity)
    offsets = np.ones(len(normals))
    for k in np.unique(region[region >= 0]):
        offsets[k] = np.median(offset[region.ravel() == k])
    ray_planes = -normals / offsets[:, None]
    coefficients = ray_planes @ np.linalg.inv(ray_plane_jacobian(intrinsics)).T
    labels = _label_pixels(np.ascontiguousarray(regions.disparity), region, regions.grid.size_px,
                           np.ascontiguousarray(coefficients),
                           np.array([regions.grid.width_px, *regions.grid.origin]))
    return replace(regions, labels=labels, coefficients=coefficients)


@kernel('int32[:, ::1](float32[:, ::1], int32[:, ::1], int64, float64[:, ::1], float64[::1])')
def _label_pixels(disparity, region, size, coefficients, frame):
    """Return for each pixel the region of its cell, or of the nearest ones, by disparity."""
    height, width = disparity.shape
    rows, columns = region.shape
    labels = np.full((height, width), -1, np.int32)
    for v in range(height):
        r = v // size
        s = min(max(r + (1 if v % size >= size // 2 else -1), 0), rows - 1)
        y = frame[2] + v / frame[0]
        for u in range(width):
            if disparity[v, u] <= 0:
                continue
            c = u // size
            t = min(max(c + (1 if u % size >= size // 2 else -1), 0), columns - 1)
            own = region[r, c]
            labels[v, u] = own
            if own < 0 or (region[s, c] == own and region[r, t] == own and region[s, t] == own):
                continue
            x, best = frame[1] + u / frame[0], np.inf
            for k in (own, region[s, c], region[r, t], region[s, t]):
                if k >= 0:
                    plane = coefficients[k]
                    off = abs(plane[0] * x + plane[1] * y + plane[2] - disparity[v, u])
                    if off < best:
                        labels[v, u], best = k, off
    return labels
