# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels along the ways of an image (`ways`), from the nearest line outward, away from the robot.

An image is its depth, its labels, and the slopes of the rays of its columns and rows.
A plane is a row of five numbers: normal and offset, both divided by the vertical component of the
normal, and the inverse of that component. With s = normal . ray, a pixel of depth z is s z +
offset above the plane along gravity, and its ray meets the plane at z = -offset / s. An error e of
1/z is an error s z z e of the height. ``down`` is a row of three numbers: the direction of
gravity.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.disparity import MIN_DEPTH_M
from plane_detector.ground.ways import (
    DU,
    DV,
    END,
    FIRST,
    FRACTION_BITS,
    HIGH,
    LOW,
    START,
    STEP,
    U,
    V,
)

# What follows was tuned by benchmark ground on seeds below 9000, unless derived; nothing changes
# there from .7 to 1.4 times a value unless stated. Borders of regions are accurate within this
# many pixels: this many consecutive pixels are a surface, and ways this far apart are neighbours.
BORDER_PX = 6
# The foot of a wall differs from the ground by its plane; this part of the difference is the error
# of that plane. Flat from 0 to .014 within .0005 of the obstacles.
FOOT_M = 0.01
# chosen: the height of a way over a plane is averaged over its last dozen pixels; fewer
# consecutive pixels that deviate are noise.
MEAN_SHARE, MAX_MISSES = 0.1, 3
# The error of a plane as a share of that of a pixel: the smooth part of the noise remains. With 1,
# a drop of 10 cm is not found beyond 3 m at a noise of .004.
PLANE_SHARE = 0.3
# Points of one edge are at most this far apart, and this many ways: noise hides the edge in some.
EDGE_GAP_M, EDGE_GAP_PX = 0.15, 24
# The ground must be visible this near, and this much of it, before missing depth counts as a drop.
# The first is the required range: at .7 of it a quarter of such ends is missed, at twice it one
# view is false. The second is for depth images with a border without depth.
VOID_NEAR_M, VOID_LENGTH_M = 3.0, 0.4
# Of two imagers, one sees a strip at its side that the other does not, as wide as they are apart.
# chosen: the widest of usual stereo cameras, 5 to 12 cm; neighbouring rows are this many pixels
# away.
BASELINE_M, BESIDE_PX = 0.12, 16
# derived: a vertical riser leads from the near to the far level; looking down by 40 degrees, the
# depth changes by this share of its height at most, a table's edge before the floor by more.
RISER_DEPTH = 0.7
# chosen: pieces of a bent floor are at most this far apart.
BEND_GAP_M = 0.5
# derived: the inverse of the vertical share of a normal, 5 degrees off the vertical. Heights of
# planes are measured under the camera, which says nothing about a riser between steeper planes.
LEVEL = 1.004
# chosen: no pixel of a pit can be behind its rim; this share allows for depth that is smeared at
# its edges.
BEYOND_SHARE = 0.8

# derived: the columns of planes behind the normal, and of drops behind the point.
OFFSET, INVERSE = 3, 4
DROP, WAY, NEXT_DEPTH, NEXT_RANGE, MEASURED = range(3, 8)
# Types of the loops' arguments.
_LABELS = "Array(int32, 2, 'C', readonly=True)"
_RAYS, _PLANES, _LINES = 'UniTuple(float32[::1], 2)', 'float32[:, ::1]', 'int64[:, ::1]'
_SEEN = f"Tuple((Array(float32, 2, 'C', readonly=True), {_LABELS}, {_RAYS}))"
_WAYS = f'Tuple(({_LINES}, int64))'


@kernel(f'UniTuple(int64, 10)({_LINES}, int64)')
def _line(lines, i):
    """Return the numbers of a line, in the order of its columns."""
    return (lines[i, U], lines[i, V], lines[i, DU], lines[i, DV], lines[i, START], lines[i, STEP],
            lines[i, FIRST], lines[i, END], lines[i, LOW], lines[i, HIGH])


@kernel(f'int64({_LINES}, int64, int64)')
def _position(lines, i, w):
    """Return the position of a way on a line."""
    at = (lines[i, START] + w * lines[i, STEP]) >> FRACTION_BITS
    return min(max(at, lines[i, LOW]), lines[i, HIGH] - 1)


@kernel('float32(float32[:, ::1], int64, float32, float32)')
def _depth_on(planes, k, x, y):
    """Return the depth at which a ray meets a plane; negative or infinite if it does not."""
    return -planes[k, OFFSET] / (planes[k, 0] * x + planes[k, 1] * y + planes[k, 2])


@kernel('float32(float32[::1], float32, float32)')
def _far(down, x, y):
    """Return the horizontal distance of a ray at depth 1 from the point under the camera."""
    sight = down[0] * x + down[1] * y + down[2]
    return np.sqrt(max(x * x + y * y + np.float32(1) - sight * sight, np.float32(0)))


@kernel(f'int64[::1]({_LABELS}, {_LINES}, int64, boolean[::1])', is_short=True)
def first_met(labels, lines, count, possible):
    """Return how many of every fourth way meet each plane before any other candidate."""
    votes, left = np.zeros(len(possible), np.int64), np.arange(0, count, 4)
    n = len(left)
    for i in range(len(lines)):
        u0, v0, du, dv, start, step, first, end, low, high = _line(lines, i)
        before, n = n, 0
        for m in range(before):
            w, k = left[m], np.int32(-1)
            if first <= w < end:
                a = min(max((start + w * step) >> FRACTION_BITS, low), high - 1)
                k = labels[v0 + dv * a, u0 + du * a]
            if 0 <= k < len(possible) and possible[k]:
                votes[k] += 1
            else:
                left[n], n = w, n + 1
    return votes


@kernel(f'UniTuple(int32[:, ::1], 3)({_LABELS}, {_WAYS}, {_RAYS}, {_PLANES}, float32[::1], '
        'boolean[::1], UniTuple(float64, 2))', is_short=True)
def count_borders(labels, ways, rays, planes, down, walkable, limits):
    """
    Return where walkable planes border on each other.

    The first table (K, K) counts the samples of a border at which both have the same height, or at
    which a riser that the robot climbs leads from one level to the other; the second those with a
    higher riser, the third those at which one is higher than the other. The limits are the highest
    step and the highest riser.
    """
    (lines, way_count), (ray_x, ray_y), (max_step, max_riser) = ways, rays, limits
    count = len(planes)
    joins, risers = np.zeros((count, count), np.int32), np.zeros((count, count), np.int32)
    steps = np.zeros((count, count), np.int32)
    height, width = labels.shape
    for v in range(0, height, 4):
        for u in range(0, width, 4):
            a = labels[v, u]
            if a < 0 or a >= count or not walkable[a]:
                continue
            for direction in range(2):  # to the right, and up
                right, up = 1 - direction, direction
                if labels[max(v - up * BORDER_PX, 0), min(u + right * BORDER_PX, width - 1)] == a:
                    continue
                for step in range(1, BORDER_PX + 1):
                    w, h = u + right * step, v - up * step
                    if w >= width or h < 0:
                        break
                    b = labels[h, w]
                    # A sliver of another region between them does not separate them.
                    if b >= 0 and b != a and b < count and walkable[b]:
                        x, y = 0.5 * (ray_x[u] + ray_x[w]), 0.5 * (ray_y[v] + ray_y[h])
                        first, second = (_depth_on(planes, a, x, y), _depth_on(planes, b, x, y))
                        # Both are on one ray: the height between them, along gravity.
                        s = planes[a, 0] * x + planes[a, 1] * y + planes[a, 2]
                        is_level = abs(s * second + planes[a, OFFSET]) <= max_step
                        if is_level and first > 0 and second > 0:
                            joins[a, b] += 1
                            joins[b, a] += 1
                        break
    last, track = np.full(way_count, -1, np.int32), np.zeros(way_count, np.float32)
    for i in range(len(lines)):
        u0, v0, du, dv, start, step, first, end, low, high = _line(lines, i)
        if (u0 + v0) % 2:
            continue
        for w in range((first + 3) // 4 * 4, end, 4):
            a = min(max((start + w * step) >> FRACTION_BITS, low), high - 1)
            u, v = u0 + du * a, v0 + dv * a
            k = labels[v, u]
            if k < 0 or k >= count or not walkable[k]:
                continue
            z = _depth_on(planes, k, ray_x[u], ray_y[v])
            far = z * _far(down, ray_x[u], ray_y[v])
            j = last[w]
            if j >= 0 and k != j:
                up = planes[j, OFFSET] - planes[k, OFFSET]
                s = planes[j, 0] * ray_x[u] + planes[j, 1] * ray_y[v] + planes[j, 2]
                # Pixels without a plane between them, as where a floor is bent, do not separate
                # them.
                is_level = abs(s * z + planes[j, OFFSET]) <= max_step
                if far - track[w] <= BEND_GAP_M:
                    steps[j, k] += not is_level
                    steps[k, j] += not is_level
                if is_level and far - track[w] <= BEND_GAP_M:
                    joins[j, k] += 1
                    joins[k, j] += 1
                elif abs(up) <= max_riser and (
                        up < 0 or abs(far - track[w]) <= max(RISER_DEPTH * up, max_step)):
                    if abs(up) > max_step:
                        risers[j, k] += 1
                        risers[k, j] += 1
                    elif max(planes[j, INVERSE], planes[k, INVERSE]) < LEVEL:
                        joins[j, k] += 1
                        joins[k, j] += 1
            last[w], track[w] = k, far
    return joins, risers, steps


@kernel(f'UniTuple(int64[::1], 2)({_SEEN}, float32[::1], float64, float64, int64)',
        is_short=True)
def count_off_level(seen, down, level_m, most_m, count):
    """Count every eighth pixel of each plane (K,), and those of them that are off a level."""
    (depth_m, labels, (ray_x, ray_y)) = seen
    pixels, off = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for v in range(0, labels.shape[0], 8):
        for u in range(0, labels.shape[1], 8):
            k = labels[v, u]
            if 0 <= k < count:
                sight = ray_x[u] * down[0] + ray_y[v] * down[1] + down[2]
                pixels[k] += 1
                off[k] += abs(depth_m[v, u] * sight - level_m) > most_m
    return pixels, off


@kernel(f'Tuple((boolean[:, ::1], float32[:, ::1]))({_SEEN}, {_WAYS}, {_PLANES}, float32[::1], '
        'boolean[::1], int64, UniTuple(float64, 3))', subject='ground_pixels')
def mark_ground(seen, ways, planes, down, is_ground, own, limits):
    """
    Return the pixels (H, W) of the ground, and their height over the ground before them.

    Each is measured from the last plane of ground on its way and, if it is on a plane that is not
    ground, from the ground without a plane behind that. A pixel on no other plane may be on ground
    too small for a plane, such as the far end of a ramp: then it is measured from a point of the
    ground shortly before it, for the steepest ground. The limits are the
    height of the smallest obstacle, the tangent of the steepest ground and the error of 1/z. The
    height is NaN where depth is invalid.
    """
    (depth_m, labels, (ray_x, ray_y)), (lines, way_count) = seen, ways
    (min_height, slope, error), (height, width) = limits, depth_m.shape
    ground, heights = np.zeros(height * width, np.bool_), np.empty(height * width, np.float32)
    depths, regions = depth_m.reshape(-1), labels.reshape(-1)
    reference = np.full(way_count, own, np.int32)
    low_m, foot, error = np.float32(min_height), np.float32(FOOT_M), np.float32(error)
    nearest, endless, zero = np.float32(MIN_DEPTH_M), np.float32(np.inf), np.float32(0)
    # Of each way: the pixel in which it was last on a plane of the ground, until one is measured
    # from it, and by how much its last pixels are higher than the plane; then how far below the
    # camera and ahead of it that is; sums of these and number of the pixels since; whether an
    # obstacle is between: the ground behind may be level, but is not seen to rise or fall; how
    # many pixels one after another may be one.
    last_seen, higher = np.full(way_count, -1, np.int32), np.zeros(way_count, np.float32)
    below, ahead = np.full(way_count, np.nan, np.float32), np.zeros(way_count, np.float32)
    sums, since = np.zeros((way_count, 2), np.float32), np.zeros(way_count, np.int32)
    is_hidden, misses = np.zeros(way_count, np.bool_), np.zeros(way_count, np.int32)
    # Of each way: by how much the ground without a plane is higher than the plane, and its pixels.
    lift, lifted = np.zeros(way_count, np.float32), np.zeros(way_count, np.int32)
    slope = np.float32(slope)
    interval = low_m / max(slope, np.float32(1e-3))
    count = np.uint32(len(is_ground) - 1)
    dx, dy = ray_x[min(1, width - 1)] - ray_x[0], ray_y[min(1, height - 1)] - ray_y[0]
    for i in range(len(lines)):
        u0, v0, du, dv, start, step, first, _, low, high = _line(lines, i)
        per_step = 1.0 / step
        origin, stride = v0 * width + u0, dv * width + du
        x0, x_step, y0, y_step = ray_x[u0], du * dx, ray_y[v0], dv * dy
        last, slant, s0, d = np.int64(-1), zero, zero, zero
        for at in range(low, high):
            # The last way that is not behind this position: exact, as positions are integers.
            w = np.uint64(max(first, np.int64((((at + 1) << FRACTION_BITS) - 0.5 - start)
                                              * per_step)))
            p = np.uint64(origin + stride * at)
            z, k = depths[p], np.uint32(regions[p])
            if not nearest <= z < endless:
                heights[p] = np.nan
            else:
                on_plane = k < count
                belongs = on_plane and is_ground[k]
                r = np.int64(k) if belongs else np.int64(reference[w])
                if r != last:  # along the line, the height of depth 1 is s0 + slant at
                    s0 = planes[r, 0] * x0 + planes[r, 1] * y0 + planes[r, 2]
                    slant = planes[r, 0] * x_step + planes[r, 1] * y_step
                    d, last = planes[r, OFFSET], r
                s = s0 + slant * np.float32(at)
                h = s * z + d
                if on_plane and not belongs and lifted[w] > MAX_MISSES:
                    h -= lift[w]
                off = abs(h)
                heights[p] = h
                # A plane that is not ground was distinguished from it by all its pixels.
                near = (off <= (foot if on_plane and not belongs else low_m)
                        or off <= abs(s) * z * z * error)
                if near and belongs:
                    ground[p], is_hidden[w] = True, False
                    higher[w] += (h - higher[w]) * (np.float32(MEAN_SHARE) if reference[w] == k
                                                    else np.float32(1))
                    reference[w], last_seen[w], lifted[w] = k, p, 0
                elif on_plane and not belongs:
                    ground[p] = near
                    # A surface no higher than the robot climbs hides nothing.
                    is_hidden[w] |= off > low_m + abs(s) * z * z * error
                else:
                    if last_seen[w] >= 0:
                        v, u = last_seen[w] // width, last_seen[w] % width
                        z_last = _depth_on(planes, reference[w], ray_x[u], ray_y[v])
                        below[w] = (z_last * (down[0] * ray_x[u] + down[1] * ray_y[v] + down[2])
                                    - higher[w])
                        ahead[w] = z_last * _far(down, ray_x[u], ray_y[v])
                        last_seen[w], since[w], misses[w] = -1, 0, 0
                    x, y = x0 + x_step * np.float32(at), y0 + y_step * np.float32(at)
                    sight = down[0] * x + down[1] * y + down[2]
                    far = zero if is_hidden[w] else z * _far(down, x, y)
                    # The way must be at least this long, so that an error in the depth of a wall
                    # leads nowhere.
                    way = zero if is_hidden[w] else far - ahead[w] - z * z * error
                    rise = abs(z * sight - below[w])
                    steepest = min(max(low_m, slope * way), 2 * low_m)
                    if not near and not is_hidden[w] and reference[w] != own:
                        # Behind a lower level, such as a reflection, the own floor continues.
                        h = (z * (planes[own, 0] * x + planes[own, 1] * y + planes[own, 2])
                             + planes[own, OFFSET])
                        if abs(h) <= low_m:
                            near, reference[w], heights[p], last_seen[w] = True, own, h, -1
                            below[w], ahead[w] = z * sight, far
                    ground[p] = (near or rise <= steepest or rise <= abs(sight) * z * z * error)
                    if not ground[p]:
                        misses[w] += 1
                        is_hidden[w] |= misses[w] >= MAX_MISSES
                    elif not is_hidden[w]:
                        if since[w] == 0:
                            sums[w, 0], sums[w, 1] = zero, zero
                        sums[w, 0] += z * sight
                        sums[w, 1] += far
                        since[w], misses[w] = since[w] + 1, 0
                        if way > low_m / 2:  # it continues: the foot of an obstacle does not
                            lifted[w] += 1
                            lift[w] += ((h - lift[w]) / np.float32(lifted[w])
                                        if lifted[w] < 1 / MEAN_SHARE else
                                        (h - lift[w]) * np.float32(MEAN_SHARE))
                        if way >= interval:
                            below[w], ahead[w] = sums[w, 0] / since[w], sums[w, 1] / since[w]
                            since[w] = 0
    return ground.reshape(height, width), heights.reshape(height, width)


@kernel(f'float64[:, ::1]({_SEEN}, boolean[:, ::1], {_WAYS}, {_PLANES}, float32[::1], '
        'boolean[::1], int64, UniTuple(float64, 2))', subject='ground_pixels')
def mark_drops(seen, ground, ways, planes, down, is_ground, own, limits):
    """
    Return the ends of the ground with a lower surface behind, (N, 8), on every second way.

    Columns are x y z, the drop, the way, depth and range at which the next ground would have been
    visible, and the depth measured at the end. The drop is NaN where nothing is visible behind the
    end; otherwise the last three are 0. Metres. The limits are the smallest drop and the
    error of 1/z.
    """
    (depth_m, labels, rays), (lines, way_count), (min_drop, error) = seen, ways, limits
    (ray_x, ray_y), (height, width) = rays, depth_m.shape
    found, count, planes_count = np.empty((2 * way_count, 8)), 0, len(is_ground) - 1
    # For each way: where the last ground is, on which plane and at which depth; then how many
    # pixels are lower, and how many are neither lower nor ground.
    end, end_k = np.full(way_count, -1, np.int32), np.full(way_count, -1, np.int32)
    end_z, drop = np.zeros(way_count), np.zeros(way_count)
    lower, mixed = np.zeros(way_count, np.int32), np.zeros(way_count, np.int32)
    # The last drop found, its plane, the lines on which it is visible; the last line.
    pending, pending_k = np.full(way_count, -1, np.int32), np.zeros(way_count, np.int32)
    pending_end = np.zeros(way_count, np.int32)
    regions, is_ground_at = labels.reshape(-1), ground.reshape(-1)
    for i in range(len(lines)):
        u0, v0, du, dv, start, step, first, last, low, high = _line(lines, i)
        for w in range((first + 1) // 2 * 2, last, 2):
            a = min(max((start + w * step) >> FRACTION_BITS, low), high - 1)
            u, v, e = u0 + du * a, v0 + dv * a, end_k[w]
            p = np.uint64(v * width + u)
            if e < 0 and not is_ground_at[p]:
                continue  # no ground has started
            k = regions[p]
            if k >= 0 and k == e and is_ground_at[p]:
                end[w], end_z[w], lower[w], mixed[w] = i, 0.0, 0, 0
                continue
            z = np.float64(depth_m[v, u])
            if not (z >= MIN_DEPTH_M and z < np.inf):
                continue
            x, y, on_plane = ray_x[u], ray_y[v], 0 <= k < planes_count
            if pending[w] >= 0 and ground[v, u]:
                j = pending_k[w]
                s = planes[j, 0] * x + planes[j, 1] * y + planes[j, 2]
                # On the plane in front of the drop, or certainly at its level.
                off = abs(s * z + planes[j, OFFSET]) + abs(s) * z * z * error
                if k == j or off <= 0.5 * found[pending[w], DROP]:
                    if _is_reflection(seen, lines, (pending_end[w], i, w), (j, z), planes, down,
                                      limits):
                        found[pending[w], WAY] = -1
                    pending[w] = -1
            if e >= 0 and k < 0 and ground[v, u]:
                end[w], end_z[w], lower[w] = i, z, 0
                continue
            if e >= 0:
                x_end, y_end = _ray_at(lines, end[w], w, rays)
                if end_z[w] == 0.0:
                    end_z[w] = _depth_on(planes, e, x_end, y_end)
                s = planes[e, 0] * x + planes[e, 1] * y + planes[e, 2]
                margin = abs(s) * z * z * error
                if on_plane:
                    z_plane = np.float64(_depth_on(planes, k, x, y))
                    if abs(1 / z_plane - 1 / z) <= error:  # it is more exact than a pixel
                        z, margin = z_plane, PLANE_SHARE * margin
                off = s * z + planes[e, OFFSET]
                # Behind the upper end of a ramp, everything is lower than the ramp would be.
                under = z * (x * down[0] + y * down[1] + down[2]) - end_z[w] * (
                    x_end * down[0] + y_end * down[1] + down[2])
                if min(-off, under) > min_drop + margin and z > end_z[w]:
                    lower[w] += 1
                    drop[w] = under if lower[w] == 1 else max(drop[w], under)
                    if lower[w] < BORDER_PX:
                        continue
                    if count < len(found):
                        row = found[count]
                        row[0], row[1], row[2] = x_end * end_z[w], y_end * end_z[w], end_z[w]
                        row[DROP], row[WAY], row[NEXT_DEPTH] = drop[w], w, 0.0
                        row[NEXT_RANGE], row[MEASURED] = 0.0, 0.0
                        pending[w], pending_k[w], pending_end[w] = count, e, end[w]
                        count += 1
                    end_k[w] = -1
                elif off > min_drop or (on_plane and is_ground[k] and ground[v, u]):
                    end_k[w] = -1  # an obstacle hides what is behind, or ground continues
                else:
                    mixed[w] += 1
                    lower[w] = 0
                    if mixed[w] > BORDER_PX:
                        end_k[w] = -1
            if end_k[w] < 0 and ground[v, u]:
                if on_plane and is_ground[k]:
                    end[w], end_k[w], end_z[w], lower[w], mixed[w] = i, k, 0.0, 0, 0
                elif k < 0 and own == planes_count:  # the own floor is not a plane
                    end[w], end_k[w], end_z[w], lower[w], mixed[w] = i, own, z, 0, 0
    # A border at the side that never has depth ends a way, as the border of the image does; so
    # does the strip that one imager of two sees alone, unless there is depth in rows beside.
    size = max(width, height)
    nearest, farthest = np.full((2, size), size, np.int64), np.full((2, size), -1, np.int64)
    for v in range(0, height, 4):
        for u in range(0, width, 4):
            if depth_m[v, u] >= MIN_DEPTH_M and depth_m[v, u] < np.inf:
                nearest[0, v], nearest[1, u] = min(nearest[0, v], u), min(nearest[1, u], v)
                farthest[0, v], farthest[1, u] = max(farthest[0, v], u), max(farthest[1, u], v)
    for w in range(0, way_count, 2):
        e = end_k[w]
        if e < 0 or count == len(found):
            continue
        x_end, y_end = _ray_at(lines, end[w], w, rays)
        z_end = end_z[w]
        if z_end == 0.0:
            z_end = _depth_on(planes, e, x_end, y_end)
        axis, i = lines[end[w], DV], len(lines) - 1
        at, last, slopes = ((lines[end[w], V], width - 1, ray_x) if axis == 0
                          else (lines[end[w], U], height - 1, ray_y))
        strip = BASELINE_M / (z_end * (slopes[1] - slopes[0]))
        begin, stop = max(at - BESIDE_PX, 0), at + BESIDE_PX + 1
        low = max(nearest[axis].min(), min(nearest[axis, begin:stop].min(), strip)) + BORDER_PX
        high = min(farthest[axis].max(),
                   max(farthest[axis, begin:stop].max(), last - strip)) - BORDER_PX
        while i > end[w] and not (lines[i, FIRST] <= w < lines[i, END]
                                  and low <= _position(lines, i, w) <= high):
            i -= 1
        if i == end[w]:
            continue
        x, y = _ray_at(lines, i, w, rays)
        z = np.float64(_depth_on(planes, e, x, y))
        near = z_end * _far(down, x_end, y_end)
        if near <= VOID_NEAR_M and (z < 0 or z * _far(down, x, y) > near + VOID_LENGTH_M):
            row = found[count]
            row[0], row[1], row[2] = x_end * z_end, y_end * z_end, z_end
            row[DROP], row[WAY] = np.nan, w
            x, y = _ray_at(lines, end[w] + 1, w, rays)
            z = _depth_on(planes, e, x, y)
            row[NEXT_DEPTH] = z if z > 0 else np.inf
            row[NEXT_RANGE] = row[NEXT_DEPTH] * np.sqrt(x * x + y * y + 1)
            a = _position(lines, end[w], w)
            row[MEASURED] = depth_m[lines[end[w], V] + lines[end[w], DV] * a,
                                    lines[end[w], U] + lines[end[w], DU] * a]
            count += 1
    return found[:count]


@kernel(f'UniTuple(float32, 2)({_LINES}, int64, int64, {_RAYS})')
def _ray_at(lines, i, w, rays):
    """Return the slopes of the ray of a way on a line."""
    a = _position(lines, i, w)
    return rays[0][lines[i, U] + lines[i, DU] * a], rays[1][lines[i, V] + lines[i, DV] * a]


@kernel(f'boolean({_SEEN}, {_LINES}, UniTuple(int64, 3), Tuple((int64, float64)), {_PLANES}, '
        'float32[::1], UniTuple(float64, 2))')
def _is_reflection(seen, lines, stretch, rim, planes, down, limits):
    """
    Return whether lower pixels between two lines of a way are behind the following ground.

    In front of the rim of a pit is its bottom, and below the rim its wall. Anything behind the
    rim, seen through the ground, is a reflection in it. The stretch is two lines and
    the way; the rim is the plane in front of the drop and the depth behind it.
    """
    (depth_m, _, rays), (first, last, w), (e, z_rim) = seen, stretch, rim
    min_drop, error = limits
    x, y = _ray_at(lines, last, w, rays)
    rim_m = z_rim * _far(down, x, y)
    lower = beyond = 0
    for i in range(first + 1, last):
        a = _position(lines, i, w)
        u, v = lines[i, U] + lines[i, DU] * a, lines[i, V] + lines[i, DV] * a
        x, y, z = rays[0][u], rays[1][v], np.float64(depth_m[v, u])
        s = planes[e, 0] * x + planes[e, 1] * y + planes[e, 2]
        if (z >= MIN_DEPTH_M and z < np.inf
                and -(s * z + planes[e, OFFSET]) > min_drop + abs(s) * z * z * error):
            lower += 1
            beyond += z * _far(down, x, y) > rim_m + min_drop + z * z * error
    return beyond >= BEYOND_SHARE * lower


@kernel('int64[::1](float64[:, ::1])', is_short=True, subject='ground_pixels')
def rows_of(drops):
    """Return the row (N,) of each drop; they are in the order of their ways."""
    rows, count = np.empty(len(drops), np.int64), 0
    for i in range(len(drops)):
        rows[i], nearest = count, EDGE_GAP_M
        for j in range(i - 1, -1, -1):
            if drops[i, WAY] - drops[j, WAY] > EDGE_GAP_PX:
                break
            far = np.sqrt((drops[i, 0] - drops[j, 0]) ** 2 + (drops[i, 1] - drops[j, 1]) ** 2
                          + (drops[i, 2] - drops[j, 2]) ** 2)
            if drops[j, WAY] < drops[i, WAY] and far <= nearest:
                rows[i], nearest = rows[j], far
        if rows[i] == count:
            count += 1
    return rows
