# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Snap the borders of planes to the edges of the image.

A network sees the image at its own size, and its depth is blurred by a few of those pixels: the
image shows better where a surface ends. The interiors of the planes are the markers of a
watershed (Meyer 1992) on the colours, which labels the pixels between them. A pixel takes the new
label only if its depth does not contradict it: the image shows edges that are none of the depth,
too. On measured depth borders got worse, so it is not used there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.labels import at_borders
from plane_detector.segmentation.cells.noise import Noise

# Half the size is accurate enough at a quarter of the work.
# derived: a quarter of the pixels, borders good to two.
SCALE = 2
# Noise of the image must not act as an edge.
# tuned: 14 real frames through FastDepth: SC -0.002 and precision -0.003 without.
SMOOTHING_PX = 1.0
# Depth is on a plane up to this multiple of the mean deviation that the plane itself shows.
# tuned: 14 real frames through FastDepth, SC without snapping .408: .412 at 2 and 3; exact rooms
# with misleading images lose at most .001.
MOST_DEVIATIONS = 3.0
# Edges are blurred if of the pixels that the image would move to a plane they are not on, this
# share lies between two planes.
# tuned: rooms with misleading images, where a plane is up to 27 degrees off without it; not swept.
MIN_BLURRED_SHARE = 0.1
CONTRADICTED, BETWEEN = 1, 2


@dataclass(frozen=True)
class GuideImage:
    """
    A colour image whose edges are sharper than those of the depth.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    reach_px : float
        Largest error of the position of the depth's edges, pixels.

    """

    rgb: np.ndarray
    reach_px: float


def snap_to_image_edges(labels: np.ndarray, guide: GuideImage, disparity: np.ndarray,
                        planes: np.ndarray, noise: Noise) -> np.ndarray:
    """
    Move the borders of planes to the nearest edges of the image.

    Parameters
    ----------
    labels : (H, W) int32
        -1 for no plane; unlabelled areas have borders too.
    guide : GuideImage
        Pixels farther than its reach from a border keep their label.
    disparity : (H, W) float32
    planes : (K, 3) float64
        a, b, c of each label in the coordinates of the cells.
    noise : Noise
        Its floors, and what is stated for the source, bound the misfit of a plane below.

    Returns
    -------
    (H, W) int32
        No label is lost: a label that is nowhere wider than the reach stays unchanged.

    """
    reach = round(guide.reach_px / SCALE)
    small = np.ascontiguousarray(labels[::SCALE, ::SCALE])
    if reach < 1 or min(small.shape) < 3:
        return labels
    # Watershed markers are 1, 2, ...; 0 is unknown.
    known = small + 2
    band = at_borders(known, reach)
    is_wide = np.zeros(int(known.max()) + 1, bool)
    is_wide[known[~band]] = True
    narrow = ~is_wide[known]
    markers = np.where(band & ~narrow, 0, known).astype(np.int32)
    small_rgb = cv2.resize(guide.rgb, small.shape[::-1], interpolation=cv2.INTER_AREA)
    cv2.watershed(cv2.GaussianBlur(small_rgb, (0, 0), SMOOTHING_PX), markers)
    # Watershed leaves lines of -1 between the basins: they take the label of a neighbour.
    filled = cv2.dilate(np.maximum(markers, 0).astype(np.uint16), np.ones((3, 3), np.uint8))
    snapped = np.where(markers > 0, markers, filled).astype(np.int32) - 2
    snapped[~band | narrow | (snapped < -1)] = -2  # not moved
    moved = snapped.repeat(SCALE, axis=0).repeat(SCALE, axis=1)
    moved = moved[:labels.shape[0], :labels.shape[1]]
    moved = np.where(moved == -2, labels, moved)
    _undo_contradicted(moved, labels, disparity, planes, round(guide.reach_px),
                       (noise.depth_floor_m,
                        noise.disparity_floor + MOST_DEVIATIONS * noise.source_sigma))
    return moved


@kernel('void(int32[:, ::1], int32[:, ::1], float32[:, ::1], float64[:, ::1], int64, '
        'UniTuple(float64, 2))')
def _undo_contradicted(moved, labels, disparity, planes, reach, floors):
    """
    Restore the labels of moved pixels whose depth contradicts the new label.

    A plane is contradicted by depth that is not on it, and no plane by depth that is on the old
    one. Depth between a plane and another one within the reach, and on neither, contradicts none
    if the edges of this depth are blurred: if there are many such pixels.
    """
    height, width = labels.shape
    sums, pixels = np.zeros(len(planes)), np.ones(len(planes))
    for v in range(0, height, 2):
        for u in range(0, width, 2):
            k = labels[v, u]
            if k >= 0 and moved[v, u] == k:
                # Mean deviations: a few wrong pixels hardly count.
                sums[k] += abs(_off(planes[k], disparity, v, u))
                pixels[k] += 1
    most = MOST_DEVIATIONS * sums / pixels
    between, on_others, verdict = 0, 0, np.zeros((height, width), np.int8)
    for v in range(height):
        for u in range(width):
            old, new = labels[v, u], moved[v, u]
            if new == old:
                continue
            floor = floors[0] * disparity[v, u] ** 2 + floors[1]
            is_off_old = old < 0 or abs(_off(planes[old], disparity, v, u)) > most[old] + floor
            if new < 0:
                verdict[v, u] = CONTRADICTED if not is_off_old else 0
                continue
            off = _off(planes[new], disparity, v, u)
            if abs(off) <= most[new] + floor:
                continue
            verdict[v, u] = CONTRADICTED
            for down, right in ((0, 0), (0, reach), (0, -reach), (reach, 0), (-reach, 0)):
                row = min(max(v + down, 0), height - 1)
                other = labels[row, min(max(u + right, 0), width - 1)]
                if (is_off_old and other >= 0 and other != new
                        and _off(planes[other], disparity, v, u) * off < 0):
                    verdict[v, u] = BETWEEN
            between += verdict[v, u] == BETWEEN
            on_others += verdict[v, u] == CONTRADICTED
    is_blurred = between > MIN_BLURRED_SHARE * (between + on_others)
    for v in range(height):
        for u in range(width):
            if verdict[v, u] == CONTRADICTED or (verdict[v, u] == BETWEEN and not is_blurred):
                moved[v, u] = labels[v, u]


@kernel('float64(float64[::1], float32[:, ::1], int64, int64)')
def _off(plane, disparity, v, u):
    """Return the disparity of a pixel less that of a plane there."""
    height, width = disparity.shape
    return disparity[v, u] - (plane[0] * (u - (width - 1) / 2)
                              + plane[1] * (v - (height - 1) / 2)) / width - plane[2]
