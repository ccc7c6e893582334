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

from plane_detector.compilation import kernel
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
        Of this image; gaps are at most as wide as a cell.
    distance_m : float
        Largest distance of a pixel from the plane.

    """
    _close(labels, np.flatnonzero(labels < 0), (planes, grid.planes_in_pixels(planes), grid.lens),
           image.values, image.valid, (grid.size_px, distance_m))


@kernel('void(int32[:, ::1], int64[::1], Tuple((float64[:, ::1], float64[:, ::1], float64[::1])), '
        'float32[:, ::1], boolean[:, ::1], Tuple((int64, float64)))')
def _close(labels, unlabelled, model, disparity, valid, limits):
    """Close the gaps among the unlabelled pixels, along rows and then along columns."""
    (height, width), (planes, in_pixels, lens), (widest, distance_m) = labels.shape, model, limits
    largest = np.empty(len(planes))
    for k in range(len(planes)):
        x, y, z = normal_of(planes[k, 0], planes[k, 1], planes[k, 2], lens)
        # A point at 1/z is off the plane by the distance of the plane times its relative residual.
        largest[k] = distance_m * np.sqrt(x * x + y * y + z * z)
    for down, right in ((0, 1), (1, 0)):
        v = 0
        for pixel in unlabelled:
            while pixel >= (v + 1) * width:
                v += 1
            u = pixel - v * width
            if v < down or u < right or labels[v, u] >= 0:
                continue
            label, length = labels[v - down, u - right], 1
            if label < 0:
                continue  # not the first of a gap
            for _ in range(widest):
                row, column = v + length * down, u + length * right
                if row >= height or column >= width or labels[row, column] >= 0:
                    break
                length += 1
            row, column = v + length * down, u + length * right
            if row >= height or column >= width or labels[row, column] != label:
                continue
            a, b, c = in_pixels[label, 0], in_pixels[label, 1], in_pixels[label, 2]
            for k in range(length):
                row, column = v + k * down, u + k * right
                d = disparity[row, column]
                off = abs(a * column + b * row + c - d)
                if valid[row, column] and off <= largest[label] * d:
                    labels[row, column] = label
