# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Obstacles: what is not ground, without specks and flying pixels.

1. A flying pixel is between a surface and another one behind it, where a sensor averages both: its
   neighbours on opposite sides are nearer and farther by more than on any surface seen at more
   than 10 degrees, and this steep slope is short.
2. A speck is a floating patch of a few pixels, as left by stereo matching: neither ground nor the
   plane of an obstacle is next to it at its depth.
3. A torn rim surrounds a hole in the depth of the ground and is below the ground, because sensors
   measure too far there. Pixels below the ground that are not on a plane are not obstacles within
   a few pixels of such a hole.
4. Depth that repeats exactly, and was removed because it is not a measurement
   (`cells.constant_depth`), may be the front of an obstacle after all. It is not if it would be
   below the ground, like a mask of the robot's body, nor if nothing is visible farther away, as at
   the end of the range, which is not near. Otherwise it is.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.disparity import MIN_DEPTH_M

# After ScanShadowsFilter of ROS's laser_filters: a surface is seen at 10 degrees or more. Depth
# then changes by at most the inverse tangent of the width of a pixel.
STEEPEST = 5.67
# chosen: sensors smear an edge over this many pixels to either side; a longer slope is a surface.
SMEAR_PX = 10
# chosen: a floating patch of fewer pixels is a speck, as in filters for stereo matching; so is a
# patch of noise on a surface.
SPECK_PX, NOISE_PX = 64, 6
# chosen: a constant nearer than this share of the range is not its end; unless it is stated, the
# range is not nearer than this. A constant with more than this share below the ground is not a
# surface.
WITHIN_RANGE, LEAST_RANGE_M, BELOW_SHARE = 0.9, 2.0, 0.05

_DEPTH = "Array(float32, 2, 'C', readonly=True)"
_LABELS = "Array(int32, 2, 'C', readonly=True)"


def find_fronts(constants_m: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
                grounds: np.ndarray, reached_m: float, max_range_m: float, min_height: float,
                error: float) -> tuple[np.ndarray | None, str]:
    """
    Return which constants (H, W) may be fronts of obstacles, None for none, and a note.

    ``grounds`` (N, 5) are the planes of the ground, see `along_ways`; ``reached_m`` is how far the
    sensor has seen, ``max_range_m`` its stated range, or 0; ``error`` is that of 1/z.
    """
    range_m = max(reached_m, max_range_m or LEAST_RANGE_M)
    places_m = constants_m[::8, ::8]
    is_front, depths_m, ends_m = np.zeros(constants_m.shape, bool), [], []
    for value in np.unique(places_m[np.isfinite(places_m)]):
        at = np.argwhere(places_m == value) * 8
        slopes = np.column_stack([rays[0][at[:, 1]], rays[1][at[:, 0]],
                                  np.ones(len(at), np.float32)]) @ grounds[:, :3].T
        margin_m = min_height + abs(slopes) * value**2 * error
        is_below = (slopes * value + grounds[:, 3] < -margin_m).all(axis=1)
        if len(grounds) and is_below.mean() > BELOW_SHARE:
            continue
        if value >= WITHIN_RANGE * range_m:
            ends_m.append(value)
            continue
        is_front |= constants_m == value
        depths_m.append(value)
    notes = []
    if depths_m:
        notes.append(f'{np.count_nonzero(is_front)} of these pixels, from {depths_m[0]:.4g} m on, '
                     'may be the front of an obstacle, and are taken for one: if they are the '
                     'robot itself, set ground.ignore_box; if the range ends there, '
                     'depth.max_range')
    if ends_m and not max_range_m:
        notes.append(f'those from {ends_m[0]:.4g} m on are the end of the range, or a front with '
                     'nothing seen farther away: depth.max_range states the range')
    return is_front if depths_m else None, '; '.join(notes)


@kernel('boolean(float32, float32, float32, float32)')
def _is_beside(z, other, width, error):
    """Return whether the depths of two neighbouring pixels can belong to one surface."""
    return abs(z - other) <= max(z, other) * (width + max(z, other) * error)


@kernel('boolean(float32, float32, float32, float32, float32)')
def _is_steep(before, z, after, width, error):
    """Return whether depth rises or falls between two pixels by more than on a surface."""
    return ((before < z < after or before > z > after)
            and not _is_beside(z, before, width, error) and not _is_beside(z, after, width, error))


@kernel(f'boolean({_DEPTH}, int64, int64, int64, int64, float32, float32)')
def _is_flying(depth_m, v, u, dv, du, width, error):
    """Return whether depth rises steeply at a pixel, over a few pixels, to another surface."""
    last_v, last_u = depth_m.shape[0] - 1, depth_m.shape[1] - 1
    if not (dv <= v <= last_v - dv and du <= u <= last_u - du):
        return False
    before, z, after = depth_m[v - dv, u - du], depth_m[v, u], depth_m[v + dv, u + du]
    if not (before < z < after or before > z > after):
        return False  # most pixels: no slope
    rises, steps = after > z, 0
    for side in range(-1, 2, 2):
        y, x = v, u
        while True:
            z, y, x = depth_m[y, x], y + side * dv, x + side * du
            other = depth_m[y, x] if 0 <= y <= last_v and 0 <= x <= last_u else z
            goes_on = other > z if (side > 0) == rises else other < z
            if not goes_on or _is_beside(z, other, width, error):
                break
            steps += 1
            if steps > 2 * SMEAR_PX:
                return False
        if y == v + side * dv and x == u + side * du or not other >= MIN_DEPTH_M:
            return False  # its neighbour is on the same surface, or no surface is behind it
    return True


@kernel(f'boolean({_DEPTH}, int64, int64)')
def _is_at_hole(depth_m, v, u):
    """Return whether a pixel without depth is a few pixels from a pixel, in its row or column."""
    height, width = depth_m.shape
    for step in range(1, SMEAR_PX + 1):
        for side in range(-step, step + 1, 2 * step):
            if (0 <= v + side < height and not depth_m[v + side, u] >= MIN_DEPTH_M
                    or 0 <= u + side < width and not depth_m[v, u + side] >= MIN_DEPTH_M):
                return True
    return False


@kernel(f'boolean[:, ::1]({_DEPTH}, {_LABELS}, boolean[:, ::1], {_DEPTH}, float64, float64, '
        'float64)', subject='ground_pixels')
def mark_obstacles(depth_m, labels, ground, heights_m, min_height, focal_px, error):
    """Return the pixels (H, W) of obstacles; ``error`` is that of 1/z."""
    height, width = depth_m.shape
    steepest, error = np.float32(STEEPEST / focal_px), np.float32(np.sqrt(2) * error)
    nearest, endless = np.float32(MIN_DEPTH_M), np.float32(np.inf)
    low_m = np.float32(min_height)
    # Pixels of a surface, of a plane that is an obstacle, and others with depth.
    of_pixels = np.empty((3, height, width), np.bool_)
    surface, found, is_loose = of_pixels[0], of_pixels[1], of_pixels[2]
    for v in range(height):
        for u in range(width):
            is_valid = (depth_m[v, u] >= nearest) & (depth_m[v, u] < endless)
            surface[v, u] = ground[v, u] | (labels[v, u] >= 0)
            # The foot of a wall and a low plate are neither ground nor an obstacle.
            found[v, u] = (is_valid & surface[v, u] & (not ground[v, u])
                           & (not abs(heights_m[v, u]) <= low_m))
            is_loose[v, u] = is_valid & (not surface[v, u])
    # Runs of pixels of a row that may be a speck: first and last column, and the patch of each, by
    # its first run; for each patch its pixels, and whether a surface is next to it.
    most = height * (width // 4 + 1)  # the excess stays an obstacle
    begin, end = np.empty(most, np.int32), np.empty(most, np.int32)
    parent, size = np.empty(most, np.int32), np.zeros(most, np.int32)
    is_held = np.zeros(most, np.bool_)
    row_of = np.zeros(height + 1, np.int32)
    count = 0
    for v in range(height):
        row_of[v] = count
        above = row_of[v - 1] if v > 0 else 0
        is_open, u = False, -1
        while True:
            u += 1
            # Most pixels: in the outer loop they would take three times as long.
            while u < width and not is_loose[v, u]:
                u, is_open = u + 1, False
            if u >= width:
                break
            # Here, because the loop above is not vectorised with a call.
            if heights_m[v, u] < -low_m and _is_at_hole(depth_m, v, u):
                is_loose[v, u] = is_open = False
                continue
            z = depth_m[v, u]
            left, right = depth_m[v, max(u - 1, 0)], depth_m[v, min(u + 1, width - 1)]
            upper, lower = depth_m[max(v - 1, 0), u], depth_m[min(v + 1, height - 1), u]
            if (_is_steep(left, z, right, steepest, error)
                    and _is_flying(depth_m, v, u, 0, 1, steepest, error)
                    or _is_steep(upper, z, lower, steepest, error)
                    and _is_flying(depth_m, v, u, 1, 0, steepest, error)):
                is_open = False
                continue
            found[v, u] = True
            if not (is_open and _is_beside(z, depth_m[v, u - 1], steepest, error)):
                if count == most:
                    is_open = False
                    continue
                begin[count], parent[count], is_open = u, count, True
                count += 1
            run = count - 1
            end[run] = u
            size[run] += 1
            # Surfaces next to it, and patches above it.
            for side in range(0 if is_held[run] else 4):
                du, dv = (side == 0) - (side == 1), (side == 2) - (side == 3)
                if not (0 <= u + du < width and 0 <= v + dv < height):
                    continue
                other = depth_m[v + dv, u + du]
                if surface[v + dv, u + du] and _is_beside(z, other, steepest, error):
                    is_held[run] = True
            if v > 0 and found[v - 1, u] and is_loose[v - 1, u] and _is_beside(
                    z, depth_m[v - 1, u], steepest, error):
                while above < row_of[v] and end[above] < u:
                    above += 1
                if above < row_of[v] and begin[above] <= u:
                    first, second = _root(parent, above), _root(parent, run)
                    parent[max(first, second)] = min(first, second)
    row_of[height] = count
    for run in range(count - 1, -1, -1):
        first = _root(parent, run)
        if first != run:
            size[first] += size[run]
            is_held[first] |= is_held[run]
    for v in range(height):
        for run in range(row_of[v], row_of[v + 1]):
            first = _root(parent, run)
            if size[first] < (NOISE_PX if is_held[first] else SPECK_PX):
                found[v, begin[run]:end[run] + 1] = False
    return found


@kernel('int64(int32[::1], int64)')
def _root(parent, run):
    """Return the first run of a patch."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@kernel(f'float32[:, ::1]({_DEPTH}, float32[::1], float32[::1], float32[::1], float64)')
def height_errors(depth_m, ray_x, ray_y, down, sigma):
    """Return the standard deviation of the height of each pixel (H, W), for that of 1/z."""
    errors = np.empty(depth_m.shape, np.float32)
    a, sigma = down[0], np.float32(sigma)
    for v in range(depth_m.shape[0]):
        b = down[1] * ray_y[v] + down[2]
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            errors[v, u] = abs(a * ray_x[u] + b) * z * z * sigma
    return errors


@kernel(f'Tuple((float32[:, ::1], int32[:, ::1]))({_DEPTH}, {_LABELS}, float32[::1], '
        'float32[::1], float32[::1])')
def without_box(depth_m, labels, ray_x, ray_y, box):
    """Return depth and labels without the points in a box: minimum x y z, maximum x y z."""
    depths, kept = depth_m.copy(), labels.copy()
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            x, y = ray_x[u] * z, ray_y[v] * z
            if (box[2] <= z <= box[5] and box[0] <= x <= box[3] and box[1] <= y <= box[4]):
                depths[v, u], kept[v, u] = np.nan, -1
    return depths, kept
