# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes and gravity to ground, obstacles and drops; the steps are in the folder's docstring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import erf

import numpy as np

from plane_detector._runtime.compilation import load_once
from plane_detector.config import Config, GroundConfig
from plane_detector.geometry.disparity import valid_depth
from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.robust import order_statistics
from plane_detector.ground.along_ways import (
    count_borders,
    count_off_level,
    first_met,
    mark_drops,
    mark_ground,
    rows_of,
)
from plane_detector.ground.obstacles import (
    find_fronts,
    height_errors,
    mark_obstacles,
    without_box,
)
from plane_detector.ground.ways import Ways, ways_over_ground
from plane_detector.planes.classification import (
    PlaneClass,
    are_certain,
    classify_planes,
    refine_gravity,
)
from plane_detector.segmentation.cells.labels import rename_labels
from plane_detector.types import (
    COARSE_DEG,
    OBSTACLE_DISTANCES_M,
    CameraIntrinsics,
    Gravity,
    GroundLack,
    GroundResult,
    Mounting,
    PlaneSegmentation,
)

# Tuned by benchmark ground on seeds below 9000, unless derived or given by contract; nothing
# changes there from .7 to 1.4 times a value unless stated.
# The own floor is at the known height of the camera within this share of it: the error of a
# mounting and of gravity, and what a ramp that begins before the robot rises to.
HEIGHT_TOLERANCE = 0.1
# Shares of the columns of an image that meet a level first. Rendered: before drops .85 to 1,
# tables up to .65, the floor beside them at least .1. Flat from .7 on, and from .01 to .1.
# Heads of stairs that a rolled camera sees at a side: .55 to .74.
MAJORITY, HALF, FEW_COLUMNS = 0.75, 0.5, 0.05
# chosen: a robot stands farther than this from a straight edge before it, which is at most so much
# off straight across its view. It is sought in so many directions, in spite of so large a share of
# strays on the wrong side.
ROBOT_M, MOST_SKEW_DEG, DIRECTIONS, EDGE_STRAYS = 0.5, 45.0, 19, 0.02
# Pieces of one floor, as a network bends it, are at the same height of the camera within this
# share; tables and seats, 1 to 1.8 m below a camera, are higher by at least .25 of it. Flat from
# .05 to .22.
ONE_FLOOR = 0.2
# Slopes within the accuracy of an IMU or of a level plane count as level.
LEVEL_DEG = 3.0
# chosen: steeper by the error of gravity and of the plane, a slope is still within max_slope.
SLOPE_MARGIN_DEG = 1.0
# chosen: the floor that is nearest to the robot is in so many parts of the image the one where
# it looks down most steeply.
NEAR_SHARE = 8
# Borders are sampled at every fourth pixel; fewer samples that join are chance.
MIN_JOINS = 3
# Of every eighth pixel: so many give the heights of a plane, of which this share may be off.
MIN_SAMPLES, STRAY_SHARE = 10, 0.05
# By contract: a level within this height of the own floor, reached by risers, is a step.
STEP_RANGE_M = 0.5
# An error counts as a difference beyond this many standard deviations. With 2, less of a far
# level behind a ramp is ground, with 4 half as much again of the obstacles.
SIGMAS = 3.0
# Drops are reported only if an error of depth does not look like one at this distance, metres.
TOLD_AT_M, LARGEST_ERROR_M = 2.0, 0.3
# Sources of gravity that state how the camera is mounted. chosen: a height is measured with a tape
# within so much, and so large a share.
STATED_BY = ('parameter', 'tf', 'measured')
TAPE_M, TAPE_SHARE = 0.01, 0.02
# chosen: ways may be half a degree off, and are kept while the camera turns by less.
WAY_STEP = 0.01
# A row of points along an edge is at least this long.
MIN_EDGE_M = 0.12
# chosen: the floor is seen if at least this share of the pixels shows it.
SEEN_SHARE = 0.003
# A sensor reaches the depth, or the distance, that so small a share of an image exceeds. Ends of
# the ground may be due to its range if at least this share of them is there: an edge is so only if
# it is straight across the view.
BEYOND_REACH_SHARE, AT_RANGE_SHARE = 0.002, 0.5
# chosen: the few others of one end are torn off it by noise.
ALL_SHARE = 0.9
# chosen: the least number of expected torn ends, and the share of them below which it is an edge.
# Rendered at 1.2 to 1.6 m with time-of-flight noise: none at edges, 1.2 to 6 times those expected
# at limits.
MIN_TORN, TORN_RATIO = 10, 0.25
# derived: some hundred values whose noise is a step of their quantisation take seven; if it is
# less, most of them differ by the steps, which tear nothing.
MIN_VALUES = 8
# chosen: of every eighth pixel, two lines; a smaller image shows no way over the ground.
LEAST_PX = 16


@dataclass(frozen=True)
class Ground:
    """The ground of one image."""

    classes: np.ndarray  # (K,) uint8, values of `PlaneClass`
    # the ground of the image and the drops, in the optical frame
    result: GroundResult | SeenGround
    reach: SensorReach  # with what this image shows of it
    fronts: np.ndarray | None = None  # (H, W) bool, constants in depth that are obstacles
    constant_note: str = ''  # what constants in depth may be


@dataclass(frozen=True)
class SensorReach:
    """
    How far a sensor has seen in the images of a stream so far.

    Examples
    --------
    >>> camera = CameraIntrinsics.from_field_of_view(160, 120, 60.0)
    >>> depth_m = np.full((120, 160), 2.0, np.float32)
    >>> depth_m[:40] = 4.0
    >>> reach = SensorReach().extended(depth_m, camera)
    >>> reach.depth_m, reach.extended(depth_m / 2, camera) is reach
    (4.0, True)

    """

    # Most pixels beyond it were never more than a few; 0: nothing was seen.
    depth_m: float = 0.0  # along the optical axis
    distance_m: float = 0.0
    # Of the images, and the depth beyond which theirs is invalid: with others nothing is known.
    intrinsics: CameraIntrinsics | None = None
    max_depth_m: float = np.inf

    def extended(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                 max_depth_m: float = np.inf) -> SensorReach:
        """Return what is known after another image (H, W)."""
        if (intrinsics, max_depth_m) != (self.intrinsics, self.max_depth_m):
            return SensorReach(0.0, 0.0, intrinsics, max_depth_m).extended(
                depth_m, intrinsics, max_depth_m)
        z = depth_m[::8, ::8]
        distance, most = z * _stretches(intrinsics), int(BEYOND_REACH_SHARE * z.size)
        reached = [_reached(values, before, most) for values, before in (
            (z, self.depth_m), (distance, self.distance_m))]
        return self if max(reached) == 0 else replace(
            self, depth_m=max(self.depth_m, reached[0]),
            distance_m=max(self.distance_m, reached[1]))


NO_REACH = SensorReach()
Seen = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]
"""Depth and labels (H, W) of an image, slopes of the rays of its columns and rows."""


@lru_cache(maxsize=4)
def _stretches(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the distance of every eighth pixel along its ray at depth 1."""
    x, y = pixel_rays(intrinsics)
    return np.sqrt(np.add.outer(y[::8]**2, x[::8]**2) + 1)


def _reached(values: np.ndarray, before: float, most: int) -> float:
    """Return the value that at most ``most`` exceed; 0 if it is not above the one before."""
    beyond = values[(values > before) & (values < np.inf)]
    if len(beyond) <= most:
        return 0.0
    return float(order_statistics(beyond, len(beyond) - 1 - most)[1])


@dataclass(frozen=True)
class Surfaces:
    """Planes that one may stand on, as surfaces; the last one is level, at the camera's height."""

    normals: np.ndarray  # (K + 1, 3)
    offsets: np.ndarray  # (K + 1,)
    covariances: np.ndarray  # (K + 1, 4, 4)
    centroids: np.ndarray  # (K + 1, 3)
    # (K + 1,) float64: cosine of the angle between their upper side and the vertical, and this
    # angle; above 90 for what faces down
    uprights: np.ndarray
    slopes_deg: np.ndarray
    down: np.ndarray  # (3,) float64

    @classmethod
    def of(cls, found: PlaneSegmentation, down: np.ndarray, height_m: float) -> Surfaces:
        """Collect the planes of an image."""
        planes = found.planes
        normals = np.concatenate([planes.normals, -down[None]])
        uprights = -normals @ down
        return cls(normals, np.concatenate([planes.offsets_m, [height_m]]),
                   np.concatenate([planes.covariances, np.zeros((1, 4, 4))]),
                   np.concatenate([planes.centroids_m, height_m * down[None]]),
                   uprights, np.degrees(np.arccos(uprights.clip(-1, 1))), down)

    def heights(self) -> np.ndarray:
        """Return the height (K + 1,) of the camera over each plane, infinite over walls."""
        return self.offsets / np.maximum(self.uprights, 1e-9)

    def above(self, own: int) -> tuple[np.ndarray, np.ndarray]:
        """Return height and error (K + 1,) of each plane's centroid over one of them."""
        points = np.column_stack([self.centroids, np.ones(len(self.offsets))])
        heights = ((self.centroids @ self.normals[own] + self.offsets[own])
                   / max(self.uprights[own], 1e-9))
        variances = (np.einsum('ki,kij,kj->k', points, self.covariances, points)
                     + np.einsum('ki,ij,kj->k', points, self.covariances[own], points))
        return heights, np.sqrt(np.maximum(variances, 0.0))

    def table(self) -> np.ndarray:
        """Return the rows (K + 1, 5) of the compiled loops, see `along_ways`."""
        inverse = 1 / np.maximum(self.uprights, 1e-6)
        return np.column_stack([self.normals * inverse[:, None], self.offsets * inverse,
                                inverse]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SeenGround:
    """
    As :class:`~plane_detector.types.GroundResult`, found when its attributes are first read.

    They take most of the time of :func:`find_ground`, and only a few users read them.
    """

    depth_m: np.ndarray
    labels: np.ndarray
    ways: Ways
    rays: tuple[np.ndarray, np.ndarray]
    focal_px: float
    table: np.ndarray  # of `Surfaces`
    is_ground: np.ndarray  # (K + 1,) bool
    own: int  # -1 if no floor is seen
    down: np.ndarray  # (3,) float32
    limits: GroundConfig
    sigma: float  # standard deviation of 1/z
    reach: SensorReach
    max_range_m: float  # as stated; 0: not known
    doubt: str  # why drops are not searched for
    tilt_deg: float
    camera_height_m: float = np.nan
    mounting: Mounting | None = None
    lack, is_known = GroundLack.NOTHING, True

    @property
    def mask(self) -> np.ndarray:
        """Pixels (H, W) of the ground."""
        return self._marked[0]

    @property
    def heights_m(self) -> np.ndarray:
        """Height (H, W) float32 over the ground before each pixel; NaN unknown."""
        return self._marked[1]

    @cached_property
    def height_sigmas_m(self) -> np.ndarray:
        """Standard deviation (H, W) float32 of the heights; NaN unknown."""
        if self.own < 0:
            return self.heights_m
        return height_errors(self.depth_m, *self.rays, self.down, self.sigma)

    @property
    def smallest_obstacles_m(self) -> np.ndarray:
        """Height (3,) of the smallest obstacles that can be seen, by the noise of the image."""
        if self.own < 0:
            return np.zeros(0)
        height_m, down_z = self.table[self.own, 3], self.down[2]
        depths_m = np.array(OBSTACLE_DISTANCES_M) * np.sqrt(1 - down_z**2) + height_m * down_z
        # The error of a height is |down . ray| z^2 that of 1/z, and the ray meets the floor.
        return np.maximum(SIGMAS * self.sigma * height_m * depths_m, self.limits.min_height)

    @cached_property
    def obstacles(self) -> np.ndarray:
        """Pixels (H, W) that are not ground, without specks and flying pixels."""
        return mark_obstacles(self.depth_m, self.labels, self.mask, self.heights_m,
                              self.limits.min_height, self.focal_px, SIGMAS * self.sigma)

    @cached_property
    def _marked(self) -> tuple[np.ndarray, np.ndarray]:
        if self.own < 0:
            return (np.zeros(self.labels.shape, bool),
                    np.full(self.labels.shape, np.nan, np.float32))
        load_once('ground_pixels')
        return mark_ground(self.depth_m, self.labels, self.ways.lines, self.ways.count,
                           *self.rays, self.table, self.down, self.is_ground, self.own,
                           self.limits.min_height, np.tan(np.radians(self.limits.max_slope)),
                           SIGMAS * self.sigma)

    @property
    def drops_m(self) -> np.ndarray:
        """Points (N, 3) along the edges."""
        return self._drops[0][:, :3]

    @property
    def drop_depths_m(self) -> np.ndarray:
        """By how much it is down there, (N,)."""
        return self._drops[0][:, 3]

    @property
    def edge_note(self) -> str:
        """Why an edge cannot be distinguished from the end of the range of the sensor."""
        return self._drops[1]

    @property
    def drop_note(self) -> str:
        """Why there are no drops; empty if they are searched for."""
        return self.doubt or ('' if len(self.drops_m) else self.edge_note)

    @cached_property
    def _drops(self) -> tuple[np.ndarray, str]:
        if self.doubt:
            return np.zeros((0, 5)), ''
        ends = mark_drops(self.depth_m, self.labels, self.mask, self.ways.lines, self.ways.count,
                          *self.rays, self.table, self.down, self.is_ground, self.own,
                          self.limits.min_drop, SIGMAS * self.sigma)
        ends = ends[ends[:, 4] >= 0]
        # Where the level behind a drop ends matters to no robot.
        is_open = np.isnan(ends[:, 3])
        ends = ends[~(is_open & np.isin(ends[:, 4], ends[~is_open, 4]))]
        at_limit = self._at_range_limit(ends)
        unknown = _rows(ends[at_limit])
        if self.max_range_m or not len(unknown):
            return _rows(ends[~at_limit]), ''
        points_m = unknown[:, :3]
        ahead_m = np.median(np.linalg.norm(np.cross(points_m, self.down), axis=1))
        return _rows(ends[~at_limit]), (
            f'the ground ends {ahead_m:.1f} m ahead with nothing behind, and the sensor has seen '
            'nothing farther away: an edge, or the end of its range, which depth.max_range states')

    def _at_range_limit(self, ends: np.ndarray) -> np.ndarray:
        """Return which ends (N,) are where the sensor's range ends: ground would be beyond it."""
        is_open = np.isnan(ends[:, 3])
        ends_z, ends_range = ends[:, 2], np.linalg.norm(ends[:, :3], axis=1)
        margin = 1 + SIGMAS * self.sigma * ends_z
        for reached_m, last, following in (
                (self.reach.depth_m, ends_z, ends[:, 5]),
                (self.reach.distance_m, ends_range, ends[:, 6])):
            # A pixel more: noise and quantisation may cut one that is within the range.
            at_limit = is_open & ((2 * following - last) * margin
                                  >= max(reached_m, self.max_range_m))
            if not at_limit.any() or at_limit.sum() < AT_RANGE_SHARE * is_open.sum():
                continue
            ways, last, following = ends[at_limit, 4], last[at_limit], following[at_limit]
            along = _slope(last, ways)
            if _is_constant(last, following, ways, along):
                if not _is_ragged(last - along * ways, following - along * ways,
                                  ends_z[at_limit], ends[at_limit, 7]):
                    break
                return is_open if at_limit.sum() > ALL_SHARE * is_open.sum() else at_limit
        return np.zeros_like(is_open)


def _slope(values: np.ndarray, ways: np.ndarray) -> float:
    """Return the change of values (N,) from way to way."""
    x = ways - ways.mean()
    return float(x @ values / max(x @ x, 1.0))


def _is_constant(last: np.ndarray, following: np.ndarray, ways: np.ndarray,
                 slope: float) -> bool:
    """
    Return whether ground ends at the same distance, that of a range, in all ways.

    An edge is nearer on one side, if it is not straight across the view. The distance is known
    within that of the pixels ``last`` and ``following`` the end.
    """
    x = ways - ways.mean()
    spread = np.std(last - last.mean() - slope * x) / np.sqrt(max(x @ x, 1.0))
    off = max(abs(slope) - SIGMAS * spread, 0.0) * np.ptp(x)
    return off <= np.median(following - last)


def _is_ragged(last: np.ndarray, following: np.ndarray, depth_m: np.ndarray,
               measured_m: np.ndarray) -> bool:
    """
    Return whether ground may end where its depth exceeds a limit.

    A limit cuts what is measured, so that the noise of the pixels decides which of them are seen:
    of the ways (N,) a share ends a pixel sooner or later than their limit. An edge ends all alike.
    ``depth_m`` and ``measured_m`` are the depth of the ground at the ends and that measured.
    """
    if len(np.unique(measured_m.round(5))) < MIN_VALUES:
        return True
    # Differences of neighbours: what of the noise is smooth moves the end without tearing it.
    sigma = np.median(abs(np.diff((measured_m / depth_m - 1) * last))) / (2**0.5 * 0.6745)
    if sigma == 0.0:
        return True
    # If the limit is midway between two pixels, fewest ends are torn.
    within = erf(np.median(following - last) / (8**0.5 * sigma))
    share = 1 - (0.5 + 0.5 * within)**2
    starts = np.sort(last)
    alike = (np.arange(len(last)) + 1 - np.searchsorted(np.sort(following), starts, 'right')).max()
    torn = share * len(last)
    return torn < MIN_TORN or len(last) - alike >= TORN_RATIO * torn


def find_ground(found: PlaneSegmentation, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                gravity: Gravity, config: Config, reach: SensorReach = NO_REACH, *,
                plane_count: int | None = None, is_metric: bool = True, doubt: str = '',
                constants_m: np.ndarray | None = None) -> Ground:
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
        Its ``ground``, ``scale.camera_height`` and ``depth.max_range``.
    reach : SensorReach
        Of the images of the stream before.
    plane_count : int, optional
        How many of them are planes: the rest are pieces of curved surfaces. Default: all.
    is_metric : bool
        Whether lengths are in metres. If not, the camera is taken to be 1 m above the floor for
        the classes, and there are neither ground nor drops, nor steps.
    doubt : str
        Why lengths mean nothing, which then is the note instead of drops.
    constants_m : (H, W) float32, optional
        Depth that repeats exactly and was removed, NaN elsewhere.

    Returns
    -------
    Ground

    """
    limits, labels = config.ground, np.ascontiguousarray(found.labels, np.int32)
    unknown = np.zeros(len(found.planes), np.uint8)
    if gravity.gravity_camera is None:
        return Ground(unknown, _nothing(labels, 'the direction of gravity is not known'), reach)
    if min(labels.shape) < LEAST_PX:
        return Ground(unknown, _nothing(labels, f'an image of {labels.shape[1]} x '
                                        f'{labels.shape[0]} pixels is too small for ground',
                                        GroundLack.DEPTH), reach)
    # 1. and 2. The direction down and the own floor.
    known_m = config.scale.camera_height if is_metric else 0.0
    depth_m, rays = np.ascontiguousarray(depth_m, np.float32), pixel_rays(intrinsics)
    if any(limits.ignore_box):
        box = np.array(limits.ignore_box, np.float32)
        if constants_m is not None:
            constants_m, _ = without_box(constants_m, labels, *rays, box)
        depth_m, labels = without_box(depth_m, labels, *rays, box)
    ways = _ways(intrinsics, *np.round(gravity.gravity_camera / WAY_STEP).tolist())
    seen = depth_m, labels, rays
    down, own = own_floor(found, seen, ways, gravity, limits.max_slope, known_m, plane_count)
    rough_m = 0.0
    if gravity.is_sure and is_metric and not known_m:
        rough_m = _rough_floor(depth_m, labels, rays, gravity.gravity_camera, limits.min_height)
        if rough_m:
            known_m, down, own = rough_m, gravity.gravity_camera, len(found.planes)
    if down is None:
        return Ground(unknown, _nothing(
            labels, 'the direction of gravity is known too coarsely'), reach)
    surfaces, down32 = Surfaces.of(found, down, known_m), down.astype(np.float32)
    tilt_deg = float(np.degrees(np.arcsin(np.clip(down[2], -1, 1))))
    pixels = SeenGround(depth_m, labels, ways, rays, intrinsics.fx, surfaces.table(),
                        np.zeros(len(found.planes) + 1, bool), -1, down32, limits,
                        float(found.disparity_noise), reach, config.depth.max_range,
                        'no floor is seen', tilt_deg)
    if valid_depth(depth_m[::8, ::8]).mean() < SEEN_SHARE:
        return Ground(classify_planes(found.planes, down), _nothing(
            labels, 'nothing is seen: hardly any pixel has a depth up to '
            f'{config.depth.max_depth:g} m', GroundLack.DEPTH, tilt_deg), reach)
    if is_metric:
        reach = reach.extended(depth_m, intrinsics, config.depth.max_depth)
        pixels = replace(pixels, reach=reach)
    if own is None:
        classes = classify_planes(found.planes, down)
        if not is_metric:
            return Ground(classes, _nothing(labels, pixels.doubt, GroundLack.UNIT, tilt_deg),
                          reach)
        return Ground(classes, *_with_fronts(pixels, constants_m))
    height_m = float(surfaces.heights()[own])
    unit_m = 1.0 if is_metric else height_m
    # 3. What joins it.
    walkable = surfaces.slopes_deg <= limits.max_slope + SLOPE_MARGIN_DEG
    joins, risers, steps = count_borders(
        labels, ways.lines, ways.count, *rays, pixels.table, down32, walkable,
        limits.max_step * unit_m, STEP_RANGE_M * unit_m)
    above, above_error = surfaces.above(own)
    flat = np.zeros(len(walkable), bool)
    if walkable[:-1].any():
        # Of a bent floor, the piece that the direction down was taken from is as inclined as any.
        is_exact = gravity.tolerance_deg <= LEVEL_DEG and gravity.source != 'image'
        for way_down in (down, gravity.gravity_camera)[:1 + is_exact]:
            flat |= _are_flat(depth_m, labels, rays, way_down, surfaces.centroids[own],
                              limits.min_height * unit_m, len(found.planes))
        flat &= walkable
    joined, at_level, lower = _ground_planes(surfaces, own, above, above_error, walkable, joins,
                                             flat, steps, limits.max_step * unit_m)
    if own == len(found.planes):  # no plane of it: its pieces are measured from its level
        pixels.table[joined & flat] = pixels.table[own]
    classes = _classes(found, surfaces, above, joined, at_level, risers,
                       STEP_RANGE_M if is_metric else 0.0, limits.max_slope + SLOPE_MARGIN_DEG,
                       own if is_metric else -1)
    if not is_metric:
        return Ground(classes, _nothing(labels, 'the unit of depth is not known',
                                        GroundLack.UNIT, tilt_deg), reach)
    # 4. and 5. Pixels and drops.
    error_m = SIGMAS * float(found.disparity_noise) * TOLD_AT_M * height_m
    if not doubt and error_m > LARGEST_ERROR_M:
        doubt = f'the floor {TOLD_AT_M:g} m away may be {error_m:.2f} m off'
    if not doubt and own == len(found.planes):
        doubt = _unseen(depth_m, labels, rays, surfaces, known_m, walkable)
    is_ground = joined | lower
    if plane_count is not None and plane_count < len(found.planes):
        # Pieces that are not ground are judged pixel by pixel, as whatever has no plane.
        names = np.arange(len(found.planes))
        names[plane_count:][~is_ground[plane_count:-1]] = -1
        pixels = replace(pixels, labels=rename_labels(labels, names))
    # Of a curved floor, no piece states how the camera is mounted over it.
    is_piece = plane_count is not None and plane_count <= own < len(found.planes)
    mounting = None if is_piece else _mounting(found, seen, ways, gravity, config, own)
    return Ground(classes, *_with_fronts(replace(
        pixels, is_ground=is_ground, own=own, doubt=doubt, camera_height_m=height_m,
        mounting=mounting), constants_m))


def _with_fronts(pixels: SeenGround, constants_m: np.ndarray | None
                 ) -> tuple[SeenGround, SensorReach, np.ndarray | None, str]:
    """Return pixels with the depth of constants that may be obstacles, and what Ground states."""
    if constants_m is None:
        return pixels, pixels.reach, None, ''
    fronts, note = find_fronts(
        constants_m, pixels.rays, pixels.table[pixels.is_ground],
        pixels.reach.depth_m, pixels.max_range_m, pixels.limits.min_height,
        SIGMAS * pixels.sigma)
    if fronts is not None:
        pixels = replace(pixels, depth_m=np.where(fronts, constants_m, pixels.depth_m))
    return pixels, pixels.reach, fronts, note


def _nothing(labels: np.ndarray, note: str, lack: GroundLack = GroundLack.GRAVITY,
             tilt_deg: float = np.nan) -> GroundResult:
    """Return that no pixel of an image is ground or obstacle, why, and what it lacks for that."""
    return GroundResult(lack, np.zeros(labels.shape, bool), np.zeros(labels.shape, bool),
                        drop_note=note, tilt_deg=tilt_deg)


@lru_cache(maxsize=4)
def _ways(intrinsics: CameraIntrinsics, *steps: float) -> Ways:
    """Return the ways of an image for a direction down in multiples of WAY_STEP."""
    down = np.array(steps)
    return ways_over_ground(intrinsics, down / np.linalg.norm(down))


def _mounting(found: PlaneSegmentation, seen: Seen, ways: Ways, gravity: Gravity,
              config: Config, own: int) -> Mounting | None:
    """Compare what is stated of the camera with the floor that is seen."""
    stated_m = config.scale.camera_height or np.nan
    is_stated = gravity.source in STATED_BY
    if own == len(found.planes) and stated_m > 0:  # not at the stated height: what is met first
        _, own = own_floor(found, seen, ways, gravity, config.ground.max_slope, 0.0)
    if own is None or own == len(found.planes) or not (stated_m > 0 or is_stated):
        return None
    plane, down = found.planes[own], gravity.gravity_camera
    variances = np.linalg.eigvalsh(plane.covariance[:3, :3])[-1], plane.covariance[3, 3]
    tilt_sigma, height_sigma_m = np.sqrt(np.maximum(variances, 0.0))
    bend_m = found.systematic_noise * plane.offset_m * plane.centroid_m[2]
    stated_tilt_deg, tilt_deg = np.degrees(np.arcsin(np.clip([down[2], -plane.normal[2]], -1, 1)))
    angle_deg = np.degrees(np.arccos(np.clip(-plane.normal @ down, -1, 1)))
    return Mounting(
        float(stated_m), plane.offset_m, float(SIGMAS * np.hypot(height_sigma_m, bend_m)
                                               + max(TAPE_M, TAPE_SHARE * plane.offset_m)),
        *(float(value) if is_stated else np.nan for value in (
            stated_tilt_deg, tilt_deg, angle_deg,
            gravity.tolerance_deg + np.degrees(SIGMAS * tilt_sigma))))


def _unseen(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
            surfaces: Surfaces, height_m: float, walkable: np.ndarray) -> str:
    """Return why the level so far below the camera (0: not known) is not seen; empty if it is."""
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


def _rough_floor(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
                 down: np.ndarray, min_height: float) -> float:
    """Return the height of the camera over a floor before the robot that is no plane, else 0."""
    x, y = rays[0][::8], rays[1][::8, None]
    sight = down[0] * x + (down[1] * y + down[2])
    steepness = sight / np.sqrt(x * x + (y * y + 1))
    rank = sight.size - max(sight.size // NEAR_SHARE, 1)
    is_near = steepness >= order_statistics(steepness.ravel(), rank)[1]
    below_m = (depth_m[::8, ::8] * sight)[is_near]
    is_rough = np.isfinite(below_m) & (labels[::8, ::8][is_near] < 0)
    # Something alone in an empty image is no floor.
    found = np.count_nonzero(is_rough)
    if 2 * found <= np.count_nonzero(np.isfinite(below_m)) or 4 * found < len(below_m):
        return 0.0
    low, middle, high = np.percentile(below_m[is_rough], [10, 50, 90])
    return float(middle) if high - low <= min_height and middle > min_height else 0.0


def own_floor(found: PlaneSegmentation, seen: Seen, ways: Ways, gravity: Gravity,
              max_slope_deg: float, known_height_m: float, plane_count: int | None = None
              ) -> tuple[np.ndarray | None, int | None]:
    """
    Return the direction down (3,), and the index of the own floor.

    The direction is None if it is too coarse and no floor makes it exact; the own floor is None if
    none is seen and the height of the camera is not known, and the number of planes if it is known
    but the floor is not seen.
    """
    planes, down = found.planes, gravity.gravity_camera
    # Lines in the image may be along a ramp; their own scatter does not show it.
    tolerance_deg = max(gravity.tolerance_deg, COARSE_DEG if gravity.source == 'image' else 0.0)
    is_coarse = tolerance_deg > COARSE_DEG
    # Walls part the floor from a ramp only if they do not stand along it: a help, no reference.
    refined = refine_gravity(planes[:plane_count], down, tolerance_deg) if is_coarse else None
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
    own = _nearest_floor(first_met(seen[1], ways.lines, ways.count, possible), surfaces, seen,
                         ways.count, known_height_m > 0, SIGMAS * float(found.disparity_noise))
    if own is None:
        return (None if is_coarse and refined is None else down,
                len(planes) if known_height_m > 0 else None)
    # A piece of a curved surface is level by chance.
    is_plane = plane_count is None or own < plane_count
    if is_coarse or is_plane and surfaces.slopes_deg[own] <= tolerance_deg:
        down = -planes[own].normal
    return down, own


def _nearest_floor(votes: np.ndarray, surfaces: Surfaces, seen: Seen, ways: int,
                   is_known: bool, error: float) -> int | None:
    """
    Return which plane reaches nearest to the robot, by the columns that meet each first.

    At the head of stairs most columns meet the own floor first. A table is met by some, others
    meet the floor beside it: without a majority, the level that half of them meet is the own floor
    if it ends at an edge as stairs do, otherwise the lowest of several columns is. ``error`` is
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

    Where the camera looks through it, it is not. One line across the view parts the head of stairs
    and the robot from that; beside a table the floor is seen to the left or right of it.
    """
    (depth_m, labels, (ray_x, ray_y)), down = seen, surfaces.down
    x, y = np.meshgrid(ray_x[::8], ray_y[::8])
    rays, z = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3), depth_m[::8, ::8].ravel()
    sight = rays @ surfaces.normals[k]
    is_down = sight < 0
    inverse_z = sight / -surfaces.offsets[k]  # of the plane, by the pixel
    is_on = is_down & (labels[::8, ::8].ravel() == k)
    is_through = is_down & (z * (inverse_z - error) > 1.0 + ONE_FLOOR)
    across = np.linalg.svd(down[None])[2][1:]  # two level axes
    plan = rays @ across.T / np.maximum(inverse_z, 1e-9)[:, None]
    if not (is_on.any() and is_through.any()):
        return False
    ahead = across[:, 2]  # the optical axis
    angles = np.arctan2(ahead[1], ahead[0]) + np.radians(np.linspace(
        -MOST_SKEW_DEG, MOST_SKEW_DEG, DIRECTIONS))
    away = np.stack([np.cos(angles), np.sin(angles)])
    ends_m = np.quantile(plan[is_on] @ away, 1 - EDGE_STRAYS, axis=0)
    begins_m = np.quantile(plan[is_through] @ away, EDGE_STRAYS, axis=0)
    return bool((np.maximum(ends_m, ROBOT_M) <= begins_m).any())


def _ground_planes(surfaces: Surfaces, own: int, above: np.ndarray, error: np.ndarray,
                   walkable: np.ndarray, joins: np.ndarray, flat: np.ndarray,
                   steps: np.ndarray, max_step: float
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the planes (K + 1,) that join the own floor, those at its level, and lower ones.

    Those that are ``flat`` are nowhere off its level by as much as an obstacle: pieces of it as a
    sensor bends it, unless steps lead to them.
    """
    is_level = abs(surfaces.slopes_deg - surfaces.slopes_deg[own]) <= LEVEL_DEG
    # The error of a plane makes no step of what is level, nor hides a step of half as much again.
    at_level = walkable & is_level & (
        abs(above) <= max_step + np.minimum(SIGMAS * error, 0.5 * max_step))
    at_level[own] = True
    joined, linked = at_level.copy(), joins >= MIN_JOINS
    while True:
        more = joined | (walkable & linked[joined].any(axis=0))
        more |= flat & ~(steps[joined] >= MIN_JOINS).any(axis=0)
        if (more == joined).all():
            return joined, at_level | joined & flat, walkable & ~joined & (above < -max_step)
        joined = more


def _are_flat(depth_m: np.ndarray, labels: np.ndarray, rays: tuple[np.ndarray, np.ndarray],
              down: np.ndarray, point_m: np.ndarray, most_m: float, count: int) -> np.ndarray:
    """Return which planes (K + 1,) are within some height of the level of a point."""
    pixels, off = count_off_level(depth_m, labels, *rays, down.astype(np.float32),
                                  point_m @ down, most_m, count + 1)
    return (pixels >= MIN_SAMPLES) & (off <= STRAY_SHARE * pixels)


def _classes(found: PlaneSegmentation, surfaces: Surfaces, above: np.ndarray, joined: np.ndarray,
             at_level: np.ndarray, risers: np.ndarray, step_range_m: float,
             steepest_deg: float, own: int) -> np.ndarray:
    """Return the class of each plane (K,)."""
    classes = np.append(classify_planes(found.planes, surfaces.down), np.uint8(PlaneClass.FLOOR))
    is_sure_slope = np.append(are_certain(found.planes, surfaces.down, steepest_deg), True)
    is_level = surfaces.slopes_deg <= LEVEL_DEG
    # Steps are reached from the ground, or from other steps; without metres there are none.
    is_step, linked = joined.copy(), risers >= MIN_JOINS
    near = is_level & (abs(above) <= step_range_m)
    while (more := is_step | (near & linked[is_step].any(axis=0))).sum() > is_step.sum():
        is_step = more
    # A level plane is OTHER only if that is not certain.
    classes[is_step & ~joined & (classes != PlaneClass.OTHER)] = PlaneClass.STEP
    classes[joined & ~at_level & ~is_level & is_sure_slope] = PlaneClass.RAMP
    # What the robot stands on is ground, however uncertain its orientation; so it is floor, unless
    # the image shows that it is more likely no level surface.
    known = np.append(found.planes.class_certainties, np.nan)[own]
    is_sure_slope[own] |= not known < 0.5
    classes[at_level & is_sure_slope] = PlaneClass.FLOOR
    return classes[:-1]


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
