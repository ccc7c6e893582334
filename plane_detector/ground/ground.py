# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From planes and gravity to ground, obstacles and drops; steps: see the folder's docstring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from plane_detector.config import Config
from plane_detector.geometry.disparity import valid_depth
from plane_detector.geometry.projection import pixel_rays
from plane_detector.ground.along_ways import count_borders
from plane_detector.ground.obstacles import find_fronts, without_box
from plane_detector.ground.own_floor import SEEN_SHARE, own_floor, rough_floor, why_unseen
from plane_detector.ground.seen_ground import SeenGround
from plane_detector.ground.sensor_reach import NO_REACH, SensorReach
from plane_detector.ground.surfaces import (
    LEVEL_DEG,
    SIGMAS,
    SLOPE_MARGIN_DEG,
    Seen,
    Surfaces,
    are_flat,
    classes_of,
    ground_planes,
)
from plane_detector.ground.ways import Ways, ways_over_ground
from plane_detector.planes.classification import classify_planes
from plane_detector.planes.history import NO_HISTORY, PlaneHistory
from plane_detector.segmentation.cells.model import rename_labels
from plane_detector.types import (
    CameraIntrinsics,
    Gravity,
    GroundLack,
    GroundResult,
    Mounting,
    PlaneSegmentation,
)

# By contract: a level within this height of the own floor, reached by risers, is a step.
STEP_RANGE_M = 0.5
# Drops are reported only if a depth error does not look like one at this distance, metres.
TOLD_AT_M, LARGEST_ERROR_M = 2.0, 0.3
# Sources of gravity that state how the camera is mounted. chosen: tolerance of a height measured
# with a tape, and the share of it.
STATED_BY = ('parameter', 'tf', 'measured')
TAPE_M, TAPE_SHARE = 0.01, 0.02
# chosen: ways may be half a degree off, and are kept while the camera rotates by less.
WAY_STEP = 0.01
# chosen: of every eighth pixel, two lines; a smaller image has no way over the ground.
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
    past: PlaneHistory = NO_HISTORY  # of the planes, with their inclinations in this image


def find_ground(found: PlaneSegmentation, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                gravity: Gravity, config: Config, reach: SensorReach = NO_REACH, *,
                plane_count: int | None = None, is_metric: bool = True, doubt: str = '',
                constants_m: np.ndarray | None = None,
                past: PlaneHistory = NO_HISTORY) -> Ground:
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
        Whether lengths are in metres. If not, the camera is assumed to be 1 m above the floor for
        the classes, and there are no ground, drops or steps.
    doubt : str
        Why lengths mean nothing, which then is the note instead of drops.
    constants_m : (H, W) float32, optional
        Depth that repeats exactly and was removed, NaN elsewhere.
    past : PlaneHistory, optional
        Of the planes in the images of the stream before; by default they are new.

    Returns
    -------
    Ground

    """
    limits, labels = config.ground, np.ascontiguousarray(found.labels, np.int32)
    unknown = np.zeros(len(found.planes), np.uint8)
    if gravity.gravity_camera is None:
        return Ground(unknown, _nothing(labels, 'the direction of gravity is not known'), reach,
                      past=past)
    if min(labels.shape) < LEAST_PX:
        return Ground(unknown, _nothing(labels, f'an image of {labels.shape[1]} x '
                                        f'{labels.shape[0]} pixels is too small for ground',
                                        GroundLack.DEPTH), reach, past=past)
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
        rough_m = rough_floor(depth_m, labels, rays, gravity.gravity_camera, limits.min_height)
        if rough_m:
            known_m, down, own = rough_m, gravity.gravity_camera, len(found.planes)
    if down is None:
        return Ground(unknown, _nothing(
            labels, 'the direction of gravity is known too coarsely'), reach, past=past)
    surfaces, down32 = Surfaces.of(found, down, known_m), down.astype(np.float32)
    past = past.inclined(found.planes, down)
    tilt_deg = float(np.degrees(np.arcsin(np.clip(down[2], -1, 1))))
    pixels = SeenGround(depth_m, labels, ways, rays, intrinsics.fx, surfaces.table(),
                        np.zeros(len(found.planes) + 1, bool), -1, down32, limits,
                        float(found.disparity_noise), reach, config.depth.max_range,
                        'no floor is seen', tilt_deg)
    depths_m = depth_m[::8, ::8]
    if np.count_nonzero(valid_depth(depths_m)) < SEEN_SHARE * depths_m.size:
        return Ground(classify_planes(found.planes, down, past), _nothing(
            labels, 'nothing is seen: hardly any pixel has a depth up to '
            f'{config.depth.max_depth:g} m', GroundLack.DEPTH, tilt_deg), reach, past=past)
    if is_metric:
        reach = reach.extended(depth_m, intrinsics, config.depth.max_depth)
        pixels = replace(pixels, reach=reach)
    if own is None:
        classes = classify_planes(found.planes, down, past)
        if not is_metric:
            return Ground(classes, _nothing(labels, pixels.doubt, GroundLack.UNIT, tilt_deg),
                          reach, past=past)
        return Ground(classes, *_with_fronts(pixels, constants_m), past=past)
    height_m = float(surfaces.heights()[own])
    unit_m = 1.0 if is_metric else height_m
    # 3. What joins it.
    walkable = surfaces.slopes_deg <= limits.max_slope + SLOPE_MARGIN_DEG
    joins, risers, steps = count_borders(
        labels, ways.for_loops, rays, pixels.table, down32, walkable,
        (limits.max_step * unit_m, STEP_RANGE_M * unit_m))
    above, above_error = surfaces.above(own)
    flat = np.zeros(len(walkable), bool)
    if walkable[:-1].any():
        # In a bent floor, the piece that gave the direction down is as inclined as any other.
        is_exact = gravity.tolerance_deg <= LEVEL_DEG and gravity.source != 'image'
        for way_down in (down, gravity.gravity_camera)[:1 + is_exact]:
            flat |= are_flat(seen, way_down, surfaces.centroids[own],
                             limits.min_height * unit_m, len(found.planes))
        flat &= walkable
    joined, at_level, lower = ground_planes(surfaces, own, above, above_error, walkable, joins,
                                            flat, steps, limits.max_step * unit_m)
    if own == len(found.planes):  # without its plane: its pieces are measured from its level
        pixels.table[joined & flat] = pixels.table[own]
    classes = classes_of(found, surfaces, above, joined, at_level, risers,
                         STEP_RANGE_M if is_metric else 0.0, limits.max_slope + SLOPE_MARGIN_DEG,
                         own if is_metric else -1, past)
    if not is_metric:
        return Ground(classes, _nothing(labels, 'the unit of depth is not known',
                                        GroundLack.UNIT, tilt_deg), reach, past=past)
    # 4. and 5. Pixels and drops.
    error_m = SIGMAS * float(found.disparity_noise) * TOLD_AT_M * height_m
    if not doubt and error_m > LARGEST_ERROR_M:
        doubt = f'the floor {TOLD_AT_M:g} m away may be {error_m:.2f} m off'
    if not doubt and own == len(found.planes):
        doubt = why_unseen(depth_m, labels, rays, surfaces, known_m, walkable)
    is_ground = joined | lower
    if plane_count is not None and plane_count < len(found.planes):
        # Pieces that are not ground are classified pixel by pixel, like pixels without a plane.
        names = np.arange(len(found.planes))
        names[plane_count:][~is_ground[plane_count:-1]] = -1
        pixels = replace(pixels, labels=rename_labels(labels, names))
    # Of a curved floor, no piece states how the camera is mounted over it.
    is_piece = plane_count is not None and plane_count <= own < len(found.planes)
    mounting = None if is_piece else _mounting(found, seen, ways, gravity, config, own)
    return Ground(classes, *_with_fronts(replace(
        pixels, is_ground=is_ground, own=own, doubt=doubt, camera_height_m=height_m,
        mounting=mounting), constants_m), past=past)


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
    """Compare the stated mounting of the camera with the visible floor."""
    stated_m = config.scale.camera_height or np.nan
    is_stated = gravity.source in STATED_BY
    if own == len(found.planes) and stated_m > 0:  # not at the stated height: the first surface
        _, own = own_floor(found, seen, ways, gravity, config.ground.max_slope, 0.0)
    if own is None or own == len(found.planes) or not (stated_m > 0 or is_stated):
        return None
    planes, down = found.planes, gravity.gravity_camera
    normal, offset_m = planes.normals[own], float(planes.offsets_m[own])
    variances = np.linalg.eigvalsh(planes.covariances[own, :3, :3])[-1], planes.covariances[
        own, 3, 3]
    tilt_sigma, height_sigma_m = np.sqrt(np.maximum(variances, 0.0))
    bend_m = found.systematic_noise * offset_m * planes.centroids_m[own, 2]
    stated_tilt_deg, tilt_deg = np.degrees(np.arcsin(np.clip([down[2], -normal[2]], -1, 1)))
    angle_deg = np.degrees(np.arccos(np.clip(-normal @ down, -1, 1)))
    return Mounting(
        float(stated_m), offset_m, float(SIGMAS * np.hypot(height_sigma_m, bend_m)
                                         + max(TAPE_M, TAPE_SHARE * offset_m)),
        *(float(value) if is_stated else np.nan for value in (
            stated_tilt_deg, tilt_deg, angle_deg,
            gravity.tolerance_deg + np.degrees(SIGMAS * tilt_sigma))))
