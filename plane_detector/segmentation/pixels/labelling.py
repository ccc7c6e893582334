# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels of cells to labels of pixels.

If all neighbours of a cell have its label, its pixels get this label. In cells along borders each
pixel chooses among the planes nearby. If two planes intersect along their border, the side of the
intersection decides, which does not depend on noise; at a step the residual decides, averaged over
3 x 3 pixels where their mean is within the noise of the pixel. On depth accurate enough to show
creases, a cell is reassigned if most of its pixels choose another plane, and its neighbours choose
again, so that borders follow the pixels. A border against unlabelled pixels is where the surface
leaves the noise of the plane.

Narrow gaps within planes are closed: joints of tiles and seams of doors are visible in exact
depth, or their pixels are outliers of a sensor. Unlabelled pixels between two pixels of the same
plane belong to it if they are within the unevenness that the settings allow.

A smear is not a plane: where depth has been resized, filtered or registered, an edge is a ramp of
a few pixels between a surface and another one behind it. If the ramp is linear in 1/z, it is an
exact plane, but one that is seen nearly edge-on over its whole area, and that starts at the depth
of one surface and ends at that of the other. A wall seen edge-on is wider, or the surface behind
its end is farther away.
"""

from __future__ import annotations

import math

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage, normal_of
from plane_detector.segmentation.cells.model import LOCAL_RATIO, MAX_DEVIATIONS, Frame, at_borders
from plane_detector.segmentation.cells.noise import DepthKind
from plane_detector.segmentation.regions.region_graph import APART, RegionGraph, intersections
from plane_detector.segmentation.search.plane_search import sees_creases

# Planes closer to each other than this share of the tolerance, squared, are alike.
# derived: one deviation.
ALIKE2 = 1 / MAX_DEVIATIONS**2
# Angle at which a smear is seen, at most, and its width.
# chosen: boxes smeared by 3 to 7 pixels to either side are seen at .5 to 3 degrees; the treads of
# stairs are seen at more unless they are a few pixels wide.
MAX_SMEAR_DEG, MAX_SMEAR_PX = 4.0, 20.0
# Surfaces at both ends of a smear differ from these by at most this share of the ramp.
# chosen: the ends of a ramp are ragged; behind the side of a box it is .5 and more.
MAX_END_SHARE = 0.25
# derived: the pixels behind the one next to an end.
BEHIND_PX = 2.0
# chosen: of every plane but the smallest, some pixels this far apart show that it is not as steep
# as a smear; only if they do not, all are looked at.
SPARSE_PX = 8


def label_pixels(frame: Frame, graph: RegionGraph) -> np.ndarray:
    """
    Label every pixel.

    Where creases are visible, planes grow into cells without a label, from cell to cell, as long
    as most of the pixels of a cell are near the plane.

    Parameters
    ----------
    frame : Frame
    graph : RegionGraph
        Of its cells, none of its regions merged.

    Returns
    -------
    (H, W) int32
        Index into the planes, -1 for none and where invalid.

    """
    noise, disparity = frame.noise, frame.image.values
    found = np.empty(disparity.shape, np.int32)
    sees = sees_creases(frame.grid, noise, MAX_DEVIATIONS)
    # In other depth, neighbouring pixels share their error.
    if frame.kind is DepthKind.MEASURED:
        disparity = _smooth(disparity, frame.image.valid, MAX_DEVIATIONS * noise.pixel_sigma)
    # A border moves by one cell per sweep.
    label_more_pixels(frame, graph, found, 0, disparity, sum(frame.grid.shape) if sees else 1)
    return found


def label_more_pixels(frame: Frame, graph: RegionGraph, labels: np.ndarray, first: int,
                      disparity: np.ndarray | None = None, sweeps: int = 1) -> None:
    """
    Label every valid pixel, the planes of the graph from ``first`` on; the others keep theirs.

    From 0 on, all pixels are written. Small planes gain nothing from growing, which is more than
    one of the ``sweeps``, nor from a ``disparity`` that is a mean over neighbours.
    """
    grid, disparity = frame.grid, frame.image.values if disparity is None else disparity
    _label((labels, first), (disparity, frame.image.valid, grid.size_px),
           (graph.labels, at_borders(graph.labels)), frame.cells.table,
           (grid.planes_in_pixels(graph.planes), intersections(graph.planes, graph.borders)),
           pixel_tolerance(frame), sweeps)


def pixel_tolerance(frame: Frame) -> tuple[float, float, float]:
    """Return the squared tolerance of 1/z: t[0] + t[1] / z**4 + t[2] * slope**2 per pixel."""
    noise = frame.noise
    variance = noise.mean_sigma**2 + noise.pixel_sigma**2 + noise.disparity_floor**2
    return (MAX_DEVIATIONS**2 * variance, (MAX_DEVIATIONS * noise.depth_floor_m) ** 2,
            (MAX_DEVIATIONS * noise.lateral_px) ** 2)


@kernel('void(Tuple((int32[:, ::1], int64)), Tuple((float32[:, ::1], boolean[:, ::1], int64)), '
        'Tuple((int32[:, ::1], boolean[:, ::1])), float64[:, ::1], '
        'Tuple((float64[:, ::1], int8[:, ::1])), UniTuple(float64, 3), int64)')
def _label(output, image, cells, table, planes, tolerance, sweeps):
    """Write the label of every valid pixel, given the labels of cells and those at borders."""
    (found, shift), (disparity, valid, size), (labels, is_open) = output, image, cells
    (height, width), columns, extent = disparity.shape, labels.shape[1], (0, 0)
    local, pixels = np.empty((9, 3), np.float32), np.empty((5, size**2), np.float32)
    chosen, offset = np.empty(size**2, np.int32), np.empty(size**2, np.uint64)
    values, is_valid, out = disparity.reshape(-1), valid.reshape(-1), found.reshape(-1)
    near = np.full(10, np.int32(-1))
    _fill_cells(found, shift, valid, labels, is_open, size)
    for _ in range(sweeps):
        changed, is_next, is_changed = labels.copy(), np.zeros(labels.shape, np.bool_), False
        for cell in range(labels.size):
            row, column = cell // columns, cell % columns
            if not is_open[row, column] or not _find_labels_around(labels, row, column, near):
                continue
            top, left, label = row * size, column * size, labels[row, column]
            if extent != (min(size, height - top), min(size, width - left)):
                extent = (min(size, height - top), min(size, width - left))
                _lay_out(extent, width, offset, pixels)
                chosen = np.empty(extent[0] * extent[1], np.int32)
            first = np.uint64(top * width + left)  # unsigned: no wrap-around check
            for p in range(len(chosen)):
                pixels[2, p] = values[first + offset[p]]
            _move_planes(planes[0], near, (top, left), local)
            of_cell = tolerance[0] * table[cell, LOCAL_RATIO], tolerance[1], tolerance[2]
            _choose_nearest(pixels, chosen, near, local, of_cell)
            _choose_sides(pixels, chosen, near, local, planes[1], label)
            for p in range(len(chosen)):
                if is_valid[first + offset[p]]:
                    out[first + offset[p]] = chosen[p] + shift if chosen[p] >= 0 else -1
            winner = _majority(chosen, near) if sweeps > 1 else label
            if winner >= 0 and winner != label:
                changed[row, column], is_changed = winner, True
                _open_around(is_next, labels, row, column)
        labels, is_open = changed, is_next
        if not is_changed:
            break


@kernel('void(boolean[:, ::1], int32[:, ::1], int64, int64)')
def _open_around(is_open, labels, row, column):
    """Open a cell that gets a new label and its neighbours; a cell without one, those without."""
    for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, labels.shape[1])):
            is_open[r, c] |= labels[row, column] >= 0 or labels[r, c] < 0


@kernel('float32[:, ::1](float32[:, ::1], boolean[:, ::1], float32)')
def _smooth(disparity, valid, limit):
    """Return the mean of the 3 x 3 pixels around each where all are valid and it is near."""
    (height, width), smooth = disparity.shape, np.empty_like(disparity)
    total, is_whole = np.empty(width, np.float32), np.empty(width, np.bool_)
    for v in range(height):
        before, after, out = max(v - 1, 0), min(v + 1, height - 1), smooth[v]
        above, here, below = disparity[before], disparity[v], disparity[after]
        one, two, three = valid[before], valid[v], valid[after]
        for u in range(width):
            total[u] = above[u] + here[u] + below[u]
            is_whole[u] = one[u] & two[u] & three[u]
        least = limit if 0 < v < height - 1 else np.float32(-1)
        for u in range(1, width - 1):
            mean = (total[u - 1] + total[u] + total[u + 1]) * np.float32(1 / 9)
            is_near = (abs(mean - here[u]) <= least) & is_whole[u - 1] & is_whole[u]
            out[u] = mean if is_near & is_whole[u + 1] else here[u]
        out[0], out[width - 1] = here[0], here[width - 1]
    return smooth


@kernel('void(UniTuple(int64, 2), int64, uint64[::1], float32[:, ::1])')
def _lay_out(extent, width, offset, pixels):
    """Write the pixels of a cell: their distance from its corner in the image, their u and v."""
    for p in range(extent[0] * extent[1]):
        v, u = p // extent[1], p % extent[1]
        offset[p], pixels[0, p], pixels[1, p] = v * width + u, u, v


@kernel('void(int32[:, ::1], int64, boolean[:, ::1], int32[:, ::1], boolean[:, ::1], int64)')
def _fill_cells(found, shift, valid, labels, is_open, size):
    """
    Write the labels of cells that are not open to their valid pixels.

    All others keep what they have, but for -1 if the labels are the first.
    """
    (height, width), (rows, columns) = found.shape, labels.shape
    for row in range(rows):
        end = 0
        while end < columns:
            start, label, is_shut = end, labels[row, end], not is_open[row, end]
            while end < columns and labels[row, end] == label and is_open[row, end] != is_shut:
                end += 1
            left, right, is_named = start * size, min(end * size, width), is_shut and label >= 0
            name = np.int32(label + shift if is_named else -1)
            for v in range(row * size, min(row * size + size, height)
                           if is_named or shift == 0 else 0):
                here, is_valid = found[v, left:right], valid[v, left:right]
                for u in range(len(here)):
                    other = np.int32(-1) if shift == 0 else here[u]
                    here[u] = name if is_valid[u] else other


@kernel('boolean(int32[:, ::1], int64, int64, int32[::1])')
def _find_labels_around(labels, row, column, near):
    """Write the labels of the 3 x 3 cells around one, then -1; return whether there are any."""
    count, last = 0, np.int32(-1)
    for r in range(max(row - 1, 0), min(row + 2, labels.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, labels.shape[1])):
            if labels[r, c] == last or labels[r, c] < 0:
                continue
            last, is_new = labels[r, c], True
            for k in range(count):
                is_new &= near[k] != last
            if is_new:
                near[count] = last
                count += 1
    near[count] = -1
    return count > 0


@kernel('int32(int32[::1], int32[::1])')
def _majority(chosen, near):
    """Return the label that most of a cell's pixels have, or -1."""
    k = 0
    while near[k] >= 0:
        votes = np.int32(0)
        for p in range(len(chosen)):
            votes += np.int32(chosen[p] == near[k])
        if 2 * votes > len(chosen):
            break
        k += 1
    return near[k]


@kernel('void(float64[:, ::1], int32[::1], UniTuple(int64, 2), float32[:, ::1])')
def _move_planes(planes, near, corner, local):
    """Write the planes in pixels from the corner of a cell."""
    for k, label in enumerate(near):
        if label < 0:
            break
        a, b = planes[label, 0], planes[label, 1]
        local[k, 0], local[k, 1] = a, b
        local[k, 2] = a * corner[1] + b * corner[0] + planes[label, 2]


@kernel('void(float32[:, ::1], int32[::1], int32[::1], float32[:, ::1], UniTuple(float64, 3))')
def _choose_nearest(pixels, chosen, near, local, tolerance):
    """Write the plane of smallest residual of each pixel, -1 where all are too far."""
    of_noise, of_depth = np.float32(tolerance[0]), np.float32(tolerance[1])
    of_slope = np.float32(tolerance[2])
    for p in range(len(chosen)):
        square = pixels[2, p] * pixels[2, p]
        pixels[3, p], pixels[4, p] = of_noise + of_depth * square * square, np.inf
        chosen[p] = -1
    for k, label in enumerate(near):
        if label < 0:
            break
        a, b, c = local[k, 0], local[k, 1], local[k, 2]
        lateral = of_slope * (a * a + b * b)
        for p in range(len(chosen)):
            residual = pixels[2, p] - (a * pixels[0, p] + b * pixels[1, p] + c)
            square = residual * residual
            is_best = (square <= pixels[3, p] + lateral) & (square <= pixels[4, p])
            chosen[p] = label if is_best else chosen[p]
            pixels[4, p] = square if is_best else pixels[4, p]


@kernel('void(float32[:, ::1], int32[::1], int32[::1], float32[:, ::1], int8[:, ::1], int64)')
def _choose_sides(pixels, chosen, near, local, signs, own):
    """
    Relabel the pixels close to an intersection, where residuals are alike, by their side.

    Where the planes of two pieces that do not touch are one within the noise, the label of the
    cell stays.
    """
    count = 0
    while near[count] >= 0:
        count += 1
    for k in range(count):
        for m in range(count):
            one, other, sign = near[k], near[m], signs[near[k], near[m]]
            if one >= other or sign == 0 or (sign == APART and one != own and other != own):
                continue
            closest = np.float32(ALIKE2 if sign == APART else 1)
            a, b, c = (local[k, 0] - local[m, 0], local[k, 1] - local[m, 1],
                       local[k, 2] - local[m, 2])
            for p in range(len(chosen)):
                difference = a * pixels[0, p] + b * pixels[1, p] + c
                is_close = difference * difference < closest * pixels[3, p]
                if (chosen[p] == one or chosen[p] == other) and is_close:
                    if sign == APART:
                        chosen[p] = own
                    else:
                        chosen[p] = one if sign * difference > 0 else other


def close_gaps(labels: np.ndarray, planes: np.ndarray, image: DisparityImage, grid: CellGrid,
               distance_m: float) -> None:
    """
    Label the pixels of narrow gaps.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``, -1 none; overwritten.
    planes : (K, 3) float64
        1/z = a x + b y + c in 1/metres.
    image : DisparityImage
    grid : CellGrid
        Of this image; gaps are wider than a cell by at most a pixel.
    distance_m : float
        Largest distance of a pixel from the plane.

    """
    _close(labels, np.flatnonzero(labels < 0), (planes, grid.planes_in_pixels(planes), grid.lens),
           image.values, image.valid, (grid.size_px + 1, distance_m))


@kernel('void(int32[:, ::1], int64[::1], Tuple((float64[:, ::1], float64[:, ::1], float64[::1])), '
        'float32[:, ::1], boolean[:, ::1], Tuple((int64, float64)))')
def _close(labels, unlabelled, model, disparity, valid, limits):
    """Close the gaps among the unlabelled pixels, along rows and then along columns."""
    (height, width), (planes, in_pixels, lens), (widest, distance_m) = labels.shape, model, limits
    largest, image = np.empty(len(planes)), (disparity, valid)
    for k in range(len(planes)):
        x, y, z = normal_of(planes[k, 0], planes[k, 1], planes[k, 2], lens)
        # A point at 1/z is off the plane by the distance of the plane times its relative residual.
        largest[k] = distance_m * np.sqrt(x * x + y * y + z * z)
    runs, count, end, v = np.empty((len(unlabelled), 3), np.int64), 0, 0, 0
    while end < len(unlabelled):
        pixel = unlabelled[end]
        while pixel >= (v + 1) * width:  # faster than a division
            v += 1
        left, end = pixel - v * width, end + 1
        right = left + 1
        while right < width and end < len(unlabelled) and unlabelled[end] == pixel + right - left:
            right, end = right + 1, end + 1
        runs[count, 0], runs[count, 1], runs[count, 2] = v, left, right
        count += 1
        if (left > 0 and right < width and right - left <= widest
                and labels[v, left - 1] == labels[v, right]):
            for u in range(left, right):
                _label_near(labels, v, u, labels[v, right], in_pixels, largest, image)
    for run in range(count):
        v = runs[run, 0]
        for u in range(runs[run, 1], runs[run, 2] if v + 1 < height else 0):
            if labels[v + 1, u] < 0 or labels[v, u] >= 0:
                continue
            above = v - 1
            while above >= 0 and v - above <= widest and labels[above, u] < 0:
                above -= 1
            if above >= 0 and v - above <= widest and labels[above, u] == labels[v + 1, u]:
                for row in range(above + 1, v + 1):
                    _label_near(labels, row, u, labels[above, u], in_pixels, largest, image)


@kernel('void(int32[:, ::1], int64, int64, int32, float64[:, ::1], float64[::1], '
        'Tuple((float32[:, ::1], boolean[:, ::1])))')
def _label_near(labels, v, u, label, in_pixels, largest, image):
    """Give a pixel a label if it is valid and near that plane."""
    d = image[0][v, u]
    off = abs(in_pixels[label, 0] * u + in_pixels[label, 1] * v + in_pixels[label, 2] - d)
    if image[1][v, u] and off <= largest[label] * d:
        labels[v, u] = label


def find_smears(labels: np.ndarray, planes: np.ndarray, image: DisparityImage,
                grid: CellGrid) -> np.ndarray:
    """
    Find the planes that are smears.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``, -1 none.
    planes : (K, 3) float64
        1/z = a x + b y + c in 1/metres.
    image : DisparityImage
    grid : CellGrid
        Of this image.

    Returns
    -------
    (n,) int64
        Index into the planes.

    """
    # 1/z of a surface seen at this angle changes by this share of it from pixel to pixel.
    steepest = 1 / (math.tan(math.radians(MAX_SMEAR_DEG)) * grid.lens[0] * grid.width_px)
    return np.flatnonzero(_are_smears(labels, grid.planes_in_pixels(planes), image.values,
                                      image.valid, steepest))


@kernel('boolean[::1](int32[:, ::1], float64[:, ::1], float32[:, ::1], boolean[:, ::1], float64)',
        is_short=True)
def _are_smears(labels, planes, disparity, valid, steepest):
    (height, width), count = labels.shape, len(planes)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    pixels, ramps = np.zeros(count, np.int64), np.zeros(count, np.int64)
    slope, across, found = np.empty(count), np.zeros(count), np.zeros(count, np.bool_)
    for v in range(0, height, SPARSE_PX):
        for u in range(0, width, SPARSE_PX):
            k = labels[v, u]
            if k >= 0:
                high[k] = max(high[k], planes[k, 0] * u + planes[k, 1] * v + planes[k, 2])
    any_left = False
    for k in range(count):
        slope[k] = max(np.hypot(planes[k, 0], planes[k, 1]), 1e-12)
        any_left |= slope[k] > steepest * high[k]
    for v in range(height if any_left else 0):
        first = 0  # of a run of equal labels, at whose ends 1/z is least and largest
        for u in range(width):
            k = labels[v, u]
            if u + 1 < width and labels[v, u + 1] == k:
                continue
            if k >= 0:
                for end in (first, u):
                    d = planes[k, 0] * end + planes[k, 1] * v + planes[k, 2]
                    low[k], high[k] = min(low[k], d), max(high[k], d)
            first = u + 1
    any_left = False
    for k in range(count):
        across[k] = (high[k] - low[k]) / slope[k]
        found[k] = slope[k] > steepest * high[k] and 0 < across[k] <= MAX_SMEAR_PX
        any_left |= found[k]
    if not any_left:
        return found
    for v in range(height):
        for u in range(width):
            k = labels[v, u]
            if k < 0 or not found[k]:
                continue
            pixels[k] += 1
            reach, is_ramp = (across[k] + BEHIND_PX) / slope[k], True
            for side in range(2):
                step = reach if side == 0 else -reach
                y, x = int(round(v + step * planes[k, 1])), int(round(u + step * planes[k, 0]))
                end = high[k] if side == 0 else low[k]
                is_ramp &= (0 <= y < height and 0 <= x < width and valid[y, x]
                            and abs(disparity[y, x] - end) <= MAX_END_SHARE * (high[k] - low[k]))
            ramps[k] += is_ramp
    for k in range(count):
        found[k] &= 2 * ramps[k] > pixels[k]
    return found
