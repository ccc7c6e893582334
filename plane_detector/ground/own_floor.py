# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The own floor: the surface under the robot, and the direction down that it determines."""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.robust import order_statistics
from plane_detector.ground.along_ways import first_met
from plane_detector.ground.surfaces import LEVEL_DEG, SIGMAS, SLOPE_MARGIN_DEG, Seen, Surfaces
from plane_detector.ground.ways import Ways
from plane_detector.planes.classification import refine_gravity
from plane_detector.types import COARSE_DEG, Gravity, PlaneSegmentation

# Tuned by benchmark ground on seeds below 9000, unless derived or given by contract; nothing
# changes there from .7 to 1.4 times a value unless stated. The own floor is at the known height of
# the camera within this share of it: the error of the mounting and of gravity, and the rise of a
# ramp in front of the robot.
HEIGHT_TOLERANCE = 0.1
# Shares of the columns of an image that meet a level first. Rendered: in front of drops .85 to 1,
# tables up to .65, the floor beside them at least .1. Flat from .7 on, and from .01 to .1. Tops of
# stairs that a rolled camera sees at one side: .55 to .74.
MAJORITY, HALF, FEW_COLUMNS = 0.75, 0.5, 0.05
# chosen: a robot stands farther than this from a straight edge in front of it. The largest angle
# between the edge and a line straight across the view, the number of directions that are tried,
# and the tolerated share of outliers on the wrong side.
ROBOT_M, MOST_SKEW_DEG, DIRECTIONS, EDGE_STRAYS = 0.5, 45.0, 19, 0.02
# Pieces of one floor that a network bends are at the same height below the camera within this
# share; tables and seats, 1 to 1.8 m below a camera, are higher by at least .25 of it. Flat from
# .05 to .22.
ONE_FLOOR = 0.2
# chosen: the floor nearest to the robot is in one of this many parts of the image, the one where
# the camera looks down most steeply.
NEAR_SHARE = 8
# chosen: the floor is visible if at least this share of the pixels shows it.
SEEN_SHARE = 0.003


def own_floor(found: PlaneSegmentation, seen: Seen, ways: Ways, gravity: Gravity,
              max_slope_deg: float, known_height_m: float, plane_count: int | None = None
              ) -> tuple[np.ndarray | None, int | None]:
    """
    Return the direction down (3,), and the index of the own floor.

    The direction is None if it is too coarse and no floor makes it exact. The own floor is None if
    none is visible and the height of the camera is unknown; it is the number of planes if the
    height is known but the floor is not visible.
    """
    planes, down = found.planes, gravity.gravity_camera
    # Lines in the image may be along a ramp; their scatter does not show this.
    tolerance_deg = max(gravity.tolerance_deg, COARSE_DEG if gravity.source == 'image' else 0.0)
    is_coarse = tolerance_deg > COARSE_DEG
    # Walls distinguish the floor from a ramp only if they do not stand along it: a help, not a
    # reference.
    refined = refine_gravity(planes[:plane_count], down, tolerance_deg) if is_coarse else None
    if refined is not None:
        down, tolerance_deg = refined, LEVEL_DEG
    surfaces = Surfaces.of(found, down, known_height_m)
    steepest_deg = max(max_slope_deg + SLOPE_MARGIN_DEG, tolerance_deg)
    possible = surfaces.slopes_deg <= steepest_deg
    if known_height_m > 0:
        # A ramp in front of the robot has another height under the camera, by its slope and
        # distance.
        far_m = np.linalg.norm(np.cross(surfaces.centroids, down), axis=1)
        rise_m = np.where(surfaces.slopes_deg > LEVEL_DEG,
                          np.tan(np.radians(surfaces.slopes_deg)) * far_m, 0.0)
        off_m = abs(surfaces.heights() - known_height_m)
        possible &= off_m <= HEIGHT_TOLERANCE * known_height_m + rise_m
    possible[-1] = False
    own = _nearest_floor(first_met(seen[1], ways.lines, ways.count, possible), surfaces, seen,
                         ways.count, known_height_m > 0, SIGMAS * float(found.disparity_noise))
    if own is None:
        return (None if is_coarse and refined is None else down,
                len(planes) if known_height_m > 0 else None)
    # A piece of a curved surface is level by chance.
    is_plane = plane_count is None or own < plane_count
    if is_coarse or is_plane and surfaces.slopes_deg[own] <= tolerance_deg:
        down = -planes.normals[own]
    return down, own


def _nearest_floor(votes: np.ndarray, surfaces: Surfaces, seen: Seen, ways: int,
                   is_known: bool, error: float) -> int | None:
    """
    Return the plane that reaches nearest to the robot, by the columns that meet each first.

    At the top of stairs most columns meet the own floor first. Some meet a table, others the floor
    beside it: without a majority, the level that half of them meet is the own floor if it ends at
    an edge as stairs do; otherwise it is the lowest level that several columns meet. ``error`` is
    that of 1/z.
    """
    if not votes.any():
        return None
    columns, heights_m = len(range(0, ways, 4)), surfaces.heights()
    if is_known or votes.max() >= MAJORITY * columns:
        return int(votes.argmax())
    is_met = votes >= min(FEW_COLUMNS * columns, votes.max())
    lowest_m = heights_m[is_met].max()
    at_level = is_met & (heights_m >= (1.0 - ONE_FLOOR) * lowest_m)
    most = int(votes.argmax())
    if (not at_level[most] and votes[most] >= HALF * columns
            and _ends_before_robot(seen, surfaces, most, error)):
        return most
    return int(np.where(at_level, votes, -1).argmax())


def _ends_before_robot(seen: Seen, surfaces: Surfaces, k: int, error: float) -> bool:
    """
    Return whether a plane ends at one straight edge, with the robot on its side.

    The plane does not exist where the camera looks through it. One line across the view separates
    that area from the top of stairs and the robot; beside a table, the floor is visible to the
    left or right.
    """
    (depth_m, labels, (ray_x, ray_y)), down = seen, surfaces.down
    x, y = np.meshgrid(ray_x[::8], ray_y[::8])
    rays, z = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3), depth_m[::8, ::8].ravel()
    sight = rays @ surfaces.normals[k]
    is_down = sight < 0
    inverse_z = sight / -surfaces.offsets[k]  # of the plane, by the pixel
    is_on = is_down & (labels[::8, ::8].ravel() == k)
    is_through = is_down & (z * (inverse_z - error) > 1.0 + ONE_FLOOR)
    if not (is_on.any() and is_through.any()):
        return False
    across = np.linalg.svd(down[None])[2][1:]  # two level axes
    plan = rays @ across.T / np.maximum(inverse_z, 1e-9)[:, None]
    ahead = across[:, 2]  # the optical axis
    angles = np.arctan2(ahead[1], ahead[0]) + np.radians(np.linspace(
        -MOST_SKEW_DEG, MOST_SKEW_DEG, DIRECTIONS))
    away = np.stack([np.cos(angles), np.sin(angles)])
    ends_m = np.quantile(plan[is_on] @ away, 1 - EDGE_STRAYS, axis=0)
    begins_m = np.quantile(plan[is_through] @ away, EDGE_STRAYS, axis=0)
    return bool((np.maximum(ends_m, ROBOT_M) <= begins_m).any())


def rough_floor(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
                down: np.ndarray, min_height: float) -> float:
    """Return the camera's height over a floor that is not a plane, else 0."""
    x, y = rays[0][::8], rays[1][::8, None]
    sight = down[0] * x + (down[1] * y + down[2])
    steepness = sight / np.sqrt(x * x + (y * y + 1))
    rank = sight.size - max(sight.size // NEAR_SHARE, 1)
    is_near = steepness >= order_statistics(steepness.ravel(), rank)[1]
    below_m = (depth_m[::8, ::8] * sight)[is_near]
    is_rough = np.isfinite(below_m) & (labels[::8, ::8][is_near] < 0)
    # A single object in an empty image is not a floor.
    found = np.count_nonzero(is_rough)
    if 2 * found <= np.count_nonzero(np.isfinite(below_m)) or 4 * found < len(below_m):
        return 0.0
    low, middle, high = np.percentile(below_m[is_rough], [10, 50, 90])
    return float(middle) if high - low <= min_height and middle > min_height else 0.0


def why_unseen(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
               surfaces: Surfaces, height_m: float, walkable: np.ndarray) -> str:
    """Return why the level this far below the camera (0: unknown) is not visible, or nothing."""
    if not height_m:
        return ''
    depths, down = depth_m[::8, ::8], surfaces.down
    below_m = depths * np.add.outer(rays[1][::8] * down[1] + down[2], rays[0][::8] * down[0])
    # A wall and clutter have the height of the floor somewhere, but do not keep it.
    is_there = ((abs(below_m - height_m) <= HEIGHT_TOLERANCE * height_m)
                & walkable[labels[::8, ::8]])
    is_level = is_there[:-1, :-1] & is_there[1:, :-1] & is_there[:-1, 1:]
    if np.count_nonzero(is_level) >= SEEN_SHARE * depths.size:
        return ''
    note = f'the floor, {height_m:.2f} m below the camera, is not seen'
    is_level = (surfaces.slopes_deg <= LEVEL_DEG)[:-1]
    if is_level.any():  # planes are in the order of their size
        found_m = surfaces.heights()[is_level.argmax()]
        note += (f', but a level surface {found_m:.2f} m below it: check the unit of depth and '
                 'the height of the camera')
    return note
