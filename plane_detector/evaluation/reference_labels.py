# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Reference labels of flat surfaces in exact depth; independent of the detector's code.

Region growing after Poppinga, Vaskevicius, Birk and Pathak, "Fast plane detection and
polygonalization in noisy 3D range images" (IROS 2008), slower but more accurate: it works on
pixels, starts at the flattest place, and grows again after each fit until nothing changes.

A second tolerance distinguishes curved surfaces from planes. On a plane nearly all pixels within
four times the tolerance are within the tolerance; on a curved surface the region becomes larger.

A plane is affine in disparity, 1/z = a x/z + b y/z + c, and is represented as (a, b, c).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.geometry.disparity import valid_depth
from plane_detector.geometry.projection import check_depth, pixel_rays
from plane_detector.types import CameraIntrinsics

TOLERANCE_M = 0.0015
"""Largest depth error of a plane's pixels: three times that of rounding to 1 mm."""
LOOSE_TOLERANCE_M = 4 * TOLERANCE_M
"""The width of a strip along a cylinder grows with the root of the tolerance, here by two."""
FLAT_RATIO = 1.15
"""Largest growth by the loose tolerance for a plane; allows for bevelled edges."""
UNCLEAR_RATIO = 1.5
"""A region that grows by more is curved; regions in between are not judged."""
WINDOW_PX = 9
"""Side of the start windows: averages rounding errors, but fits into narrow faces."""
ROUGHEST_START_M = 0.0005
"""Largest root mean square error of a start window; rounding to 1 mm alone gives 0.0003."""
MERGE_M = 0.002
"""Two pieces are one plane if most pixels of the smaller fit the larger one's plane this well."""
MERGE_SHARE = 0.9
MIN_PIXELS = 300
"""Smaller regions are dropped; the metrics only count planes over 1500 pixels as missed."""
Pixel = tuple[int, int]
_MOST_REFITS = 12
_SETTLED_SHARE = 0.001  # of the region's pixels may change in the last round
_MIN_TO_FIT = WINDOW_PX**2 // 2


@dataclass(frozen=True)
class ExactLabels:
    """
    Flat surfaces of an image, largest first.

    Attributes
    ----------
    labels : (H, W) int32
        Index into ``planes``, -1 for none.
    planes : (K, 4) float64
        Unit normal pointing to the camera and offset, 0 or more, in metres: n.p + d = 0.
    unclear : (H, W) bool
        Unlabelled pixels that may be on a plane: surfaces that are flat only within the loose
        tolerance, such as the folds of a curtain, narrow faces with bevelled edges, and the ends
        of curved surfaces, which continue on one side only.

    """

    labels: np.ndarray
    planes: np.ndarray
    unclear: np.ndarray


@dataclass(frozen=True)
class _DepthRays:
    """Rays x/z and y/z, depth and its inverse, (H, W) float64; depth is 1 where not valid."""

    ray_x: np.ndarray
    ray_y: np.ndarray
    depth_m: np.ndarray
    disparity: np.ndarray
    valid: np.ndarray

    def error_m(self, plane: np.ndarray) -> np.ndarray:
        """Return the depth error of each pixel from a plane, to first order, (H, W)."""
        error = plane[0] * self.ray_x + plane[1] * self.ray_y
        error += plane[2]
        error -= self.disparity
        return np.abs(error, out=error) * self.depth_m**2

    def fit(self, region: np.ndarray) -> np.ndarray:
        """Return the plane (3,) with the smallest squared depth error over a region."""
        weight = self.depth_m[region]**2
        rays = weight * np.stack([self.ray_x[region], self.ray_y[region], np.ones(len(weight))])
        return np.linalg.lstsq(rays @ rays.T, rays @ (weight * self.disparity[region]),
                               rcond=None)[0]


def label_exact_planes(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                       min_pixels: int = MIN_PIXELS) -> ExactLabels:
    """
    Label the flat surfaces in depth without noise; takes one or two seconds.

    Coplanar surfaces have one label, even if something stands between them.

    Parameters
    ----------
    depth_m : (H, W) floating
        Exact except for rounding to millimetres; not finite or not positive is invalid.
    intrinsics : CameraIntrinsics
    min_pixels : int
        A piece with fewer pixels is not labelled.

    Returns
    -------
    ExactLabels

    Raises
    ------
    ValueError
        Depth and intrinsics do not fit together.

    """
    check_depth(depth_m, intrinsics)
    rays = _depth_rays(depth_m, intrinsics)
    pieces, unclear = _grow_all(rays, min_pixels)
    regions = sorted(_merged(rays, pieces), key=np.count_nonzero, reverse=True)
    labels = np.full(depth_m.shape, -1, np.int32)
    for k, region in enumerate(regions):
        labels[region] = k
    planes = np.array([rays.fit(region) for region in regions]).reshape(-1, 3)
    return ExactLabels(labels, _normal_and_offset(planes), unclear & (labels < 0))


def _depth_rays(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> _DepthRays:
    valid = valid_depth(depth_m)
    ray_x, ray_y = (ray.astype(float) for ray in pixel_rays(intrinsics))
    depth_m = np.where(valid, depth_m, 1.0).astype(float)
    return _DepthRays(np.broadcast_to(ray_x, depth_m.shape).copy(),
                    np.broadcast_to(ray_y[:, None], depth_m.shape).copy(),
                    depth_m, 1 / depth_m, valid)


def _grow_all(rays: _DepthRays, min_pixels: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the regions (H, W) that are planes, and the pixels of doubtful ones."""
    free = rays.valid.copy()
    regions, doubtful = [], []
    for start, plane in _candidates(rays, free, min_pixels):
        region, ratio, _ = _growth(rays, plane, start, free)
        if ratio <= FLAT_RATIO:
            regions.append(region)
            free &= ~region
        else:
            doubtful.append((start, plane))
    late, unclear = _second_look(rays, doubtful, free, min_pixels)
    return regions + late, unclear


def _candidates(rays: _DepthRays, free: np.ndarray, min_pixels: int
                ) -> Iterator[tuple[Pixel, np.ndarray]]:
    """Yield a pixel and the plane of each region, flattest first; free may change in between."""
    planes, rms_m = _windows(rays)
    while (start := _flattest(rms_m)) is not None:
        region, plane = _grown(rays, planes[start], start, free)
        rms_m[region] = np.inf
        rms_m[_window(start)] = np.inf
        if np.count_nonzero(region) >= min_pixels:
            yield start, plane


def _second_look(rays: _DepthRays, doubtful: Sequence[tuple[Pixel, np.ndarray]],
                 free: np.ndarray, min_pixels: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Judge doubtful regions again, as :func:`_grow_all`, after their neighbours are labelled."""
    free, unclear = free.copy(), np.zeros(free.shape, bool)
    regions = []
    for start, plane in doubtful:
        region, ratio, loose = _growth(rays, plane, start, free)
        if np.count_nonzero(region) < min_pixels:
            continue
        if ratio <= FLAT_RATIO:
            regions.append(region)
            free &= ~region
        elif ratio <= UNCLEAR_RATIO:
            unclear |= loose
    return regions, unclear


def _growth(rays: _DepthRays, plane: np.ndarray, start: Pixel, free: np.ndarray
            ) -> tuple[np.ndarray, float, np.ndarray]:
    """Return a region, its growth by the loose tolerance, and the larger region."""
    region, loose = (_around(rays, plane, tolerance_m, start, free)
                     for tolerance_m in (TOLERANCE_M, LOOSE_TOLERANCE_M))
    return region, np.count_nonzero(loose) / max(np.count_nonzero(region), 1), loose


def _windows(rays: _DepthRays) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit a plane to the window around each pixel, by least squares in disparity.

    Returns
    -------
    planes : (H, W, 3) float64
    rms_m : (H, W) float64
        Root mean square depth error; inf if pixels of the window are invalid.

    """
    x, y, disparity = rays.ray_x, rays.ray_y, rays.disparity
    mean = _mean(disparity)
    # In a full window x and y form a grid: their variances are known, and they are uncorrelated.
    variance_x, variance_y = (
        (WINDOW_PX**2 - 1) / 12 * step**2 for step in (x[0, 1] - x[0, 0], y[1, 0] - y[0, 0]))
    slope_x = (_mean(x * disparity) - x * mean) / variance_x
    slope_y = (_mean(y * disparity) - y * mean) / variance_y
    rest = (_mean(disparity**2) - mean**2
            - slope_x**2 * variance_x - slope_y**2 * variance_y)
    rms_m = np.sqrt(np.maximum(rest, 0)) * rays.depth_m**2
    whole = cv2.erode(rays.valid.astype(np.uint8), np.ones((WINDOW_PX, WINDOW_PX)),
                      borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return (np.stack([slope_x, slope_y, mean - slope_x * x - slope_y * y], axis=-1),
            np.where(whole, rms_m, np.inf))


def _mean(values: np.ndarray) -> np.ndarray:
    """Return the mean over the window around each pixel."""
    return cv2.blur(values, (WINDOW_PX, WINDOW_PX))


def _flattest(rms_m: np.ndarray) -> Pixel | None:
    """Return row and column of the flattest window; None if all remaining ones are rough."""
    row, column = divmod(int(rms_m.argmin()), rms_m.shape[1])
    return (row, column) if rms_m[row, column] <= ROUGHEST_START_M else None


def _window(pixel: Pixel) -> tuple[slice, slice]:
    """Return the centre of the window around a pixel, whose starts would give similar results."""
    row, column = (slice(max(0, k - WINDOW_PX // 4), k + WINDOW_PX // 4 + 1) for k in pixel)
    return row, column


def _grown(rays: _DepthRays, plane: np.ndarray, start: Pixel, free: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray]:
    """Grow the region around a pixel and fit its plane in turn; return both."""
    region = _around(rays, plane, TOLERANCE_M, start, free)
    for _ in range(_MOST_REFITS):
        if np.count_nonzero(region) < _MIN_TO_FIT:
            break
        plane, before = rays.fit(region), region
        region = _around(rays, plane, TOLERANCE_M, start, free)
        if np.count_nonzero(region != before) <= _SETTLED_SHARE * np.count_nonzero(region):
            break
    return region, plane


def _around(rays: _DepthRays, plane: np.ndarray, tolerance_m: float, start: Pixel,
            free: np.ndarray) -> np.ndarray:
    """Return the free pixels connected with one that are within a tolerance of a plane."""
    near = (rays.error_m(plane) <= tolerance_m) & free
    filled = near.astype(np.uint8)
    if near[start]:
        cv2.floodFill(filled, None, start[::-1], 2, flags=4)
    return filled == 2


def _merged(rays: _DepthRays, pieces: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the regions after merging coplanar ones, adjacent or not."""
    regions: list[np.ndarray] = []
    for piece in sorted(pieces, key=np.count_nonzero, reverse=True):
        for k, region in enumerate(regions):
            error_m = rays.error_m(rays.fit(region))[piece]
            if (error_m <= MERGE_M).mean() >= MERGE_SHARE:
                regions[k] = region | piece
                break
        else:
            regions.append(piece)
    return regions


def _normal_and_offset(planes: np.ndarray) -> np.ndarray:
    """Return planes (K, 3) in disparity, (a, b, c).p = 1, as normals and offsets (K, 4)."""
    length = np.linalg.norm(planes, axis=1, keepdims=True)
    return np.hstack([-planes, np.ones_like(length)]) / length
