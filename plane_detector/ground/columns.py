# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops along the columns of an image, from below: away from the robot.

A plane is a row of five numbers: normal, offset, and the inverse of the share of its normal that
is vertical. With s = normal . ray, a pixel of depth z is (s z + offset) * inverse above it along
gravity, and the ray meets it at z = -offset / s. An error e of 1/z is an error s * inverse * z * z
* e of the height.
"""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.geometry.disparity import MIN_DEPTH_M

# What follows was tuned by benchmark ground on seeds below 9000, unless derived; nothing changes
# there from .7 to 1.4 times a value unless stated.
# Borders of regions are right within this many pixels: so many pixels one after another are a
# surface, and columns so far apart neighbours.
BORDER_PX = 6
# A wall's foot is told from the ground by its plane; this much of it is the plane's own error.
# Flat from 0 to .014 within .0005 of the obstacles.
FOOT_M = 0.01
# A plane's error as a share of a pixel's: what of the noise is smooth stays. With 1, a drop of
# 10 cm is not told beyond 3 m at a noise of .004.
PLANE_SHARE = 0.3
# Points of one edge are at most this far apart.
EDGE_GAP_M = 0.15
# The ground should be seen this near, and this much of it, before nothing counts as a drop. The
# first is the range asked for: at .7 of it a quarter of the ends of all is missed, at twice it
# a view is false. The second is for depth images with a border without depth.
VOID_NEAR_M, VOID_LENGTH_M = 3.0, 0.4
# derived: a vertical riser leads from the near to the far level; looking down by 40 degrees, the
# depth changes by this share of its height at most, a table's edge before the floor by more.
RISER_DEPTH = 0.7
# derived: the inverse of the vertical share of a normal, 5 degrees off the vertical. Heights of
# planes are those under the camera, which say nothing of a riser between steeper ones.
LEVEL = 1.004

_DEPTH, _LABELS = (f"Array({kind}, 2, 'C', readonly=True)" for kind in ('float32', 'int32'))
_RAYS, _PLANES = 'float32[::1], float32[::1]', 'float32[:, ::1]'


@kernel(f'int64[::1]({_LABELS}, boolean[::1])', is_short=True)
def first_met(labels, possible):
    """Return how many columns meet each plane before any other possible one."""
    votes = np.zeros(len(possible), np.int64)
    for u in range(0, labels.shape[1], 4):
        for v in range(labels.shape[0] - 1, -1, -1):
            k = labels[v, u]
            if 0 <= k < len(possible) and possible[k]:
                votes[k] += 1
                break
    return votes


@kernel('float32(float32[:, ::1], int64, float32, float32)')
def _depth_on(planes, k, x, y):
    """Return the depth at which a ray meets a plane; negative or infinite if it does not."""
    s = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
    return -planes[k, 3] / s


@kernel(f'Tuple((int32[:, ::1], int32[:, ::1]))({_LABELS}, {_RAYS}, {_PLANES}, boolean[::1], '
        'float64, float64)', is_short=True)
def count_borders(labels, ray_x, ray_y, planes, walkable, max_step, max_riser):
    """
    Return where walkable planes border on each other.

    The first table (K, K) counts the samples of a border at which both have the same height, or at
    which a riser that the robot climbs leads from one level to the other; the second those with a
    higher riser.
    """
    count = len(planes)
    joins, risers = np.zeros((count, count), np.int32), np.zeros((count, count), np.int32)
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
                    # A sliver of another region between them does not part them.
                    if b >= 0 and b != a and b < count and walkable[b]:
                        x, y = 0.5 * (ray_x[u] + ray_x[w]), 0.5 * (ray_y[v] + ray_y[h])
                        first, second = (_depth_on(planes, a, x, y), _depth_on(planes, b, x, y))
                        # Both are on one ray: the height between them, along gravity.
                        s = planes[a, 0] * x + planes[a, 1] * y + planes[a, 2]
                        gap = abs((s * second + planes[a, 3]) * planes[a, 4])
                        if gap <= max_step and first > 0 and second > 0:
                            joins[a, b] += 1
                            joins[b, a] += 1
                        break
    for u in range(0, width, 4):
        last, track, below = -1, 0.0, 0.0
        for v in range(height - 1, -1, -2):
            k = labels[v, u]
            if k < 0 or k >= count or not walkable[k]:
                continue
            z = _depth_on(planes, k, ray_x[u], ray_y[v])
            # Depth along the column's ground track, and height below the camera, of this pixel.
            under = planes[k, 3] * planes[k, 4]
            if last >= 0 and k != last:
                up = below - under
                if abs(up) <= max_riser and (
                        up < 0 or abs(z - track) <= max(RISER_DEPTH * up, max_step)):
                    if abs(up) > max_step:
                        risers[last, k] += 1
                        risers[k, last] += 1
                    elif max(planes[last, 4], planes[k, 4]) < LEVEL:
                        joins[last, k] += 1
                        joins[k, last] += 1
            last, track, below = k, z, under
    return joins, risers


@kernel(f'boolean[:, ::1]({_DEPTH}, {_LABELS}, {_RAYS}, {_PLANES}, boolean[::1], int64, '
        'float32[:, ::1], float64, float64, float64)')
def mark_ground(depth_m, labels, ray_x, ray_y, planes, is_ground, own, level, min_height, slope,
                error):
    """
    Return the pixels (H, W) of the ground.

    Each is measured from the plane that its column showed last. One that is on no other plane may
    be on ground too small for a plane, as the far end of a ramp: then it is measured from a point
    of the ground shortly before it, for the directions ``level`` down and ahead, and the tangent
    ``slope`` of the steepest ground. ``error`` is that of 1/z.
    """
    height, width = depth_m.shape
    ground = np.zeros((height, width), np.bool_)
    reference = np.full(width, own, np.int32)
    low, foot, error = np.float32(min_height), np.float32(FOOT_M), np.float32(error)
    nearest, endless = np.float32(MIN_DEPTH_M), np.float32(np.inf)
    # Of each column: the row of its last pixel on a plane of the ground, until a pixel is measured
    # from it; then how far below the camera and ahead of it the point is; whether an obstacle is
    # between: the ground behind may be level, but is not seen to rise or fall.
    last_v = np.full(width, -1, np.int32)
    below, ahead = np.full(width, np.nan, np.float32), np.zeros(width, np.float32)
    is_hidden = np.zeros(width, np.bool_)
    slope = np.float32(slope)
    interval = low / max(slope, np.float32(1e-3))
    count = len(is_ground) - 1
    for v in range(height - 1, -1, -1):
        y, last = ray_y[v], -1
        a, b, c = np.float32(0), np.float32(0), np.float32(0)
        for u in range(width):
            z, k = depth_m[v, u], labels[v, u]
            if not nearest <= z < endless:
                continue
            on_plane = 0 <= k < count
            belongs = on_plane and is_ground[k]
            r = k if belongs else reference[u]
            if r != last:  # along gravity, a pixel of depth z is (a x + b) z + c above it
                a, c = planes[r, 0] * planes[r, 4], planes[r, 3] * planes[r, 4]
                b, last = (planes[r, 1] * y + planes[r, 2]) * planes[r, 4], r
            s = a * ray_x[u] + b
            off = abs(s * z + c)
            # A plane that is no ground was told from it by all its pixels.
            near = (off <= (foot if on_plane and not belongs else low)
                    or off <= abs(s) * z * z * error)
            if near and belongs:
                ground[v, u], is_hidden[u] = True, False
                reference[u], last_v[u] = k, v
                continue
            if on_plane and not belongs:
                ground[v, u] = near
                is_hidden[u] |= not near
                continue
            x = ray_x[u]
            if last_v[u] >= 0:
                y_last = ray_y[last_v[u]]
                z_last = _depth_on(planes, reference[u], x, y_last)
                below[u] = z_last * (level[0, 0] * x + level[0, 1] * y_last + level[0, 2])
                ahead[u] = z_last * (level[1, 0] * x + level[1, 1] * y_last + level[1, 2])
                last_v[u] = -1
            sight = level[0, 0] * x + level[0, 1] * y + level[0, 2]
            far = z * (level[1, 0] * x + level[1, 1] * y + level[1, 2])
            # The way is at least so long: the error of a wall's depth leads nowhere.
            way = np.float32(0) if is_hidden[u] else far - ahead[u] - z * z * error
            rise = abs(z * sight - below[u])
            steepest = min(max(low, slope * way), 2 * low)
            if near or rise <= steepest or rise <= abs(sight) * z * z * error:
                ground[v, u] = True
                if way >= interval:
                    below[u], ahead[u] = z * sight, far
            else:
                is_hidden[u] = True
    return ground


@kernel('void(float64[::1], float32, float32, float64, float64, int64)')
def _write(row, x, y, z, drop, u):
    row[0], row[1], row[2], row[3], row[4] = x * z, y * z, z, drop, u


@kernel(f'float64[:, ::1]({_DEPTH}, {_LABELS}, boolean[:, ::1], {_RAYS}, {_PLANES}, boolean[::1], '
        'int64, float64[::1], float64, float64)')
def mark_drops(depth_m, labels, ground, ray_x, ray_y, planes, is_ground, own, down, min_drop,
               error):
    """
    Return the ends of the ground (N, 5) with a lower surface behind: x y z, the drop, the column.

    Every second column is followed. The drop is NaN where nothing is seen. Metres.
    """
    height, width = depth_m.shape
    found, count, planes_count = np.empty((4 * width, 5)), 0, len(is_ground) - 1
    # Of each column: where the ground was seen last, on which plane and how deep; then how many
    # pixels are lower, and how many neither that nor ground.
    end, end_k = np.full(width, -1, np.int32), np.full(width, -1, np.int32)
    end_z, drop = np.zeros(width), np.zeros(width)
    lower, mixed = np.zeros(width, np.int32), np.zeros(width, np.int32)
    for v in range(height - 1, -1, -1):
        y = ray_y[v]
        for u in range(0, width, 2):
            k = labels[v, u]
            if k >= 0 and k == end_k[u] and ground[v, u]:
                end[u], end_z[u], lower[u], mixed[u] = v, 0.0, 0, 0
                continue
            z = np.float64(depth_m[v, u])
            if not (z >= MIN_DEPTH_M and z < np.inf):
                continue
            x, e, on_plane = ray_x[u], end_k[u], 0 <= k < planes_count
            if e >= 0 and k < 0 and ground[v, u]:
                end[u], end_z[u], lower[u] = v, z, 0
                continue
            if e >= 0:
                if end_z[u] == 0.0:
                    end_z[u] = _depth_on(planes, e, x, ray_y[end[u]])
                s = planes[e, 0] * x + planes[e, 1] * y + planes[e, 2]
                margin = abs(s * planes[e, 4]) * z * z * error
                if on_plane:
                    z_plane = np.float64(_depth_on(planes, k, x, y))
                    if abs(1 / z_plane - 1 / z) <= error:  # it is more exact than a pixel
                        z, margin = z_plane, PLANE_SHARE * margin
                off = (s * z + planes[e, 3]) * planes[e, 4]
                # Behind the upper end of a ramp, all is lower than the ramp would be.
                under = z * (x * down[0] + y * down[1] + down[2]) - end_z[u] * (
                    x * down[0] + ray_y[end[u]] * down[1] + down[2])
                if min(-off, under) > min_drop + margin and z > end_z[u]:
                    lower[u] += 1
                    drop[u] = under if lower[u] == 1 else max(drop[u], under)
                    if lower[u] < BORDER_PX:
                        continue
                    if count < len(found):
                        _write(found[count], x, ray_y[end[u]], end_z[u], drop[u], u)
                        count += 1
                    end_k[u] = -1
                elif off > min_drop or (on_plane and is_ground[k] and ground[v, u]):
                    end_k[u] = -1  # an obstacle hides what is behind, or ground goes on
                else:
                    mixed[u] += 1
                    lower[u] = 0
                    if mixed[u] > BORDER_PX:
                        end_k[u] = -1
            if end_k[u] < 0 and ground[v, u]:
                if on_plane and is_ground[k]:
                    end[u], end_k[u], end_z[u], lower[u], mixed[u] = v, k, 0.0, 0, 0
                elif k < 0 and own == planes_count:  # the own floor is no plane
                    end[u], end_k[u], end_z[u], lower[u], mixed[u] = v, own, z, 0, 0
    for u in range(0, width, 2):
        e, x, y = end_k[u], ray_x[u], ray_y[0]
        if e < 0 or lower[u] > 0 or end[u] == 0 or count == len(found):
            continue
        z, near = _depth_on(planes, e, x, y), end_z[u]
        if near == 0.0:
            near = _depth_on(planes, e, x, ray_y[end[u]])
        if near <= VOID_NEAR_M and (z < 0 or z > near + VOID_LENGTH_M):
            _write(found[count], x, ray_y[end[u]], near, np.nan, u)
            count += 1
    return found[:count]


@kernel('int64[::1](float64[:, ::1])', is_short=True)
def rows_of(drops):
    """Return the row (N,) of each drop; they are in the order of their columns."""
    rows, count = np.empty(len(drops), np.int64), 0
    for i in range(len(drops)):
        rows[i], nearest = count, EDGE_GAP_M
        for j in range(i - 1, -1, -1):
            if drops[i, 4] - drops[j, 4] > BORDER_PX:
                break
            far = np.sqrt((drops[i, 0] - drops[j, 0]) ** 2 + (drops[i, 1] - drops[j, 1]) ** 2
                          + (drops[i, 2] - drops[j, 2]) ** 2)
            if drops[j, 4] < drops[i, 4] and far <= nearest:
                rows[i], nearest = rows[j], far
        if rows[i] == count:
            count += 1
    return rows
