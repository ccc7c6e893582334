# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From labels to planes in metres: normal, offset, extent, and how sure they are.

With X = (u - cx) / fx and Y = (v - cy) / fy a plane is 1/z = A X + B Y + C, so its normal is
-(A, B, C) / |(A, B, C)| and its distance from the camera 1 / |(A, B, C)|.
"""

from __future__ import annotations

import numpy as np

from plane_detector import cells
from plane_detector.cells import CellGrid
from plane_detector.noise import Noise
from plane_detector.types import CameraIntrinsics, Plane

# The smooth part of the noise is alike in about this many neighbouring cells.
CORRELATED_CELLS = 9.0


def measure_planes(grid: CellGrid, labels: np.ndarray, planes: np.ndarray, noise: Noise,
                   intrinsics: CameraIntrinsics,
                   min_pixels: float = 1.0) -> tuple[tuple[Plane, ...], np.ndarray]:
    """
    Measure planes, largest first.

    Parameters
    ----------
    grid : CellGrid
    labels : (H, W) int32
        Index into ``planes``, -1 none.
    planes : (K, 3) float64
        1/z = a x + b y + c in the coordinates of the cells.
    noise : Noise
    intrinsics : CameraIntrinsics
    min_pixels : float
        Planes of fewer pixels, or of none, are left out.

    Returns
    -------
    planes : tuple of Plane
    labels : (H, W) int32
        Index into these.

    """
    counts = count_labels(grid, labels, len(planes))
    total = counts.sum(axis=0)
    order = np.argsort(-total, kind='stable')
    order = order[total[order] >= max(min_pixels, 1)]
    measured = tuple(_measure(grid, counts[:, k], planes[k], noise, intrinsics) for k in order)
    return measured, renumber(labels, order, len(planes))


def renumber(labels: np.ndarray, kept: np.ndarray, count: int) -> np.ndarray:
    """Return labels in which ``kept`` of ``count`` labels are 0, 1, ..., all others -1."""
    if len(kept) == count and (kept == np.arange(count)).all():
        return labels
    # One look-up serves -1 too: it is the last entry.
    renumbered = np.full(count + 1, -1, np.int32)
    renumbered[kept] = np.arange(len(kept))
    return renumbered.take(labels, mode='wrap')


def count_labels(grid: CellGrid, labels: np.ndarray, count: int) -> np.ndarray:
    """Return how many pixels of each label each cell has, (R * C, K) float64."""
    rows, columns = grid.shape
    row = np.arange(labels.shape[0], dtype=np.int32) // grid.size_px
    column = np.arange(labels.shape[1], dtype=np.int32) // grid.size_px
    key = (row[:, None] * columns + column) * np.int32(count + 1) + (labels + 1)
    found = np.bincount(key.ravel(), minlength=rows * columns * (count + 1))
    return found.reshape(-1, count + 1)[:, 1:].astype(float)


def _measure(grid: CellGrid, count: np.ndarray, plane: np.ndarray, noise: Noise,
             intrinsics: CameraIntrinsics) -> Plane:
    """Measure one plane from the number of its pixels in each cell."""
    members = np.flatnonzero(count)
    weight = count[members]
    jacobian = _ray_plane_jacobian(intrinsics)
    ray_plane = jacobian @ plane
    length = np.linalg.norm(ray_plane)
    normal, offset_m = -ray_plane / length, 1 / length
    rays = _cell_rays(grid, members, intrinsics)
    disparity = np.maximum(rays @ ray_plane, 1e-9)
    centroid_m = (weight / disparity) @ rays / weight.sum()
    centroid_m -= (normal @ centroid_m + offset_m) * normal
    area_m2 = (weight / disparity**3).sum() / (intrinsics.fx * intrinsics.fy * offset_m)
    rms_m = offset_m * _relative_rms(grid, count, members, plane)
    covariance = _covariance(grid, members, weight, noise, ray_plane, jacobian)
    return Plane(normal, float(offset_m), centroid_m, int(weight.sum()), float(rms_m),
                 float(area_m2), covariance, 1.0)


def _ray_plane_jacobian(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the matrix (3, 3) that takes (a, b, c) to (A, B, C)."""
    width, height = intrinsics.width, intrinsics.height
    return np.array([
        [intrinsics.fx / width, 0, 0], [0, intrinsics.fy / width, 0],
        [(intrinsics.cx - (width - 1) / 2) / width, (intrinsics.cy - (height - 1) / 2) / width,
         1]])


def _cell_rays(grid: CellGrid, members: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return (X, Y, 1) at the mean of each cell's pixels, (n, 3)."""
    u_px = grid.mean[members, 0] * intrinsics.width + (intrinsics.width - 1) / 2
    v_px = grid.mean[members, 1] * intrinsics.width + (intrinsics.height - 1) / 2
    return np.stack([(u_px - intrinsics.cx) / intrinsics.fx,
                     (v_px - intrinsics.cy) / intrinsics.fy, np.ones(len(members))], axis=1)


def _relative_rms(grid: CellGrid, count: np.ndarray, members: np.ndarray,
                  plane: np.ndarray) -> float:
    """
    Return the rms of (1/z - plane) / (1/z); times the offset it is the distance in metres.

    Cells that the plane has to itself say it; when there is none, all its cells do.
    """
    moments = grid.moments[members]
    whole = count[members] == moments[:, cells.N]
    moments = moments[whole] if whole.any() else moments
    square = np.maximum(cells.squared_error(plane, moments), 0)
    middle = moments[:, cells.D] / moments[:, cells.N]
    return float(np.sqrt((square / middle**2).sum() / moments[:, cells.N].sum()))


def _covariance(grid: CellGrid, members: np.ndarray, weight: np.ndarray, noise: Noise,
                ray_plane: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Propagate the noise through the fit to (normal, offset), (4, 4)."""
    share = weight / grid.moments[members, cells.N]
    m = share @ grid.moments[members]
    normal_matrix = np.array([[m[cells.XX], m[cells.XY], m[cells.X]],
                              [m[cells.XY], m[cells.YY], m[cells.Y]],
                              [m[cells.X], m[cells.Y], m[cells.N]]])
    middle = m[cells.D] / m[cells.N]
    variance = (noise.grain**2 + noise.floor(middle)
                + CORRELATED_CELLS * grid.size_px**2 * noise.mean**2)
    fit = variance * np.linalg.pinv(normal_matrix, hermitian=True)
    length = np.linalg.norm(ray_plane)
    unit = ray_plane / length
    to_normal = -(np.eye(3) - np.outer(unit, unit)) / length
    to_offset = -unit / length**2
    chain = np.vstack([to_normal, to_offset]) @ jacobian
    return chain @ fit @ chain.T
