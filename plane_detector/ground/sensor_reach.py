# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The range of a sensor, and whether ground ends there or at an edge."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import erf

import numpy as np

from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.robust import order_statistics
from plane_detector.ground.surfaces import SIGMAS
from plane_detector.types import CameraIntrinsics

# Tuned by benchmark ground on seeds below 9000, unless derived or given by contract; nothing
# changes there from .7 to 1.4 times a value unless stated. A sensor reaches the depth, or the
# distance, that only this share of an image exceeds. Ends of the ground may be due to its range if
# at least this share of them is there; an edge has that share only if it is straight across the
# view.
BEYOND_REACH_SHARE, AT_RANGE_SHARE = 0.002, 0.5
# chosen: the few others of one end are torn off by noise.
ALL_SHARE = 0.9
# chosen: the least number of expected torn ends, and the share of them below which it is an edge.
# Rendered at 1.2 to 1.6 m with time-of-flight noise: none at edges, 1.2 to 6 times those expected
# at limits.
MIN_TORN, TORN_RATIO = 10, 0.25
# derived: some hundred values with noise of one quantisation step take seven values; with less
# noise, most of them differ by whole steps, which tear nothing.
MIN_VALUES = 8


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

    # Never more than a few pixels were beyond it; 0: nothing was seen.
    depth_m: float = 0.0  # along the optical axis
    distance_m: float = 0.0
    # Of the images, and the depth beyond which theirs is invalid; with other values nothing is
    # known.
    intrinsics: CameraIntrinsics | None = None
    max_depth_m: float = np.inf

    def extended(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                 max_depth_m: float = np.inf) -> SensorReach:
        """Return the reach after another image (H, W)."""
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

    def is_at_limit(self, ends: np.ndarray, sigma: float, max_range_m: float) -> np.ndarray:
        """
        Return which ends (N,) are at the end of the sensor's range: ground would be beyond it.

        ``ends`` are those of `along_ways.mark_drops`, ``sigma`` is that of 1/z, ``max_range_m`` is
        the range as stated, or 0.
        """
        is_open = np.isnan(ends[:, 3])
        ends_z, ends_range = ends[:, 2], np.linalg.norm(ends[:, :3], axis=1)
        margin = 1 + SIGMAS * sigma * ends_z
        for reached_m, last, following in (
                (self.depth_m, ends_z, ends[:, 5]),
                (self.distance_m, ends_range, ends[:, 6])):
            # One more pixel: noise and quantisation may cut a pixel that is within the range.
            at_limit = is_open & ((2 * following - last) * margin >= max(reached_m, max_range_m))
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


NO_REACH = SensorReach()


@lru_cache(maxsize=4)
def _stretches(intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the distance of every eighth pixel along its ray at depth 1."""
    x, y = pixel_rays(intrinsics)
    return np.sqrt(np.add.outer(y[::8]**2, x[::8]**2) + 1)


def _reached(values: np.ndarray, before: float, most: int) -> float:
    """Return the value that at most ``most`` exceed; 0 if it is not above the previous one."""
    beyond = values[(values > before) & (values < np.inf)]
    if len(beyond) <= most:
        return 0.0
    return float(order_statistics(beyond, len(beyond) - 1 - most)[1])


def _slope(values: np.ndarray, ways: np.ndarray) -> float:
    """Return the change of values (N,) from way to way."""
    x = ways - ways.mean()
    return float(x @ values / max(x @ x, 1.0))


def _is_constant(last: np.ndarray, following: np.ndarray, ways: np.ndarray,
                 slope: float) -> bool:
    """
    Return whether ground ends at the same distance, as at a range limit, on all ways.

    An edge is nearer on one side if it is not straight across the view. The distance is known
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

    A limit cuts off measurements, so the noise of the pixels decides which of them are valid: a
    share of the ways (N,) ends a pixel before or after the limit. An edge ends all ways alike.
    ``depth_m`` and ``measured_m`` are the true and the measured depth of the ground at the ends.
    """
    if len(np.unique(measured_m.round(5))) < MIN_VALUES:
        return True
    # Differences of neighbours: smooth noise moves the end without tearing it.
    sigma = np.median(abs(np.diff((measured_m / depth_m - 1) * last))) / (2**0.5 * 0.6745)
    if sigma == 0.0:
        return True
    # If the limit is midway between two pixels, the fewest ends are torn.
    within = erf(np.median(following - last) / (8**0.5 * sigma))
    share = 1 - (0.5 + 0.5 * within)**2
    starts = np.sort(last)
    alike = (np.arange(len(last)) + 1 - np.searchsorted(np.sort(following), starts, 'right')).max()
    torn = share * len(last)
    return torn < MIN_TORN or len(last) - alike >= TORN_RATIO * torn
