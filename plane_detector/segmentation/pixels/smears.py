# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Find smears: ramps between a surface and another one behind it, which are no planes.

Where depth has been resized, filtered or registered, an edge is a ramp of a few pixels. If it is
linear in 1/z it is an exact plane, but one that is seen nearly from the side over all its area,
and that begins at the depth of one surface and ends at that of the other. A wall seen so is wider,
or what is behind its end is farther.
"""

from __future__ import annotations

import math

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage

# Angle at which a surface is seen, at most, and width of the ramp.
# chosen: boxes smeared by 3 to 7 pixels to either side are seen at .5 to 3 degrees; the treads of
# stairs are seen at more unless they are a few pixels wide.
MAX_ANGLE_DEG, MAX_WIDTH_PX = 4.0, 20.0
# Surfaces at both ends differ from these by at most this share of the ramp.
# chosen: the ends of a ramp are ragged; behind the side of a box it is .5 and more.
MAX_END_SHARE = 0.25
# derived: the pixels behind the one next to an end.
BEHIND_PX = 2.0


def find_smears(labels: np.ndarray, planes: np.ndarray, image: DisparityImage,
                grid: CellGrid) -> np.ndarray:
    """
    Find the planes that are smears.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``, -1 none.
    planes : (K, 3) float64
        1/z = a x + b y + c in 1/metres.
    image : DisparityImage
    grid : CellGrid
        Of this image.

    Returns
    -------
    (n,) int64
        Index into the planes.

    """
    # 1/z of a surface seen at this angle changes by this share of it from pixel to pixel.
    steepest = 1 / (math.tan(math.radians(MAX_ANGLE_DEG)) * grid.lens[0] * grid.width_px)
    return np.flatnonzero(_are_smears(labels, grid.planes_in_pixels(planes), image.values,
                                      image.valid, steepest))


@kernel('boolean[::1](int32[:, ::1], float64[:, ::1], float32[:, ::1], boolean[:, ::1], float64)',
        is_short=True)
def _are_smears(labels, planes, disparity, valid, steepest):
    (height, width), count = labels.shape, len(planes)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    pixels, ramps = np.zeros(count, np.int64), np.zeros(count, np.int64)
    slope, across, found = np.empty(count), np.empty(count), np.zeros(count, np.bool_)
    for v in range(height):
        for u in range(width):
            k = labels[v, u]
            if k >= 0:
                d = planes[k, 0] * u + planes[k, 1] * v + planes[k, 2]
                low[k], high[k] = min(low[k], d), max(high[k], d)
    any_left = False
    for k in range(count):
        slope[k] = max(np.hypot(planes[k, 0], planes[k, 1]), 1e-12)
        across[k] = (high[k] - low[k]) / slope[k]
        found[k] = slope[k] > steepest * high[k] and 0 < across[k] <= MAX_WIDTH_PX
        any_left |= found[k]
    if not any_left:
        return found
    for v in range(height):
        for u in range(width):
            k = labels[v, u]
            if k < 0 or not found[k]:
                continue
            pixels[k] += 1
            reach, is_ramp = (across[k] + BEHIND_PX) / slope[k], True
            for side in range(2):
                step = reach if side == 0 else -reach
                y, x = int(round(v + step * planes[k, 1])), int(round(u + step * planes[k, 0]))
                end = high[k] if side == 0 else low[k]
                is_ramp &= (0 <= y < height and 0 <= x < width and valid[y, x]
                            and abs(disparity[y, x] - end) <= MAX_END_SHARE * (high[k] - low[k]))
            ramps[k] += is_ramp
    for k in range(count):
        found[k] &= 2 * ramps[k] > pixels[k]
    return found
