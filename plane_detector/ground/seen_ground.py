# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground, obstacles and drops of an image, computed when they are first read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector._runtime.compilation import load_once
from plane_detector.config import GroundConfig
from plane_detector.ground.along_ways import DROP, WAY, mark_drops, mark_ground, rows_of
from plane_detector.ground.obstacles import height_errors, mark_obstacles
from plane_detector.ground.sensor_reach import SensorReach
from plane_detector.ground.surfaces import SIGMAS
from plane_detector.ground.ways import Ways
from plane_detector.types import OBSTACLE_DISTANCES_M, GroundLack, Mounting

# Minimum length of a row of points along an edge.
MIN_EDGE_M = 0.12


@dataclass(frozen=True, eq=False)
class SeenGround:
    """
    Like :class:`~plane_detector.types.GroundResult`, computed when its attributes are first read.

    They take most of the time of :func:`find_ground`, and only a few users read them.
    """

    depth_m: np.ndarray
    labels: np.ndarray
    ways: Ways
    rays: tuple[np.ndarray, np.ndarray]
    focal_px: float
    table: np.ndarray  # of `Surfaces`
    is_ground: np.ndarray  # (K + 1,) bool
    own: int  # -1 if no floor is visible
    down: np.ndarray  # (3,) float32
    limits: GroundConfig
    sigma: float  # standard deviation of 1/z
    reach: SensorReach
    max_range_m: float  # as stated; 0: unknown
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
        """Height (3,) of the smallest detectable obstacles, given the noise of the image."""
        if self.own < 0:
            return np.zeros(0)
        height_m, down_z = self.table[self.own, 3], self.down[2]
        depths_m = np.array(OBSTACLE_DISTANCES_M) * np.sqrt(1 - down_z**2) + height_m * down_z
        # The error of a height is |down . ray| z^2 times that of 1/z, and the ray meets the floor.
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
        limits = (self.limits.min_height, np.tan(np.radians(self.limits.max_slope)),
                  SIGMAS * self.sigma)
        return mark_ground((self.depth_m, self.labels, self.rays), self.ways.for_loops, self.table,
                           self.down, self.is_ground, self.own, limits)

    @property
    def drops_m(self) -> np.ndarray:
        """Points (N, 3) along the edges."""
        return self._drops[0][:, :3]

    @property
    def drop_depths_m(self) -> np.ndarray:
        """Depth of the drop at these points, (N,)."""
        return self._drops[0][:, DROP]

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
        ends = mark_drops((self.depth_m, self.labels, self.rays), self.mask, self.ways.for_loops,
                          self.table, self.down, self.is_ground, self.own,
                          (self.limits.min_drop, SIGMAS * self.sigma))
        ends = ends[ends[:, WAY] >= 0]
        if not len(ends):
            return ends, ''
        # It does not matter to a robot where the level behind a drop ends.
        is_open = np.isnan(ends[:, DROP])
        ends = ends[~(is_open & np.isin(ends[:, WAY], ends[~is_open, WAY]))]
        at_limit = self.reach.is_at_limit(ends, self.sigma, self.max_range_m)
        unknown = _rows(ends[at_limit])
        if self.max_range_m or not len(unknown):
            return _rows(ends[~at_limit]), ''
        points_m = unknown[:, :3]
        ahead_m = np.median(np.linalg.norm(np.cross(points_m, self.down), axis=1))
        return _rows(ends[~at_limit]), (
            f'the ground ends {ahead_m:.1f} m ahead with nothing behind, and the sensor has seen '
            'nothing farther away: an edge, or the end of its range, which depth.max_range states')


def _rows(drops: np.ndarray) -> np.ndarray:
    """Return the drops (N, 5) that are in sufficiently long rows."""
    drops = drops[np.argsort(drops[:, WAY], kind='stable')]
    rows = rows_of(drops)
    count = rows.max(initial=-1) + 1
    first, last = np.full(count, len(drops)), np.zeros(count, int)
    np.minimum.at(first, rows, np.arange(len(drops)))
    last[rows] = np.arange(len(drops))
    length = np.linalg.norm(drops[last[rows], :3] - drops[first[rows], :3], axis=1)
    return drops[length >= MIN_EDGE_M]
