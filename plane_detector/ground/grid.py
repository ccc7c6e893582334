# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Ground, obstacles and drops of one image, seen from above: free, occupied or unknown square cells.

A cell is occupied if it contains an obstacle or the edge of a drop, free if it contains ground but
neither of these, and unknown otherwise.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.config import GridConfig, GroundConfig
from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.types import CameraIntrinsics, Detection

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of the cells, those of nav_msgs/OccupancyGrid."""


def level_frame(gravity_camera: np.ndarray, height_m: float) -> RigidTransform:
    """
    Return the transform from the camera to the level frame under it.

    Its origin is on the ground below the camera, z points up, and x in the viewing direction. For
    a camera that looks down or up, x points to the upper or the lower side of the image.

    Parameters
    ----------
    gravity_camera : (3,) floating
        Unit vector down.
    height_m : float
        Of the camera above the ground; NaN: the origin is at the camera.

    Examples
    --------
    >>> level_frame(np.array([0.0, 1.0, 0.0]), 1.5).points(np.array([0.5, 1.5, 4.0])).tolist()
    [4.0, -0.5, 0.0]

    """
    up = -np.asarray(gravity_camera, float)
    # For a camera that looks down, the upper side of the image is ahead; for one that looks up,
    # the lower side.
    ahead = np.array([0.0, np.sign(up[2]), 1.0 - abs(up[2])])
    x = ahead - (ahead @ up) * up
    x /= np.linalg.norm(x)
    return RigidTransform(np.stack([x, np.cross(up, x), up]),
                          np.array([0.0, 0.0, 0.0 if np.isnan(height_m) else height_m]))


def occupancy_grid(found: Detection, intrinsics: CameraIntrinsics, to_level: RigidTransform,
                   ground: GroundConfig, grid: GridConfig) -> np.ndarray:
    """
    Return the cells around the origin of a level frame.

    Parameters
    ----------
    found : Detection
        Its ground must be known.
    intrinsics : CameraIntrinsics
    to_level : RigidTransform
        From the camera into a frame whose z points up.
    ground : GroundConfig
        Its least drop and steepest slope determine how far apart two pixels may be for the ground
        between them to count as seen.
    grid : GridConfig

    Returns
    -------
    (N, N) int8
        UNKNOWN, FREE or OCCUPIED. Row and column 0 are at -size / 2, rows follow y.

    """
    count = max(round(grid.size / grid.resolution), 1)
    marked = np.full(count * count + 1, UNKNOWN, np.int8)
    cells = marked[:-1].reshape(count, count)
    moved = np.column_stack([to_level.rotation, to_level.translation_m])
    pixels = found.ground_result
    # Across a smaller gap, no drop of `min_drop` is less steep than `max_slope`.
    gap_m = ground.min_drop / np.tan(np.radians(max(ground.max_slope, 1.0)))
    _mark(found.depth_m, pixel_rays(intrinsics), moved, pixels.mask, pixels.obstacles,
          pixels.heights_m, (grid.resolution, grid.max_height, gap_m, ground.min_drop), count,
          marked)
    edges = np.floor(to_level.points(pixels.drops_m)[:, :2] / grid.resolution + count / 2)
    for row, column in np.unique(edges[:, ::-1].astype(int), axis=0):
        # With its neighbours, so that there is no gap between two points of an edge.
        cells[max(row - 1, 0):max(row + 2, 0), max(column - 1, 0):max(column + 2, 0)] = OCCUPIED
    return cells


_MASK, _FLOATS = "Array(boolean, 2, 'C', readonly=True)", "Array(float32, 2, 'C', readonly=True)"


@kernel('UniTuple(UniTuple(float64, 3), 3)(float64[:, ::1], float64)', subject='ground_pixels')
def _of_row(moved, y):
    """Return a, b, d of (a x + b) z + d, each coordinate in the level frame, of a row of rays."""
    return ((moved[0, 0], moved[0, 1] * y + moved[0, 2], moved[0, 3]),
            (moved[1, 0], moved[1, 1] * y + moved[1, 2], moved[1, 3]),
            (moved[2, 0], moved[2, 1] * y + moved[2, 2], moved[2, 3]))


@kernel(f'void({_FLOATS}, UniTuple(float32[::1], 2), float64[:, ::1], {_MASK}, {_MASK}, '
        f'{_FLOATS}, UniTuple(float64, 4), int64, int8[::1])', subject='ground_pixels')
def _mark(depth_m, rays, moved, is_ground, is_obstacle, heights_m, limits, count, cells):
    """
    Mark the cells of ground and, over it, those of obstacles.

    There are ``count`` rows and columns of cells, and one cell more for the pixels that mark none,
    so that the loops over the pixels of a row need no branches and are vectorised.
    """
    (resolution_m, max_height_m, gap_m, step_m), (ray_x, ray_y) = limits, rays
    per_m, middle, outside = 1 / resolution_m, count / 2, np.float64(count * count)
    height, width = depth_m.shape
    # Places in the level frame of the pixels of row v and of the row below; NaN without ground.
    places = np.full((2, 3, width + 1), np.nan)
    cell_of, is_apart = np.empty(width, np.int32), np.empty(width, np.bool_)
    # Between pixels nearer than half a cell there is no other; with a margin for rounding.
    near_sq_m, had_ground = 0.99 * (resolution_m / 2) ** 2, False
    for v in range(-1, height):
        own, below, is_last = v % 2, (v + 1) % 2, v + 1 == height
        next_v, has_ground = min(v + 1, height - 1), False
        for u in range(width):
            has_ground |= is_ground[next_v, u]
        (a, b, d), (e, f, h), (i, j, k) = _of_row(moved, ray_y[next_v])
        for u in range(width if has_ground or had_ground else 0):
            depth, ray = depth_m[next_v, u], ray_x[u]
            x, y = (a * ray + b) * depth + d, (e * ray + f) * depth + h
            is_here = is_ground[next_v, u] & (not is_last)
            places[below, 0, u], places[below, 1, u] = x if is_here else np.nan, y
            places[below, 2, u] = (i * ray + j) * depth + k
            row, column = np.floor(y * per_m + middle), np.floor(x * per_m + middle)
            is_inside = is_here & (row >= 0) & (row < count) & (column >= 0) & (column < count)
            cell_of[u] = np.int32(row * count + column if is_inside else outside)
        for u in range(width if has_ground else 0):
            cells[cell_of[u]] = FREE
        for u in range(width if had_ground else 0):
            x, y = places[own, 0, u], places[own, 1, u]
            is_apart[u] = ((places[below, 0, u] - x) ** 2 + (places[below, 1, u] - y) ** 2
                           > near_sq_m) | (
                (places[own, 0, u + 1] - x) ** 2 + (places[own, 1, u + 1] - y) ** 2 > near_sq_m)
        u, has_any, had_ground = -1, had_ground, has_ground
        while has_any:
            u += 1
            while u < width and not is_apart[u]:
                u += 1
            if u >= width:
                break
            # Far away, rows of pixels are farther apart than cells: the ground continues between
            # two adjacent pixels unless a drop might be between them.
            for side in range(2):
                w, other = (u, below) if side == 0 else (u + 1, own)
                x, y = places[own, 0, u], places[own, 1, u]
                dx, dy = places[other, 0, w] - x, places[other, 1, w] - y
                length_m = np.sqrt(dx * dx + dy * dy)
                if not length_m <= gap_m or abs(places[other, 2, w] - places[own, 2, u]) >= step_m:
                    continue  # also NaN
                steps = 1 + int(length_m * per_m * 2)
                for step in range(1, steps):
                    share = step / steps
                    row = int(np.floor((y + share * dy) * per_m + middle))
                    column = int(np.floor((x + share * dx) * per_m + middle))
                    if 0 <= row < count and 0 <= column < count:
                        cells[row * count + column] = FREE
    for v in range(height):
        (a, b, d), (e, f, h), _ = _of_row(moved, ray_y[v])
        for u in range(width):
            depth, ray = depth_m[v, u], ray_x[u]
            row = np.floor(((e * ray + f) * depth + h) * per_m + middle)
            column = np.floor(((a * ray + b) * depth + d) * per_m + middle)
            is_inside = (is_obstacle[v, u] & (not heights_m[v, u] > max_height_m)
                         & (row >= 0) & (row < count) & (column >= 0) & (column < count))
            cell_of[u] = np.int32(row * count + column if is_inside else outside)
        for u in range(width):
            cells[cell_of[u]] = OCCUPIED
