# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Borders of planes snap to the edges of the picture.

A network sees the picture at a size of its own, and its depth is blurred by a few of those pixels:
where one surface ends the picture knows better. The planes' insides are the markers of a watershed
(Meyer 1992) in the colours, which decides for what lies between them. Measured depth needs no such
help: on it borders got worse.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

# At half the size edges are exact enough, and a quarter of the work.
SCALE = 2
# Grain of the picture is no edge.
SMOOTHING_PX = 1.0


@dataclass(frozen=True)
class GuideImage:
    """
    A colour image whose edges are sharper than those of the depth.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    reach_px : float
        How far the edges of the depth may be off.

    """

    rgb: np.ndarray
    reach_px: float


def snap_to_image_edges(labels: np.ndarray, guide: GuideImage) -> np.ndarray:
    """
    Move the borders of planes to the nearest edges of the image.

    Parameters
    ----------
    labels : (H, W) int32
        -1 none, which has borders too.
    guide : GuideImage
        Pixels farther than its reach from a border keep their label.

    Returns
    -------
    (H, W) int32
        No label is lost: one that is nowhere wider than the reach stays as it is.

    """
    reach = round(guide.reach_px / SCALE)
    small = np.ascontiguousarray(labels[::SCALE, ::SCALE])
    if reach < 1 or min(small.shape) < 3:
        return labels
    # Watershed wants 1, 2, ... for what is known and 0 for what is not.
    known = small + 2
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    counted = known.astype(np.uint16)
    band = cv2.dilate(counted, square) != cv2.erode(counted, square)
    narrow = ~np.isin(small, np.unique(small[~band]))
    markers = np.where(band & ~narrow, 0, known).astype(np.int32)
    picture = cv2.resize(guide.rgb, small.shape[::-1], interpolation=cv2.INTER_AREA)
    cv2.watershed(cv2.GaussianBlur(picture, (0, 0), SMOOTHING_PX), markers)
    # It leaves lines of -1 between the basins: these take the label of a neighbour.
    filled = cv2.dilate(np.maximum(markers, 0).astype(np.uint16), np.ones((3, 3), np.uint8))
    snapped = np.where(markers > 0, markers, filled).astype(np.int32) - 2
    moved = band & ~narrow & (snapped >= -1)
    height, width = labels.shape
    moved, snapped = (image.repeat(SCALE, axis=0).repeat(SCALE, axis=1)[:height, :width]
                      for image in (moved, snapped))
    return np.where(moved, snapped, labels)
