# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes and gravity to ground, obstacles and drops; the steps are in the folder's docstring."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector.config import Config, GroundConfig
from plane_detector.directions.gravity_choice import COARSE_DEG, Gravity
from plane_detector.geometry.projection import pixel_rays
from plane_detector.ground.columns import (
    count_borders,
    first_met,
    mark_drops,
    mark_ground,
    rows_of,
)
from plane_detector.planes.classification import (
    PlaneClass,
    are_certain,
    classify_planes,
    refine_gravity,
)
from plane_detector.types import CameraIntrinsics, GroundPixels, PlaneSegmentation

# Tuned by benchmark ground on seeds below 9000, unless derived or given by contract; nothing
# changes there from .7 to 1.4 times a value unless stated.
# The own floor is at the known height of the camera within this share of it: the error of a
# mounting and of gravity, and what a ramp that begins before the robot rises to.
HEIGHT_TOLERANCE = 0.1
# Shares of the columns of an image that meet a level first. Rendered: before drops .85 to 1,
# tables up to .65, the floor beside them at least .1. Flat from .7 on, and from .01 to .1.
MAJORITY, FEW_COLUMNS = 0.75, 0.05
# Pieces of one floor, as a network bends it, are at the same height of the camera within this
# share; tables and seats, 1 to 1.8 m below a camera, are higher by at least .25 of it. Flat from
# .05 to .22.
ONE_FLOOR = 0.2
# Slopes within the accuracy of an IMU or of a level plane count as level.
LEVEL_DEG = 3.0
# derived: steeper by the error of gravity and of the plane, a slope is still within max_slope.
SLOPE_MARGIN_DEG = 1.0
# derived: the floor that is nearest to the robot is in the lowest of so many parts of the image.
NEAR_SHARE = 8
# Borders are sampled at every fourth pixel; fewer samples that join are chance.
MIN_JOINS = 3
# By contract: a level within this height of the own floor, reached by risers, is a step.
STEP_RANGE_M = 0.5
# An error counts as a difference beyond this many standard deviations. With 2, less of a far
# level behind a ramp is ground, with 4 half as much again of the obstacles.
SIGMAS = 3.0
# Drops are told only if an error of depth does not look like one at this distance, metres.
TOLD_AT_M, LARGEST_ERROR_M = 2.0, 0.3
# A row of points along an edge is at least this long.
MIN_EDGE_M = 0.12


@dataclass(frozen=True)
class Ground:
    """The ground of one image."""

    classes: tuple[PlaneClass, ...]  # one per plane
    # the ground of the image and the drops, in the optical frame
    pixels: GroundPixels | SeenGround
    # height above the own floor, and angle of the optical axis below the horizon; NaN unknown
    camera_height_m: float = np.nan
    tilt_deg: float = np.nan
    note: str = ''  # why there are no drops; empty if they are searched for


@dataclass(frozen=True)
class Surfaces:
    """Planes that one may stand on, as surfaces; the last one is level, at the camera's height."""

    normals: np.ndarray  # (K + 1, 3)
    offsets: np.ndarray  # (K + 1,)
    covariances: np.ndarray  # (K + 1, 4, 4)
    centroids: np.ndarray  # (K + 1, 3)
    # (K + 1,) float64: angle between their upper side and the vertical; above 90 for what faces
    # down
    slopes_deg: np.ndarray
    down: np.ndarray  # (3,) float64

    @classmethod
    def of(cls, found: PlaneSegmentation, down: np.ndarray, height_m: float) -> Surfaces:
        """Collect the planes of an image."""
        planes = found.planes
        normals = np.vstack([planes.normals, -down])
        return cls(normals, np.append(planes.offsets_m, height_m),
                   np.concatenate([planes.covariances, np.zeros((1, 4, 4))]),
                   np.vstack([planes.centroids_m, height_m * down]),
                   np.degrees(np.arccos(np.clip(-normals @ down, -1, 1))), down)

    def heights(self) -> np.ndarray:
        """Return the height (K + 1,) of the camera over each plane, infinite over walls."""
        return self.offsets / np.maximum(-self.normals @ self.down, 1e-9)

    def above(self, own: int) -> tuple[np.ndarray, np.ndarray]:
        """Return height and error (K + 1,) of each plane's centroid over one of them."""
        points = np.column_stack([self.centroids, np.ones(len(self.offsets))])
        upright = max(-self.normals[own] @ self.down, 1e-9)
        heights = (self.centroids @ self.normals[own] + self.offsets[own]) / upright
        variances = sum(np.einsum('ki,kij,kj->k', points, covariances, points)
                        for covariances in (self.covariances, self.covariances[[own]].repeat(
                            len(points), axis=0)))
        return heights, np.sqrt(np.maximum(variances, 0.0))

    def table(self) -> np.ndarray:
        """Return the rows (K + 1, 5) of the compiled loops: normal, offset, 1 / upright share."""
        upright = np.maximum(-self.normals @ self.down, 1e-6)
        return np.column_stack([self.normals, self.offsets, 1 / upright]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SeenGround:
    """
    As :class:`~plane_detector.types.GroundPixels`, found when its attributes are first read.

    They take most of the time of :func:`find_ground`, and only a few users read them.
    """

    depth_m: np.ndarray
    labels: np.ndarray
    rays: tuple[np.ndarray, np.ndarray]
    table: np.ndarray  # of `Surfaces`
    is_ground: np.ndarray  # (K + 1,) bool
    own: int
    down: np.ndarray
    limits: GroundConfig
    error: float  # of 1/z
    tells_drops: bool

    @cached_property
    def mask(self) -> np.ndarray:
        """Pixels (H, W) of the ground."""
        return mark_ground(self.depth_m, self.labels, *self.rays, self.table, self.is_ground,
                           self.own, level_axes(self.down), self.limits.min_height,
                           np.tan(np.radians(self.limits.max_slope)), self.error)

    @property
    def drops_m(self) -> np.ndarray:
        """Points (N, 3) along the edges."""
        return self._drops[:, :3]

    @property
    def drop_depths_m(self) -> np.ndarray:
        """By how much it is down there, (N,)."""
        return self._drops[:, 3]

    @cached_property
    def _drops(self) -> np.ndarray:
        if not self.tells_drops:
            return np.zeros((0, 5))
        return _rows(mark_drops(self.depth_m, self.labels, self.mask, *self.rays, self.table,
                                self.is_ground, self.own, self.down, self.limits.min_drop,
                                self.error))


def find_ground(found: PlaneSegmentation, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                gravity: Gravity, config: Config, *, is_metric: bool = True,
                doubt: str = '') -> Ground:
    """
    Find the ground of an image.

    Parameters
    ----------
    found : PlaneSegmentation
        Planes with true angles.
    depth_m : (H, W) float32
        Of the same image.
    intrinsics : CameraIntrinsics
    gravity : Gravity
    config : Config
        Its ``ground`` and ``scale.camera_height``.
    is_metric : bool
        Whether lengths are in metres. If not, the camera is taken to be 1 m above the floor for
        the classes, and there are neither ground nor drops.
    doubt : str
        Why lengths mean nothing, which then is the note instead of drops.

    Returns
    -------
    Ground

    """
    limits, labels = config.ground, np.ascontiguousarray(found.labels, np.int32)
    nothing = GroundPixels(np.zeros(labels.shape, bool))
    if gravity.gravity_camera is None:
        return Ground((PlaneClass.UNKNOWN,) * len(found.planes), nothing,
                      note='the direction of gravity is not known')
    # 1. and 2. The direction down and the own floor.
    known_m = config.scale.camera_height if is_metric else 0.0
    depth_m, rays = np.ascontiguousarray(depth_m, np.float32), pixel_rays(intrinsics)
    down, own = own_floor(found, labels, gravity, limits.max_slope, known_m)
    if gravity.is_sure and is_metric and not known_m:
        known_m = _rough_floor(depth_m, labels, rays, gravity.gravity_camera, limits.min_height)
        if known_m:
            down, own = gravity.gravity_camera, len(found.planes)
    if down is None:
        return Ground((PlaneClass.UNKNOWN,) * len(found.planes), nothing,
                      note='the direction of gravity is known too coarsely')
    surfaces = Surfaces.of(found, down, known_m)
    tilt_deg = float(np.degrees(np.arcsin(np.clip(down[2], -1, 1))))
    if own is None:
        return Ground(classify_planes(found.planes, down), nothing, tilt_deg=tilt_deg,
                      note='no floor is seen')
    height_m = float(surfaces.heights()[own])
    unit_m = 1.0 if is_metric else height_m
    table = surfaces.table()
    # 3. What joins it.
    walkable = surfaces.slopes_deg <= limits.max_slope + SLOPE_MARGIN_DEG
    joins, risers = count_borders(labels, *rays, table, walkable, limits.max_step * unit_m,
                                  STEP_RANGE_M * unit_m)
    above, above_error = surfaces.above(own)
    joined, at_level, lower = _ground_planes(surfaces, own, above, above_error, walkable, joins,
                                             limits.max_step * unit_m)
    classes = _classes(found, surfaces, above, joined, at_level, risers, unit_m,
                       limits.max_slope + SLOPE_MARGIN_DEG)
    if not is_metric:
        return Ground(classes, nothing, tilt_deg=tilt_deg,
                      note='the unit of depth is not known')
    # 4. and 5. Pixels and drops.
    error = SIGMAS * float(found.disparity_noise)
    error_m = error * TOLD_AT_M * height_m
    if not doubt and error_m > LARGEST_ERROR_M:
        doubt = f'the floor {TOLD_AT_M:g} m away may be {error_m:.2f} m off'
    pixels = SeenGround(depth_m, labels, rays, table, joined | lower, own, down, limits, error,
                        tells_drops=not doubt)
    return Ground(classes, pixels, height_m, tilt_deg, doubt)


def level_axes(down: np.ndarray) -> np.ndarray:
    """Return the directions (2, 3) down, and level in the direction of the optical axis."""
    ahead = np.array([0.0, 0.0, 1.0]) - down[2] * down
    return np.array([down, ahead / max(np.linalg.norm(ahead), 1e-6)], np.float32)


def _rough_floor(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
                 down: np.ndarray, min_height: float) -> float:
    """Return the height of the camera over a floor before the robot that is no plane, else 0."""
    near = slice(-(len(labels) // NEAR_SHARE), None, 4)
    sight = np.add.outer(rays[1][near] * down[1] + down[2], rays[0][::4] * down[0])
    below_m = depth_m[near, ::4] * sight
    is_rough = np.isfinite(below_m) & (labels[near, ::4] < 0)
    if 2 * is_rough.sum() <= np.isfinite(below_m).sum():
        return 0.0
    low, middle, high = np.percentile(below_m[is_rough], [10, 50, 90])
    return float(middle) if high - low <= min_height and middle > min_height else 0.0


def own_floor(found: PlaneSegmentation, labels: np.ndarray, gravity: Gravity,
              max_slope_deg: float, known_height_m: float
              ) -> tuple[np.ndarray | None, int | None]:
    """
    Return the direction down (3,), and the index of the own floor.

    The direction is None if it is too coarse and no floor makes it exact; the own floor is None if
    none is seen and the height of the camera is not known, and the number of planes if it is known
    but the floor is not seen.
    """
    planes, down = found.planes, gravity.gravity_camera
    # Lines in the image may be along a ramp; their own scatter does not tell.
    tolerance_deg = max(gravity.tolerance_deg, COARSE_DEG if gravity.source == 'image' else 0.0)
    is_coarse = tolerance_deg > COARSE_DEG
    # Walls tell the floor from a ramp only if they do not stand along it: a help, no reference.
    refined = refine_gravity(planes, down, tolerance_deg) if is_coarse else None
    if refined is not None:
        down, tolerance_deg = refined, LEVEL_DEG
    surfaces = Surfaces.of(found, down, known_height_m)
    steepest_deg = max(max_slope_deg + SLOPE_MARGIN_DEG, tolerance_deg)
    possible = surfaces.slopes_deg <= steepest_deg
    if known_height_m > 0:
        # A ramp before the robot is at another height under it, by its slope and distance.
        far_m = np.linalg.norm(np.cross(surfaces.centroids, down), axis=1)
        rise_m = np.where(surfaces.slopes_deg > LEVEL_DEG,
                          np.tan(np.radians(surfaces.slopes_deg)) * far_m, 0.0)
        off_m = abs(surfaces.heights() - known_height_m)
        possible &= off_m <= HEIGHT_TOLERANCE * known_height_m + rise_m
    possible[-1] = False
    own = _nearest_floor(first_met(labels, possible), surfaces.heights(), labels.shape[1],
                         known_height_m > 0)
    if own is None:
        return (None if is_coarse and refined is None else down,
                len(planes) if known_height_m > 0 else None)
    if is_coarse or surfaces.slopes_deg[own] <= tolerance_deg:
        down = -planes[own].normal
    return down, own


def _nearest_floor(votes: np.ndarray, heights_m: np.ndarray, width: int,
                   is_known: bool) -> int | None:
    """
    Return which plane reaches nearest to the robot, by the columns that meet each first.

    At the head of stairs all columns meet the own floor first. A table is met by some, others meet
    the floor beside it: without a majority, the lowest level of several columns is the own floor.
    """
    if not votes.any():
        return None
    columns = len(range(0, width, 4))
    if is_known or votes.max() >= MAJORITY * columns:
        return int(votes.argmax())
    is_met = votes >= min(FEW_COLUMNS * columns, votes.max())
    lowest_m = heights_m[is_met].max()
    at_level = is_met & (heights_m >= (1.0 - ONE_FLOOR) * lowest_m)
    return int(np.where(at_level, votes, -1).argmax())


def _ground_planes(surfaces: Surfaces, own: int, above: np.ndarray, error: np.ndarray,
                   walkable: np.ndarray, joins: np.ndarray, max_step: float
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the planes (K + 1,) that join the own floor, those at its level, and lower ones."""
    is_level = abs(surfaces.slopes_deg - surfaces.slopes_deg[own]) <= LEVEL_DEG
    # The error of a plane makes no step of what is level, nor hides a step of half as much again.
    at_level = walkable & is_level & (
        abs(above) <= max_step + np.minimum(SIGMAS * error, 0.5 * max_step))
    at_level[own] = True
    joined, linked = at_level.copy(), joins >= MIN_JOINS
    while True:
        more = joined | (walkable & linked[joined].any(axis=0))
        if (more == joined).all():
            return joined, at_level, walkable & ~joined & (above < -max_step)
        joined = more


def _classes(found: PlaneSegmentation, surfaces: Surfaces, above: np.ndarray, joined: np.ndarray,
             at_level: np.ndarray, risers: np.ndarray, unit_m: float,
             steepest_deg: float) -> tuple[PlaneClass, ...]:
    """Return the class of each plane."""
    classes = np.array([*classify_planes(found.planes, surfaces.down), PlaneClass.FLOOR])
    is_sure_slope = np.array([*are_certain(found.planes, surfaces.down, steepest_deg), True])
    is_level = surfaces.slopes_deg <= LEVEL_DEG
    # Steps are reached from the ground, or from other steps.
    is_step, linked = joined.copy(), risers >= MIN_JOINS
    near = is_level & (abs(above) <= STEP_RANGE_M * unit_m)
    while (more := is_step | (near & linked[is_step].any(axis=0))).sum() > is_step.sum():
        is_step = more
    # A level plane is OTHER only if that is not certain.
    classes[is_step & ~joined & (classes != PlaneClass.OTHER)] = PlaneClass.STEP
    classes[joined & ~at_level & ~is_level & is_sure_slope] = PlaneClass.RAMP
    classes[at_level & is_sure_slope] = PlaneClass.FLOOR
    return tuple(PlaneClass(kind) for kind in classes[:-1])


def _rows(drops: np.ndarray) -> np.ndarray:
    """Return the drops (N, 5) that lie in rows long enough."""
    drops = drops[np.argsort(drops[:, 4], kind='stable')]
    rows = rows_of(drops)
    count = rows.max(initial=-1) + 1
    first, last = np.full(count, len(drops)), np.zeros(count, int)
    np.minimum.at(first, rows, np.arange(len(drops)))
    last[rows] = np.arange(len(drops))
    length = np.linalg.norm(drops[last[rows], :3] - drops[first[rows], :3], axis=1)
    return drops[length >= MIN_EDGE_M]
