# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Close narrow gaps within planes.

Joints of tiles and seams of doors stand out of exact depth, or their pixels are outliers of a
sensor. Pixels without a label between two of the same plane belong to it if they are as near to
it as the settings allow a plane to be uneven.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import CellGrid, DisparityImage
from plane_detector.segmentation.cells.plane_fit import normal_of


def close_gaps(labels: np.ndarray, planes: np.ndarray, image: DisparityImage, grid: CellGrid,
               distance_m: float) -> None:
    """
    Label the pixels of narrow gaps.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``, -1 none; overwritten.
    planes : (K, 3) float64
        1/z = a x + b y + c in 1/metres.
    image : DisparityImage
    grid : CellGrid
        Of this image; gaps are wider than a cell by at most a pixel.
    distance_m : float
        Largest distance of a pixel from the plane.

    """
    _close(labels, np.flatnonzero(labels < 0), (planes, grid.planes_in_pixels(planes), grid.lens),
           image.values, image.valid, (grid.size_px + 1, distance_m))


@kernel('void(int32[:, ::1], int64[::1], Tuple((float64[:, ::1], float64[:, ::1], float64[::1])), '
        'float32[:, ::1], boolean[:, ::1], Tuple((int64, float64)))')
def _close(labels, unlabelled, model, disparity, valid, limits):
    """Close the gaps among the unlabelled pixels, along rows and then along columns."""
    (height, width), (planes, in_pixels, lens), (widest, distance_m) = labels.shape, model, limits
    largest, image = np.empty(len(planes)), (disparity, valid)
    for k in range(len(planes)):
        x, y, z = normal_of(planes[k, 0], planes[k, 1], planes[k, 2], lens)
        # A point at 1/z is off the plane by the distance of the plane times its relative residual.
        largest[k] = distance_m * np.sqrt(x * x + y * y + z * z)
    runs, count, end, v = np.empty((len(unlabelled), 3), np.int64), 0, 0, 0
    while end < len(unlabelled):
        pixel = unlabelled[end]
        while pixel >= (v + 1) * width:  # faster than a division
            v += 1
        left, end = pixel - v * width, end + 1
        right = left + 1
        while right < width and end < len(unlabelled) and unlabelled[end] == pixel + right - left:
            right, end = right + 1, end + 1
        runs[count, 0], runs[count, 1], runs[count, 2] = v, left, right
        count += 1
        if (left > 0 and right < width and right - left <= widest
                and labels[v, left - 1] == labels[v, right]):
            for u in range(left, right):
                _label_near(labels, v, u, labels[v, right], in_pixels, largest, image)
    for run in range(count):
        v = runs[run, 0]
        for u in range(runs[run, 1], runs[run, 2] if v + 1 < height else 0):
            if labels[v + 1, u] < 0 or labels[v, u] >= 0:
                continue
            above = v - 1
            while above >= 0 and v - above <= widest and labels[above, u] < 0:
                above -= 1
            if above >= 0 and v - above <= widest and labels[above, u] == labels[v + 1, u]:
                for row in range(above + 1, v + 1):
                    _label_near(labels, row, u, labels[above, u], in_pixels, largest, image)


@kernel('void(int32[:, ::1], int64, int64, int32, float64[:, ::1], float64[::1], '
        'Tuple((float32[:, ::1], boolean[:, ::1])))')
def _label_near(labels, v, u, label, in_pixels, largest, image):
    """Give a pixel a label if it is valid and near that plane."""
    d = image[0][v, u]
    off = abs(in_pixels[label, 0] * u + in_pixels[label, 1] * v + in_pixels[label, 2] - d)
    if image[1][v, u] and off <= largest[label] * d:
        labels[v, u] = label
