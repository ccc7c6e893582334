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


def close_gaps(labels: np.ndarray, planes: np.ndarray, image: DisparityImage, grid: CellGrid,
               distance_m: float) -> np.ndarray:
    """
    Label the pixels of narrow gaps.

    Parameters
    ----------
    labels : (H, W) int32
        Index into ``planes``, -1 none.
    planes : (K, 3) float64
        1/z = a x + b y + c in 1/metres.
    image : DisparityImage
    grid : CellGrid
        Of this image; gaps are at most as wide as a cell.
    distance_m : float
        Largest distance of a pixel from the plane.

    Returns
    -------
    (H, W) int32

    """
    a, b, c = planes.T
    f_x, f_y, x, y = grid.lens
    # A point at 1/z is off the plane by the distance of the plane times its relative residual.
    per_disparity = distance_m * np.sqrt((a * f_x)**2 + (b * f_y)**2 + (a * x + b * y + c)**2)
    closed = labels.copy()
    in_pixels = np.column_stack([grid.planes_in_pixels(planes), per_disparity])
    _close(closed, in_pixels, image.values, image.valid, grid.size_px)
    _close(closed.T, in_pixels[:, [1, 0, 2, 3]].copy(), image.values.T, image.valid.T,
           grid.size_px)
    return closed


@kernel('void(int32[:, :], float64[:, ::1], float32[:, :], boolean[:, :], int64)')
def _close(labels, planes, disparity, valid, widest):
    """Close the gaps along the rows of an image."""
    height, width = labels.shape
    for v in range(height):
        last = -1  # the column of the last pixel with a label
        for u in range(width):
            label = labels[v, u]
            if label < 0:
                continue
            if 1 < u - last <= widest + 1 and last >= 0 and labels[v, last] == label:
                a, b, c, nearest = (planes[label, 0], planes[label, 1], planes[label, 2],
                                    planes[label, 3])
                for k in range(last + 1, u):
                    d = disparity[v, k]
                    if valid[v, k] and abs(a * k + b * v + c - d) <= nearest * d:
                        labels[v, k] = label
            last = u
