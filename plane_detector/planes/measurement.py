# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels to planes in metres: normal, offset, extent, covariance and confidence.

With X = (u - cx) / fx and Y = (v - cy) / fy a plane is 1/z = A X + B Y + C. Its normal is
-(A, B, C) / |(A, B, C)|, and its distance from the camera is 1 / |(A, B, C)|.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.planes.region_samples import MIN_COSINE
from plane_detector.segmentation.cells.grid import (
    MIN_EIGENVALUE,
    XX,
    XY,
    YY,
    D,
    N,
    X,
    Y,
    lens_of,
    squared_error,
)
from plane_detector.segmentation.cells.model import PixelRegions, relabel_sequential
from plane_detector.segmentation.cells.noise import CORRELATED_CELLS, SLOPE_PER_NOISE
from plane_detector.types import CameraIntrinsics, Planes, PlaneSegmentation

# derived: the columns of the sums behind those of the moments: z x, z y and z of the plane at the
# middle of the cells, z**3 of the plane, and the square of (1/z - plane) / (1/z); then the first
# six moments again, of cells all of whose pixels are of one plane.
XZ, YZ, Z, ZZZ, SQUARE, WHOLE, SUMS = 10, 11, 12, 13, 14, 15, 21
# Lower bound of the disparity, to avoid division by 0.
# chosen: far below what any sensor measures.
TINY_DISPARITY = 1e-9
# derived: the columns of measurements: normal (3), centroid (3), offset, rms, area, confidence and
# the covariance (4 x 4) of normal and offset.
CENTROID, OFFSET, RMS, AREA, CONFIDENCE, COVARIANCE = 3, 6, 7, 8, 9, 10
# The errors of a plane are those of the whole cells to which it was fitted, if these hold at least
# this share of its pixels; otherwise, of all its pixels.
MIN_WHOLE_SHARE = 0.3
# Structure throughout the image resembles noise. Above this share of both the typical disparity
# and that of a region, it is not noise, and the region is rejected.
MAX_NOISE_SHARE = 0.125
# chosen: with fewer cells the noise is hardly known, because no cells four apart can be compared.
MIN_CELLS_A_SIDE = 5
# Normals with a smaller standard deviation count as exact.
MIN_TILT_RAD = 1e-4
# tuned: fitted to rendered rooms by `benchmark confidence` of 98cc53d, checked on others.
CONFIDENCE_WEIGHTS = (1.19, 0.43, -0.56)
# In measured depth, the rms in excess of this many times that of the noise, divided by the square
# root of the area, at which the confidence is half: leaves or people are not planes.
# tuned: 6 rooms and 6 lived-in rooms from seed 200 with noise, Brier score: lived-in rooms .156
# without, .142 to .147 from .028 to .056; rooms .064 without, .066 to .065. At 1 times the noise
# rooms get .089, at 1.5 times nothing changes.
MAX_ROUGHNESS, NOISE_MARGIN = 0.04, 1.2
Measure = Callable[[PixelRegions, CameraIntrinsics, float], tuple[Planes, np.ndarray]]
"""As :func:`measure_planes`."""


def measure_planes(regions: PixelRegions, intrinsics: CameraIntrinsics,
                   min_pixels: float = 1.0) -> tuple[Planes, np.ndarray]:
    """
    Measure planes, largest first.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in 1/metres; in another unit, the planes are in its inverse.
    intrinsics : CameraIntrinsics
    min_pixels : float
        Planes with fewer pixels, or without pixels, are dropped.

    Returns
    -------
    planes : Planes
        Labelled from 1 on.
    labels : (H, W) int32
        Index into these, -1 none.

    """
    noise = regions.noise
    sums = sum_over_pixels(regions, intrinsics)
    is_kept = sums[:, N] >= max(min_pixels, 1)
    if noise.mean_sigma > noise.source_sigma:
        typical = np.maximum(sums[:, D], regions.grid.typical_disparity * sums[:, N])
        is_kept &= noise.mean_sigma * sums[:, N] <= MAX_NOISE_SHARE * typical
    kept = np.argsort(-sums[:, N], kind='stable')
    kept = kept[is_kept[kept]]
    labels = relabel_sequential(regions.labels, kept, len(sums))
    return planes_from_sums(regions, sums, kept, intrinsics), labels


def measured_segmentation(regions: PixelRegions, intrinsics: CameraIntrinsics, min_share: float,
                          measure: Measure = measure_planes) -> PlaneSegmentation:
    """Measure the planes that cover at least a share of the image."""
    min_pixels = min_share * regions.labels.size
    planes, labels = measure(regions, intrinsics, min_pixels)
    return PlaneSegmentation(planes, labels, regions.noise.mean_sigma,
                             systematic_noise=regions.noise.systematic_sigma,
                             plane_note=missing_planes_note(regions, labels, min_pixels))


def missing_planes_note(regions: PixelRegions, labels: np.ndarray, min_pixels: float) -> str:
    """
    Return why large regions are not planes, or why there are none; empty if neither.

    ``labels`` (H, W) are those that :func:`measure_planes` returned.
    """
    rows, columns = regions.grid.shape
    if min(rows, columns) < MIN_CELLS_A_SIDE and not (labels >= 0).any():
        height, width = labels.shape
        return (f'{width} x {height} pixels are too few to tell planes from noise: at least '
                f'{MIN_CELLS_A_SIDE * regions.grid.size_px} a side are needed')
    noise, typical = regions.noise, regions.grid.typical_disparity
    if noise.mean_sigma <= max(noise.source_sigma, MAX_NOISE_SHARE * typical):
        return ''
    lost = np.bincount(regions.labels[(regions.labels >= 0) & (labels < 0)])
    lost = lost[lost >= max(min_pixels, 1)]
    if not lost.size:
        return ''
    return (f'{lost.size} planes on {lost.sum()} pixels dropped: the noise of 1/z, '
            f'{noise.mean_sigma:.3g}, is more than {MAX_NOISE_SHARE:.3g} of theirs '
            'and of the image')


def planes_from_sums(regions: PixelRegions, sums: np.ndarray, kept: np.ndarray,
                     intrinsics: CameraIntrinsics) -> Planes:
    """Measure some of the planes from the sums (K, 21) over their pixels."""
    noise, camera, sums_kept = regions.noise, intrinsics, sums[kept]
    mesh_shares = regions.mesh_shares(np.rint(sums[:, N]))
    table = _measured(
        sums_kept, regions.coefficients[kept], ray_plane_jacobian(camera),
        (noise.pixel_sigma**2 + noise.disparity_floor**2, noise.depth_floor_m**2,
         *_smooth_noise(regions), (noise.lateral_px / regions.grid.width_px)**2,
         # The errors of a network bend its planes.
         np.inf if noise.source_sigma > 0 else MAX_ROUGHNESS**2), mesh_shares[kept],
        (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height))
    certainty, of_class = (np.broadcast_to(one, len(sums))[kept].astype(float)
                           for one in (regions.certainty, regions.class_certainty))
    normals, centroids_m = table[:, :CENTROID].copy(), table[:, CENTROID:OFFSET].copy()
    offsets_m, rms_m, areas_m2, sure = table[:, OFFSET:COVARIANCE].T.copy()
    return Planes(normals, offsets_m, centroids_m, np.rint(sums_kept[:, N]).astype(np.int64),
                  rms_m, areas_m2, table[:, COVARIANCE:].reshape(-1, 4, 4).copy(),
                  sure * certainty, of_class, labels=np.arange(1, len(kept) + 1))


def _smooth_noise(regions: PixelRegions) -> tuple[float, float]:
    """
    Return the variance of the smooth noise, and the area in pixels that shares its value.

    Noise that is stated for a network is a Gaussian field whose slope is SLOPE_PER_NOISE times its
    deviation: its correlation length is the image width divided by that.
    """
    noise, size_px = regions.noise, regions.grid.size_px
    variance = max(noise.mean_sigma**2 - (noise.pixel_sigma / size_px) ** 2, noise.source_sigma**2)
    if noise.source_sigma > 0:
        return variance, 2 * np.pi * (regions.grid.width_px / SLOPE_PER_NOISE) ** 2
    return variance, regions.correlated_px or CORRELATED_CELLS * size_px**2


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, ::1], '
        'UniTuple(float64, 6), float64[::1], UniTuple(float64, 6))', is_short=True)
def _measured(sums, planes, jacobian, noise, mesh_shares, camera):
    """
    Return the measurements (K, 26) of planes, in the columns of this module.

    The variance of a pixel's own noise is the sum of a constant and a multiple of the fourth power
    of 1/z; the variance of the smooth noise, the area that shares its value, the lateral variance,
    and the square of the largest roughness follow. A pixel of a mesh may contain a little of the
    background: all pixels are shifted by as much as they deviate, and averaging does not reduce
    that.
    """
    fx, fy, cx, cy, width, height = camera
    table, chain, fit = np.zeros((len(sums), 26)), np.empty((4, 3)), np.empty((3, 3))
    for k in range(len(sums)):
        row, pixels, length2 = table[k], sums[k, N], 0.0
        for i in range(3):
            for j in range(3):
                row[i] -= jacobian[i, j] * planes[k, j]
            length2 += row[i] ** 2
        row[OFFSET] = offset_m = 1 / np.sqrt(length2)
        # x is (u - middle) / width, the ray's X is (u - cx) / fx.
        x_z = width * sums[k, XZ] + ((width - 1) / 2 - cx) * sums[k, Z]
        y_z = width * sums[k, YZ] + ((height - 1) / 2 - cy) * sums[k, Z]
        row[CENTROID], row[CENTROID + 1] = x_z / (fx * pixels), y_z / (fy * pixels)
        row[CENTROID + 2], off_plane = sums[k, Z] / pixels, offset_m
        for i in range(3):
            row[i] *= offset_m
            off_plane += row[i] * row[CENTROID + i]
        for i in range(3):
            row[CENTROID + i] -= off_plane * row[i]
        row[RMS] = offset_m * np.sqrt(sums[k, SQUARE] / pixels)
        row[AREA] = sums[k, ZZZ] / (fx * fy * offset_m)
        fitted = sums[k, WHOLE:] if sums[k, WHOLE] > MIN_WHOLE_SHARE * pixels else sums[k]
        own = noise[0] + noise[1] * (sums[k, D] / pixels) ** 4
        _fit_errors(fitted, (own, noise[2], noise[3]), width, fit)
        fit[2, 2] += mesh_shares[k] * sums[k, SQUARE] / pixels * (sums[k, D] / pixels) ** 2
        _differentiate(row, jacobian, chain)
        for i in range(16):
            for j in range(9):
                row[COVARIANCE + i] += (chain[i // 4, j // 3] * fit[j // 3, j % 3]
                                        * chain[i % 4, j % 3])
        of_normal = row[COVARIANCE] + row[COVARIANCE + 5] + row[COVARIANCE + 10]
        # The root mean cube of z is at least its root mean square.
        expected = (offset_m * NOISE_MARGIN * np.cbrt(sums[k, ZZZ] / pixels)) ** 2 * (
            own + noise[2] + noise[4] * (planes[k, 0] ** 2 + planes[k, 1] ** 2))
        excess = max(row[RMS] ** 2 - expected, 0.0) / row[AREA]
        row[CONFIDENCE] = (confidence(pixels / (width * height), np.sqrt(of_normal))
                           / (1 + excess / noise[5]))
    return table


@kernel('void(float64[::1], UniTuple(float64, 3), float64, float64[:, ::1])')
def _fit_errors(m, noise, width, fit):
    """
    Write the covariance (3, 3) of the plane fitted to pixels of moments m.

    The own noise of the pixels gives the normal equations. If noise is smooth over an area A, n
    pixels hold about 1 + n / A independent values of it. It shifts a region much smaller than A by
    its deviation and tilts it by its slope, that of a Gaussian field with the correlation length
    sqrt(A / 2 pi).
    """
    own, smooth, area = noise
    x, y = m[X] / m[N], m[Y] / m[N]
    xx, xy, yy = m[XX] - m[N] * x * x, m[XY] - m[N] * x * y, m[YY] - m[N] * y * y
    fit[:] = 0.0
    for variance, shared in ((own, 0.0), (smooth * area, area)):
        added = (shared / width) ** 2 / (2 * np.pi)
        s_xx, s_yy = xx + added, yy + added
        scale = variance / max(s_xx * s_yy - xy * xy, MIN_EIGENVALUE * (s_xx + s_yy) ** 2)
        fit[0, 0] += scale * s_yy
        fit[1, 1] += scale * s_xx
        fit[0, 1] -= scale * xy
        fit[2, 2] += variance / (m[N] + shared)
    fit[1, 0] = fit[0, 1]
    for i in range(2):
        fit[i, 2] = fit[2, i] = -(fit[i, 0] * x + fit[i, 1] * y)
    fit[2, 2] -= fit[0, 2] * x + fit[1, 2] * y


@kernel('void(float64[::1], float64[:, ::1], float64[:, ::1])')
def _differentiate(plane, jacobian, chain):
    """Write the derivatives (4, 3) of (normal, offset) by (a, b, c)."""
    offset_m = plane[OFFSET]
    for i in range(4):
        for j in range(3):
            chain[i, j] = 0
            for k in range(3):
                by_ray = (offset_m * plane[k] if i == 3
                          else plane[i] * plane[k] - (1.0 if i == k else 0.0))
                chain[i, j] += offset_m * by_ray * jacobian[k, j]


@kernel('float64(float64, float64)')
def confidence(share, deviation_rad):
    """
    Return the probability that a plane exists in the scene.

    Logistic in the logarithms of its share of the image and of the standard deviation of its
    normal, fitted to whether planes of rendered rooms match a true plane.
    """
    logit = (CONFIDENCE_WEIGHTS[0] + CONFIDENCE_WEIGHTS[1] * np.log(share)
             + CONFIDENCE_WEIGHTS[2] * np.log(max(deviation_rad, MIN_TILT_RAD)))
    return 1 / (1 + np.exp(-logit))


def ray_plane_jacobian(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the matrix (3, 3) that maps (a, b, c) to (A, B, C)."""
    fx, fy, x, y = lens_of(intrinsics)
    return np.array([[fx, 0, 0], [0, fy, 0], [x, y, 1]])


def normal_matrices(m: np.ndarray) -> np.ndarray:
    """Return the sums of the products of x, y and 1, (K, 3, 3), of moments m (10, K)."""
    return np.array([[m[XX], m[XY], m[X]], [m[XY], m[YY], m[Y]],
                     [m[X], m[Y], m[N]]]).transpose(2, 0, 1)


def sum_over_pixels(regions: PixelRegions, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Return the sums (K, 21) over the pixels of each plane, in the columns of this module.

    The moments of each cell are shared by its pixels. In most cells all valid pixels are of one
    plane: the moments give the residuals. The pixels of the other cells are read, once for each of
    their planes. 1/z of a plane is not below that of a ray that sees it edge-on.
    """
    grid, planes = regions.grid, np.ascontiguousarray(regions.coefficients)
    lowest = MIN_COSINE * np.linalg.norm(planes @ ray_plane_jacobian(intrinsics).T, axis=1)
    return _sum_over_pixels(
        np.ascontiguousarray(regions.labels), np.ascontiguousarray(regions.disparity),
        (planes, np.maximum(lowest, TINY_DISPARITY)), (grid.moments, grid.mean, grid.size_px),
        np.array([grid.width_px, *grid.origin]))


@kernel('float64[:, ::1](int32[:, ::1], float32[:, ::1], Tuple((float64[:, ::1], float64[::1])), '
        'Tuple((float64[:, ::1], float64[:, ::1], int64)), float64[::1])')
def _sum_over_pixels(labels, disparity, seen, cells, frame):
    """Return the sums (K, 21) over the pixels of planes (K, 3) and their smallest 1/z (K,)."""
    (planes, lowest), (moments, mean, size), (height, width) = seen, cells, labels.shape
    sums, columns, cell = np.zeros((len(planes), SUMS)), np.empty((2, width), np.int32), -1
    pixels, own = np.zeros((3, size**2), np.float32), np.empty(size**2, np.int32)
    spread = (size / frame[0]) ** 2 / 12
    for p in range(size**2):
        pixels[0, p], pixels[1, p] = p % size, p // size
    for top in range(0, height, size):
        _sum_columns(labels, top, min(top + size, height), columns)
        for left in range(0, width, size):
            cell, label, total = cell + 1, np.int32(-1), np.int32(0)
            for u in range(left, min(left + size, width)):
                label, total = max(label, columns[0, u]), total + columns[1, u]
            if label >= 0 and total == (label + 1) * moments[cell, N]:
                plane, middle, pixels_here = planes[label], mean[cell], moments[cell, N]
                error = squared_error(plane[0], plane[1], plane[2], moments[cell])
                _add_cell(moments[cell], middle, plane, lowest[label], pixels_here, sums[label])
                cube = _cube_of_depth(plane, middle, lowest[label], spread)
                sums[label, ZZZ] += pixels_here * cube
                sums[label, SQUARE] += max(error, 0.0) / max(middle[2], TINY_DISPARITY) ** 2
                for j in range(SUMS - WHOLE):
                    sums[label, WHOLE + j] += moments[cell, j]
            elif label >= 0:
                _load(labels, disparity, (top, left, size), own, pixels)
                _sum_parts(own, pixels, (planes, lowest, moments[cell], mean[cell]),
                           (label, top, left), frame, sums)
    return sums


@kernel('void(int32[:, ::1], int64, int64, int32[:, ::1])')
def _sum_columns(labels, top, bottom, columns):
    """Write the largest label and the sum of label + 1 of each column from top to bottom."""
    for u in range(labels.shape[1]):
        columns[0, u], columns[1, u] = -1, 0
    for v in range(top, bottom):
        for u in range(labels.shape[1]):
            columns[0, u] = max(columns[0, u], labels[v, u])
            columns[1, u] += labels[v, u] + np.int32(1)


@kernel('void(int32[:, ::1], float32[:, ::1], UniTuple(int64, 3), int32[::1], float32[:, ::1])')
def _load(labels, disparity, corner, own, pixels):
    """Copy the labels of a cell, and z to the last row of its pixels, behind their u and v."""
    (top, left, size), least = corner, np.float32(TINY_DISPARITY)
    for p in range(size**2):
        own[p] = -1
    for i in range(min(size, labels.shape[0] - top)):
        for j in range(min(size, labels.shape[1] - left)):
            # Unsigned: no wrap-around check.
            p, v, u = np.uint64(i * size + j), np.uint64(top + i), np.uint64(left + j)
            own[p], pixels[2, p] = labels[v, u], np.float32(1) / max(disparity[v, u], least)


@kernel('void(int32[::1], float32[:, ::1], '
        'Tuple((float64[:, ::1], float64[::1], float64[::1], float64[::1])), '
        'UniTuple(int64, 3), float64[::1], float64[:, ::1])')
def _sum_parts(own, pixels, cell, place, frame, sums):
    """Add the pixels of each label in a cell to the sums; its largest label comes first."""
    (planes, lowest, moments, mean), (label, top, left) = cell, place
    while label >= 0:
        plane, this, below = planes[label], np.int32(label), np.int32(-1)
        a, b = np.float32(plane[0] / frame[0]), np.float32(plane[1] / frame[0])
        c = np.float32(plane[0] * (frame[1] + left / frame[0])
                       + plane[1] * (frame[2] + top / frame[0]) + plane[2])
        count, square, cube = np.int32(0), np.float32(0), np.float32(0)
        least = np.float32(lowest[label])
        for p in range(len(own)):
            on_plane = a * pixels[0, p] + b * pixels[1, p] + c
            relative = np.float32(1) - on_plane * pixels[2, p]
            depth = np.float32(1) / max(on_plane, least)
            count += np.int32(own[p] == this)
            cube += depth * depth * depth if own[p] == this else np.float32(0)
            square += relative * relative if own[p] == this else np.float32(0)
            below = max(below, own[p] if own[p] < this else np.int32(-1))
        _add_cell(moments, mean, plane, lowest[label], count, sums[label])
        sums[label, SQUARE] += square
        sums[label, ZZZ] += cube
        label = np.int64(below)


@kernel('float64(float64[::1], float64[::1], float64, float64)')
def _cube_of_depth(plane, mean, least, spread):
    """
    Return the mean of z**3 of a plane over a cell, whose x and y have this variance.

    To second order it is that of the middle, and 6 times the relative variance of 1/z more.
    """
    depth = 1 / max(plane[0] * mean[0] + plane[1] * mean[1] + plane[2], least)
    return depth**3 * (1 + 6 * spread * (plane[0] ** 2 + plane[1] ** 2) * depth * depth)


@kernel('void(float64[::1], float64[::1], float64[::1], float64, float64, float64[::1])')
def _add_cell(moments, mean, plane, least, pixels, sums):
    """Add the share of a cell that some of its pixels have to the sums (21,) of a plane."""
    share = pixels / max(moments[N], 1.0)
    for j in range(10):
        sums[j] += share * moments[j]
    depth = 1 / max(plane[0] * mean[0] + plane[1] * mean[1] + plane[2], least)
    sums[XZ] += pixels * depth * mean[0]
    sums[YZ] += pixels * depth * mean[1]
    sums[Z] += pixels * depth
