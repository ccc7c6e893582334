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
    cells = np.full((count, count), UNKNOWN, np.int8)
    ray_x, ray_y = pixel_rays(intrinsics)
    moved = np.column_stack([to_level.rotation, to_level.translation_m])
    pixels = found.ground_result
    # Across a smaller gap, no drop of `min_drop` is less steep than `max_slope`.
    gap_m = ground.min_drop / np.tan(np.radians(max(ground.max_slope, 1.0)))
    _mark(found.depth_m, ray_x, ray_y, moved, pixels.mask, pixels.obstacles, pixels.heights_m,
          np.array([grid.resolution, grid.max_height, gap_m, ground.min_drop]), cells)
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


@kernel(f'void({_FLOATS}, float32[::1], float32[::1], float64[:, ::1], {_MASK}, {_MASK}, '
        f'{_FLOATS}, float64[::1], int8[:, ::1])', subject='ground_pixels')
def _mark(depth_m, ray_x, ray_y, moved, is_ground, is_obstacle, heights_m, limits, cells):
    """Mark the cells of ground and, over it, those of obstacles."""
    per_m, max_height_m, gap_m, step_m = 1 / limits[0], limits[1], limits[2], limits[3]
    middle, count = cells.shape[0] / 2, cells.shape[0]
    height, width = depth_m.shape
    # Places in the level frame, and cells, of the pixels of row v and of the row below.
    places, found = np.empty((2, width, 3)), np.empty((2, width, 2), np.int64)
    for v in range(-1, height):
        own, below = v % 2, (v + 1) % 2
        (a, b, d), (e, f, h), (i, j, k) = _of_row(moved, ray_y[min(v + 1, height - 1)])
        for u in range(width if v + 1 < height else 0):
            if is_ground[v + 1, u]:
                depth, ray = depth_m[v + 1, u], ray_x[u]
                x, y, z = (a * ray + b) * depth + d, (e * ray + f) * depth + h, (
                    i * ray + j) * depth + k
                row, column = int(np.floor(y * per_m + middle)), int(np.floor(x * per_m + middle))
                places[below, u, 0], places[below, u, 1], places[below, u, 2] = x, y, z
                found[below, u, 0], found[below, u, 1] = row, column
                if 0 <= row < count and 0 <= column < count:
                    cells[row, column] = FREE
        for u in range(width if v >= 0 else 0):
            if not is_ground[v, u]:
                continue
            # Far away, rows of pixels are farther apart than cells: the ground continues between
            # two adjacent pixels unless a drop might be between them.
            for side in range(2):
                q, w, other = (v + 1, u, below) if side == 0 else (v, u + 1, own)
                if q == height or w == width or not is_ground[q, w] or (
                        found[own, u, 0] == found[other, w, 0]
                        and found[own, u, 1] == found[other, w, 1]):
                    continue
                x, y = places[own, u, 0], places[own, u, 1]
                dx, dy = places[other, w, 0] - x, places[other, w, 1] - y
                length_m = np.sqrt(dx * dx + dy * dy)
                if length_m > gap_m or abs(places[other, w, 2] - places[own, u, 2]) >= step_m:
                    continue
                steps = 1 + int(length_m * per_m * 2)
                for step in range(1, steps):
                    share = step / steps
                    row = int(np.floor((y + share * dy) * per_m + middle))
                    column = int(np.floor((x + share * dx) * per_m + middle))
                    if 0 <= row < count and 0 <= column < count:
                        cells[row, column] = FREE
    for v in range(height):
        (a, b, d), (e, f, h), _ = _of_row(moved, ray_y[v])
        for u in range(width):
            if is_obstacle[v, u] and not heights_m[v, u] > max_height_m:
                depth, ray = depth_m[v, u], ray_x[u]
                row = int(np.floor(((e * ray + f) * depth + h) * per_m + middle))
                column = int(np.floor(((a * ray + b) * depth + d) * per_m + middle))
                if 0 <= row < count and 0 <= column < count:
                    cells[row, column] = OCCUPIED
