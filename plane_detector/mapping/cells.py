# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The cells of a plane of the map: how often each was observed, and how often it was hit.

A cell is observed if it is in view and not hidden, and hit if its pixel belongs to the plane. In
this way planes grow where they are seen, and removed surfaces lose their cells.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.heights import PlaneFrames
from plane_detector.planes.region_samples import MIN_COSINE
from plane_detector.types import CameraIntrinsics, Planes

# A cell is part of the plane if this share of its observations were hits.
# tuned: benchmark map --first-seed 0.
SEEN_SHARE = 0.3
# chosen: observations and hits are halved at this many observations, so that a change shows soon.
MOST_LOOKS = 20
# A plane with fewer cells, or a smaller share of the cells ever hit, is removed.
# chosen: the fewest. tuned: the share, benchmark map --first-seed 1 --images 60 --only people:
# equal from .3 to .5; at .15 part of a person stays.
_FEWEST, _LEFT_SHARE = 4, 0.3
# An observation of something behind a cell counts as several.
# tuned: benchmark map --first-seed 0 --only hard.
THROUGH = 3
# chosen: 80 m from the origin of a plane at .04 m.
MOST_CELLS = 2048
# chosen: of all planes, 27 000 m^2 at .04 m; limits their memory to 50 MB, as each has two counts
# and whether it is seen. One plane as far as MOST_CELLS on all sides is as large.
MOST_CELLS_IN_ALL = 4 * MOST_CELLS**2
# chosen: corners of outlines may be off by one cell, in halves of a cell (Douglas and Peucker).
_TOLERANCE = 2.0
# Spare cells at the border of a bitmap, so that it need not grow with each image.
_MARGIN = 8


class CellSums(NamedTuple):
    """Sums over the cells that are part of a plane."""

    cells: int
    columns: int
    rows: int
    hits: int
    looks: int
    ever_hit: int  # cells, whether they are part of it now or not


@dataclass(frozen=True)
class Cells:
    """Counts of observations and hits of square cells; the arrays are not changed."""

    low: tuple[int, int]  # numbers of the first column, along u, and of the first row, along v
    hits: np.ndarray  # (rows, columns) uint8
    looks: np.ndarray  # (rows, columns) uint8
    size_m: float

    @classmethod
    def none(cls, size_m: float) -> Cells:
        """Return no cells."""
        return cls((0, 0), np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.uint8), size_m)

    @cached_property
    def seen(self) -> np.ndarray:
        """The cells that are part of the plane, (rows, columns) bool."""
        return self.hits > SEEN_SHARE * self.looks

    @property
    def count(self) -> int:
        """Number of cells that are part of the plane."""
        return self.sums.cells

    @property
    def is_gone(self) -> bool:
        """Whether hardly any of the cells that were hit are left."""
        return self.count < max(_FEWEST, _LEFT_SHARE * self.sums.ever_hit)

    @property
    def area_m2(self) -> float:
        """Area of these cells."""
        return self.count * self.size_m**2

    @property
    def centroid_m(self) -> np.ndarray:
        """Mean of these cells, (2,) along u and v; 0 if there are none."""
        sums = self.sums
        if not sums.cells:
            return np.zeros(2)
        return self.size_m * (np.array([sums.columns, sums.rows]) / sums.cells + self.low + 0.5)

    @cached_property
    def sums(self) -> CellSums:
        """Number of these cells, sums of columns, rows, hits, observations; number ever hit."""
        return CellSums(*_sums(self.hits, self.looks))

    def middles_m(self) -> np.ndarray:
        """Return the centres of these cells, (N, 2) along u and v."""
        rows, columns = np.nonzero(self.seen)
        return self.size_m * (np.column_stack([columns, rows]) + np.array(self.low) + 0.5)

    def hull_m(self) -> np.ndarray:
        """Return the corners (N, 2), along u and v, of the rows of these cells."""
        first_row, last_row, first, last = runs(self).T
        corners = np.concatenate([np.column_stack([u, v]) for u in (first, last)
                                  for v in (first_row, last_row)])
        return self.size_m * (corners + np.array(self.low))

    def nearest_m(self, flat_m: np.ndarray) -> np.ndarray:
        """Return the centre of the cell nearest to a point, both (2,) along u and v."""
        middles_m = self.middles_m()
        return middles_m[np.argmin(((middles_m - flat_m) ** 2).sum(axis=1))]

    @cached_property
    def outlines(self) -> list[tuple[np.ndarray, bool]]:
        """
        The corners (N, 2), along u and v, of each part and of each hole, and which it is.

        The largest part first, each followed by its holes.
        """
        # At twice the size, so that a border of one cell keeps its width; corners are between
        # pixels.
        mask = self.seen.astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1)
        contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        if not contours:
            return []
        parents = hierarchy[0, :, 3].tolist()
        parts = sorted((k for k, parent in enumerate(parents) if parent < 0),
                       key=lambda k: -cv2.contourArea(contours[k]))
        order = [k for part in parts for k in (part, *(
            hole for hole, parent in enumerate(parents) if parent == part))]
        simple = [(cv2.approxPolyDP(contours[k], _TOLERANCE, True).reshape(-1, 2),
                   parents[k] >= 0) for k in order]
        return [(self.size_m * ((corners + 0.5) / 2 + self.low), is_hole)
                for corners, is_hole in simple if len(corners) > 2]

    def grown(self, low_m: np.ndarray, high_m: np.ndarray, most: int = MOST_CELLS_IN_ALL
              ) -> Cells | None:
        """
        Return the cells with at least those between two corners (2,).

        None if that would add more than ``most`` cells.
        """
        low, high = ([min(max(rounded(value / self.size_m), -MOST_CELLS), MOST_CELLS)
                      for value in corner_m.tolist()]
                     for rounded, corner_m in ((math.floor, low_m), (math.ceil, high_m)))
        (rows, columns), own_low = self.hits.shape, self.low
        if self.hits.size:
            own_high = own_low[0] + columns, own_low[1] + rows
            if all(map(operator.ge, low, own_low)) and all(map(operator.le, high, own_high)):
                return self
            low = [max(new - _MARGIN, -MOST_CELLS) if new < old else old
                   for new, old in zip(low, own_low, strict=True)]
            high = [min(new + _MARGIN, MOST_CELLS) if new > old else old
                    for new, old in zip(high, own_high, strict=True)]
        shape = max(high[1] - low[1], 0), max(high[0] - low[0], 0)
        if shape[0] * shape[1] - self.hits.size > most:
            return None
        hits, looks = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
        if self.hits.size:
            left, top = own_low[0] - low[0], own_low[1] - low[1]
            hits[top:top + rows, left:left + columns] = self.hits
            looks[top:top + rows, left:left + columns] = self.looks
        return Cells(tuple(low), hits, looks, self.size_m)


@dataclass(frozen=True)
class View:
    """The labels and the depth of an image, and the camera in the frame of the map."""

    labels: np.ndarray  # (H, W) int32, C-contiguous, index of the detected plane; -1 none
    depth_m: np.ndarray  # (H, W) float32, C-contiguous
    camera: tuple[float, float, float, float]  # fx, fy, cx, cy
    camera_from_map: RigidTransform
    count: int  # of found planes
    noise: float  # standard deviation of the disparity, 1/m

    def steps(self, frames: PlaneFrames, lows: np.ndarray, size_m: float) -> np.ndarray:
        """
        Return the centres of the first cells, and the steps along u and v, in the camera, (M, 3,
        3).

        ``lows`` (M, 2) are the numbers of these cells.
        """
        slopes = frames.coefficients[:, :2, None]
        normals = frames.axes[:, 2]
        along = frames.axes[:, :2] + slopes * normals[:, None]
        start = (frames.origins_m + frames.coefficients[:, 2:] * normals
                 + (size_m * (lows + 0.5)[:, None] @ along)[:, 0])
        steps = np.concatenate([start[:, None], size_m * along], axis=1)
        steps = steps @ self.camera_from_map.rotation.T
        steps[:, 0] += self.camera_from_map.translation_m
        return steps

    def may_show(self, steps: np.ndarray, shapes: np.ndarray) -> np.ndarray:
        """
        Return which rectangles of cells may be in view, (M,) bool: not all corners beyond a side.

        ``steps`` are those of :meth:`steps`, ``shapes`` (M, 2) the rows and columns of cells.
        """
        height, width = self.labels.shape
        fx, fy, cx, cy = self.camera
        rows, columns = (shapes.T[:, :, None] - 1) * np.array([[[0, 0, 1, 1]], [[0, 1, 0, 1]]])
        corners = (steps[:, :1] + rows[:, :, None] * steps[:, 2:] + columns[:, :, None]
                   * steps[:, 1:2])
        sides = np.array([[fx, 0, cx + 0.5], [-fx, 0, width - cx - 0.5],
                          [0, fy, cy + 0.5], [0, -fy, height - cy - 0.5], [0, 0, 1]])
        return ((corners @ sides.T).max(axis=1) > 0).all(axis=1)


def runs(cells: Cells) -> np.ndarray:
    """
    Return rectangles (N, 4) that cover the occupied cells: first and end row, then columns.

    Runs of cells of a row; equal ones of consecutive rows are one rectangle.
    """
    padded = np.pad(cells.seen.astype(np.int8), ((0, 0), (1, 1)))
    rows, first = np.nonzero(np.diff(padded, axis=1) > 0)
    _, last = np.nonzero(np.diff(padded, axis=1) < 0)
    order = np.lexsort((rows, last, first))
    rows, first, last = rows[order], first[order], last[order]
    is_new = np.ones(len(rows) + 1, bool)
    is_new[1:-1] = ((rows[1:] != rows[:-1] + 1) | (first[1:] != first[:-1])
                    | (last[1:] != last[:-1]))
    begin, end = np.flatnonzero(is_new[:-1]), np.flatnonzero(is_new[1:])
    return np.column_stack([rows[begin], rows[end] + 1, first[begin], last[begin]])


def shared_cells(view: View, steps: np.ndarray, cells: Cells) -> np.ndarray:
    """
    Return how many cells each detected plane shows, (K + 1,); the last counts all in view.

    Every second cell in both directions is read.
    """
    return _shared_cells(view.labels, view.camera, steps, cells.hits, cells.looks, view.count)


def vote(view: View, steps: np.ndarray, cells: Cells, is_own: np.ndarray,
         tolerance_m: float) -> Cells:
    """
    Return the cells after an image.

    Parameters
    ----------
    view : View
    steps : (3, 3) float64
        Of :meth:`View.steps`.
    cells : Cells
    is_own : (K,) bool
        Detected planes that are this plane.
    tolerance_m : float
        A pixel farther off the plane than this plus the noise hides the cell or shows that it is
        gone.

    """
    hits, looks = cells.hits.copy(), cells.looks.copy()
    _vote(view.labels, view.depth_m, view.camera, steps, is_own, (tolerance_m, 3 * view.noise),
          hits, looks)
    return Cells(cells.low, hits, looks, cells.size_m)


def sampled(labels: np.ndarray, planes: Planes, intrinsics: CameraIntrinsics, rows: int
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return points (N, 3) of K planes, and the start and end of those of each, (K + 1,) int.

    They are the intersections of the rays of pixels, in this many rows, with a plane; then its
    centroid.
    """
    ray_x, ray_y = pixel_rays(intrinsics)
    return _sampled(np.ascontiguousarray(labels, np.int32), max(1, len(labels) // rows), ray_x,
                    ray_y, planes.normals, planes.offsets_m, planes.centroids_m)


def extents(points_m: np.ndarray, ends: np.ndarray, own: np.ndarray, frames: PlaneFrames
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the lowest and highest coordinates (M, 2) of points along u and v of M frames.

    Parameters
    ----------
    points_m : (N, 3) float64
    ends : (K + 1,) int
        Of :func:`sampled`.
    own : (K,) int
        The frame of the points of each detected plane; -1 none.
    frames : PlaneFrames
        A frame without points gets infinities.

    """
    return _extents(points_m, ends, own, frames.origins_m, frames.axes)


def are_near(flat_m: np.ndarray, cells: Cells, reach_m: float) -> float:
    """Return the share of points (N, 2), along u and v, with an occupied cell within reach."""
    low = np.array(cells.low, float)
    return _are_near(np.ascontiguousarray(flat_m / cells.size_m - low), cells.hits, cells.looks,
                     int(np.ceil(reach_m / cells.size_m)))


def resampled(cells: Cells, low: tuple[int, int], shape: tuple[int, int], to_other: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return hits and observations of other cells, from the nearest of these cells; 0 outside.

    ``to_other`` (2, 3) maps u, v and 1 of the other cells to u and v of these, in cells.
    """
    return _resampled(cells.hits, cells.looks, np.array(cells.low), np.array(low),
                      np.array(shape), to_other)


# Read-only, for views of messages.
_LABELS, _DEPTH = (f"Array({kind}, 2, 'C', readonly=True)" for kind in ('int32', 'float32'))


@kernel('UniTuple(int64, 2)(UniTuple(float64, 4), float64[:, ::1], UniTuple(int64, 2), int64, '
        'int64)', is_short=True)
def _in_view(camera, steps, shape, row, columns):
    """Return the first and the last + 1 column of the cells of a row that are in the image."""
    fx, fy, cx, cy = camera
    start = steps[0] + row * steps[2]
    low, high = 0.0, float(columns)
    for side in range(5):
        # Each border is a plane through the camera: in view where by_x x + by_y y + by_z z >= 0.
        by_x, by_y, by_z, least = 0.0, 0.0, 1.0, 0.05
        if side < 2:
            by_x, least = (fx if side == 0 else -fx), 0.0
            by_z = cx + 0.5 if side == 0 else shape[1] - cx - 0.5001
        elif side < 4:
            by_y, least = (fy if side == 2 else -fy), 0.0
            by_z = cy + 0.5 if side == 2 else shape[0] - cy - 0.5001
        value = by_x * start[0] + by_y * start[1] + by_z * start[2] - least
        slope = by_x * steps[1, 0] + by_y * steps[1, 1] + by_z * steps[1, 2]
        if slope > 0:
            low = max(low, -value / slope)
        elif slope < 0:
            high = min(high, -value / slope)
        elif value < 0:
            return 0, 0
    if not low < high:
        return 0, 0
    return int(np.ceil(low)), int(np.ceil(high))


@kernel(f'int64[::1]({_LABELS}, UniTuple(float64, 4), float64[:, ::1], uint8[:, ::1], '
        'uint8[:, ::1], int64)', is_short=True)
def _shared_cells(labels, camera, steps, hits, looks, count):
    fx, fy, cx, cy = camera
    shared = np.zeros(count + 1, np.int64)
    for i in range(0, hits.shape[0], 2):
        first, last = _in_view(camera, steps, labels.shape, i, hits.shape[1])
        for j in range(first + first % 2, last, 2):
            if hits[i, j] <= SEEN_SHARE * looks[i, j]:
                continue
            z = steps[0, 2] + j * steps[1, 2] + i * steps[2, 2]
            x = steps[0, 0] + j * steps[1, 0] + i * steps[2, 0]
            y = steps[0, 1] + j * steps[1, 1] + i * steps[2, 1]
            column, row = int(fx * x / z + cx + 0.5), int(fy * y / z + cy + 0.5)
            shared[count] += 1
            label = labels[row, column]
            if 0 <= label < count:
                shared[label] += 1
    return shared


@kernel(f'void({_LABELS}, {_DEPTH}, UniTuple(float64, 4), float64[:, ::1], '
        'boolean[::1], UniTuple(float64, 2), uint8[:, ::1], uint8[:, ::1])', is_short=True)
def _vote(labels, depth_m, camera, steps, is_own, tolerance, hits, looks):
    fx, fy, cx, cy = camera
    # The normal of the plane, for the angle at which a ray meets it.
    n_x = steps[1, 1] * steps[2, 2] - steps[1, 2] * steps[2, 1]
    n_y = steps[1, 2] * steps[2, 0] - steps[1, 0] * steps[2, 2]
    n_z = steps[1, 0] * steps[2, 1] - steps[1, 1] * steps[2, 0]
    length = np.sqrt(n_x * n_x + n_y * n_y + n_z * n_z)
    distance = abs(n_x * steps[0, 0] + n_y * steps[0, 1] + n_z * steps[0, 2]) / length
    for i in range(hits.shape[0]):
        first, last = _in_view(camera, steps, labels.shape, i, hits.shape[1])
        for j in range(first, last):
            z = steps[0, 2] + j * steps[1, 2] + i * steps[2, 2]
            x = steps[0, 0] + j * steps[1, 0] + i * steps[2, 0]
            y = steps[0, 1] + j * steps[1, 1] + i * steps[2, 1]
            column, row = int(fx * x / z + cx + 0.5), int(fy * y / z + cy + 0.5)
            label, depth = labels[row, column], depth_m[row, column]
            is_hit = 0 <= label < len(is_own) and is_own[label]
            weight = 1
            if not is_hit:
                # How far the pixel's point is off the plane, along the normal.
                behind = distance * (depth / z - 1)
                limit = tolerance[0] + tolerance[1] * z * distance
                # Hidden, or depth is missing, or an unexplained pixel on the plane.
                if not behind >= -limit or (label < 0 and not behind > limit):
                    continue
                weight = THROUGH if behind > limit else 1
            if looks[i, j] >= MOST_LOOKS:
                looks[i, j] //= 2
                hits[i, j] //= 2
            looks[i, j] += weight
            hits[i, j] += is_hit


@kernel('UniTuple(int64, 6)(uint8[:, ::1], uint8[:, ::1])', is_short=True)
def _sums(hits, looks):
    count, columns, rows, hit, looked, ever = 0, 0, 0, 0, 0, 0
    for i in range(hits.shape[0]):
        for j in range(hits.shape[1]):
            ever += hits[i, j] > 0
            if hits[i, j] > SEEN_SHARE * looks[i, j]:
                count, columns, rows = count + 1, columns + j, rows + i
                hit, looked = hit + int(hits[i, j]), looked + int(looks[i, j])
    return count, columns, rows, hit, looked, ever


@kernel(f'Tuple((float64[:, ::1], int64[::1]))({_LABELS}, int64, float32[::1], float32[::1], '
        'float64[:, ::1], float64[::1], float64[:, ::1])', is_short=True)
def _sampled(labels, step, ray_x, ray_y, normals, offsets, centroids):
    count, ends = len(offsets), np.ones(len(offsets) + 1, np.int64)  # with the centroids
    ends[0] = 0
    for row in range(step // 2, labels.shape[0], step):
        for column in range(step // 2, labels.shape[1], step):
            if 0 <= labels[row, column] < count:
                ends[labels[row, column] + 1] += 1
    ends = np.cumsum(ends)
    points, place = np.empty((ends[-1], 3)), ends[:-1].copy()
    for row in range(step // 2, labels.shape[0], step):
        for column in range(step // 2, labels.shape[1], step):
            k = labels[row, column]
            if 0 <= k < count:
                x, y = float(ray_x[column]), float(ray_y[row])
                facing = -(x * normals[k, 0] + y * normals[k, 1] + normals[k, 2])
                along = offsets[k] / max(facing, MIN_COSINE)
                points[place[k]] = x * along, y * along, along
                place[k] += 1
    points[ends[1:] - 1] = centroids
    return points, ends


@kernel('UniTuple(float64[:, ::1], 2)(float64[:, ::1], int64[::1], int64[::1], float64[:, ::1], '
        'float64[:, :, ::1])', is_short=True)
def _extents(points, ends, own, origins, axes):
    lows, highs = np.full((len(origins), 2), np.inf), np.full((len(origins), 2), -np.inf)
    for k in range(len(own)):
        m = own[k]
        for i in range(ends[k], ends[k + 1] if m >= 0 else ends[k]):
            for j in range(2):
                along = 0.0
                for n in range(3):
                    along += (points[i, n] - origins[m, n]) * axes[m, j, n]
                lows[m, j], highs[m, j] = min(lows[m, j], along), max(highs[m, j], along)
    return lows, highs


@kernel('float64(float64[:, ::1], uint8[:, ::1], uint8[:, ::1], int64)', is_short=True)
def _are_near(points, hits, looks, reach):
    near = 0
    for k in range(len(points)):
        column, row = int(np.floor(points[k, 0])), int(np.floor(points[k, 1]))
        is_near = False
        for i in range(max(row - reach, 0), min(row + reach + 1, hits.shape[0])):
            for j in range(max(column - reach, 0), min(column + reach + 1, hits.shape[1])):
                if hits[i, j] > SEEN_SHARE * looks[i, j]:
                    is_near = True
                    break
            if is_near:
                break
        near += is_near
    return near / max(len(points), 1)


@kernel('UniTuple(uint8[:, ::1], 2)(uint8[:, ::1], uint8[:, ::1], int64[::1], int64[::1], '
        'int64[::1], float64[:, ::1])', is_short=True)
def _resampled(hits, looks, low, other_low, shape, to_other):
    new_hits = np.zeros((shape[0], shape[1]), np.uint8)
    new_looks = np.zeros((shape[0], shape[1]), np.uint8)
    for i in range(shape[0]):
        for j in range(shape[1]):
            u, v = j + other_low[0] + 0.5, i + other_low[1] + 0.5
            x = to_other[0, 0] * u + to_other[0, 1] * v + to_other[0, 2]
            y = to_other[1, 0] * u + to_other[1, 1] * v + to_other[1, 2]
            column, row = int(np.floor(x)) - low[0], int(np.floor(y)) - low[1]
            if 0 <= row < hits.shape[0] and 0 <= column < hits.shape[1]:
                new_hits[i, j], new_looks[i, j] = hits[row, column], looks[row, column]
    return new_hits, new_looks
