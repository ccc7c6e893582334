# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Snap the borders of planes to the edges of the image, where depth does not determine them.

A network processes the image at its own size, and its depth is blurred by a few of those pixels,
so the image shows more precisely where a surface ends. The interiors of the planes are the markers
of a watershed (Meyer 1992) on the colours, which labels the pixels between them. The image also
has edges that are not edges of depth, so the depth decides first which of these pixels are moved:

1. The blur is measured where the depth steps from plane to plane: it is the width within which it
   passes from a fifth to four fifths of the step.
2. If steps are sharp, a pixel is moved only if its depth cannot separate the two planes, as they
   differ there by less than the noise of a surface, or if it is on the new plane and not on the
   old one.
3. If steps are blurred, the depth near a border is not that of any surface: a pixel is moved
   unless its depth contradicts the new plane, and is not between it and another one.
4. If steps are blurred, patches of uniform colour are found too: unlabelled pixels take the most
   frequent plane of their patch once the planes are known (``planes/patches.py``).

Borders in measured depth got worse, so this stage is not used there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import median
from plane_detector.segmentation.cells.model import PATCH_SCALE
from plane_detector.segmentation.cells.noise import Noise

# Half the size is accurate enough at a quarter of the work.
# chosen: a quarter of the pixels, borders good to two.
SCALE = 2
# In a patch of uniform colour, neighbouring pixels differ by less than this in every channel.
# tuned: eight NYU frames, an office and two table tops labelled by hand, 21 other frames, all
# through FastDepth: flat from 7 to 10, the NYU frames from 5 to 14; from a half to a sixth of the
# size.
MAX_CONTRAST = 10
# Noise of the image must not act as an edge.
# tuned: 14 real frames through FastDepth: SC -0.002 and precision -0.003 without.
SMOOTHING_PX = 1.0
# Depth is on a plane up to this multiple of the mean deviation that the plane itself shows.
# tuned: 14 real frames through FastDepth, SC without snapping .408: .412 at 2 and 3; exact rooms
# with misleading images lose at most .001.
MOST_DEVIATIONS = 3.0
# Planes cannot be distinguished where they differ by less than this multiple of the smooth noise.
# tuned: 6 rooms from seed 300 with misleading pictures, noise of .002 and .008 per metre.
SAME_SIGMAS = 0.7
# Steps of which the blur is measured: smallest, in deviations of the pixel and of the smooth
# noise. derived: the noise of a pixel seldom reaches a fifth of such a step.
STEP_PIXEL_SIGMAS, STEP_SMOOTH_SIGMAS = 8.0, 2.0
# Edges are sharp up to this width. chosen: a pixel on the edge has a depth between both surfaces.
SHARP_PX = 1.0
NOT_MOVED = -2  # among the labels proposed for pixels


@dataclass(frozen=True)
class GuideImage:
    """A colour image whose edges are sharper than those of the depth."""

    rgb: np.ndarray  # (H, W, 3) uint8
    reach_px: float  # largest error of the position of the depth's edges, pixels

    @cached_property
    def small_rgb(self) -> np.ndarray:
        """The image reduced by SCALE."""
        size = (-(-side // SCALE) for side in self.rgb.shape[1::-1])
        return cv2.resize(self.rgb, tuple(size), interpolation=cv2.INTER_AREA)

    @property
    def is_usable(self) -> bool:
        """Whether borders may be moved: by a pixel of an image that is not tiny."""
        return round(self.reach_px / SCALE) >= 1 and min(self.small_rgb.shape[:2]) >= 3


def snap_to_image_edges(labels: np.ndarray, guide: GuideImage, disparity: np.ndarray,
                        planes: np.ndarray, noise: Noise, is_blurred: bool) -> np.ndarray:
    """
    Move the borders of planes to the nearest edges of the image.

    Parameters
    ----------
    labels : (H, W) int32
        -1 for no plane; unlabelled areas have borders too.
    guide : GuideImage
        Usable. Pixels farther than its reach from a border keep their label.
    disparity : (H, W) float32
    planes : (K, 3) float64
        a, b, c of d = a u + b v + c of each label, in columns and rows of the image.
    noise : Noise
        Its floors, and what is stated for the source, bound the misfit of a plane below.
    is_blurred : bool
        As by :func:`blurs_steps`.

    Returns
    -------
    (H, W) int32
        No label is lost: a label that is nowhere wider than the reach stays unchanged.

    """
    small = np.ascontiguousarray(labels[::SCALE, ::SCALE])
    square = np.ones((2 * round(guide.reach_px / SCALE) + 1,) * 2, np.uint8)
    is_near = cv2.dilate(small.astype(np.int16), square) != cv2.erode(
        small.astype(np.int16), square)
    markers = _markers(small, is_near, len(planes))
    basins = _watershed(cv2.GaussianBlur(guide.small_rgb, (0, 0), SMOOTHING_PX), markers.copy())
    proposed = np.where((markers == 0) & (basins > 0), basins - 2, NOT_MOVED)
    return _moved(labels, proposed, disparity, planes, round(guide.reach_px), is_blurred,
                  (noise.depth_floor_m,
                   noise.disparity_floor + MOST_DEVIATIONS * noise.source_sigma,
                   SAME_SIGMAS * noise.mean_sigma))


@kernel('int32[:, ::1](int32[:, ::1], boolean[:, ::1], int64)', subject='network')
def _markers(labels, band, count):
    """Return the markers of a watershed: label + 2, but 0 near borders of wide regions."""
    is_wide, markers = np.zeros(count + 1, np.bool_), labels + np.int32(2)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if not band[v, u]:
                is_wide[labels[v, u] + 1] = True
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if band[v, u] and is_wide[labels[v, u] + 1]:
                markers[v, u] = 0
    return markers


def _watershed(rgb: np.ndarray, markers: np.ndarray) -> np.ndarray:
    """Return the basins of the markers, which are overwritten; 0 where there are none."""
    cv2.watershed(rgb, markers)
    # Watershed leaves lines of -1 between the basins: they take the label of a neighbour.
    filled = cv2.dilate(np.maximum(markers, 0).astype(np.uint16), np.ones((3, 3), np.uint8))
    return np.where(markers > 0, markers, filled).astype(np.int32)


def patches_of_one_colour(guide: GuideImage) -> np.ndarray:
    """Return the patches of the image, as in PixelRegions."""
    rgb = guide.small_rgb
    height, width = (-(-side * SCALE // PATCH_SCALE) for side in rgb.shape[:2])
    small = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), SMOOTHING_PX)
    contrast = cv2.morphologyEx(small, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    is_flat = cv2.inRange(contrast, (0, 0, 0), 3 * (MAX_CONTRAST - 1,))
    return _watershed(small, cv2.connectedComponents(is_flat, connectivity=4)[1])


def blurs_steps(labels: np.ndarray, guide: GuideImage, disparity: np.ndarray, planes: np.ndarray,
                noise: Noise) -> bool:
    """Return whether most of the large steps from plane to plane are wider than SHARP_PX."""
    least = max(STEP_PIXEL_SIGMAS * noise.pixel_sigma, STEP_SMOOTH_SIGMAS * noise.mean_sigma,
                noise.disparity_floor)
    widths = _step_widths(labels, disparity, planes, round(guide.reach_px), least)
    return len(widths) > 0 and median(widths) > SHARP_PX


@kernel('int64[::1](int32[:, ::1], float32[:, ::1], float64[:, ::1], int64, float64)',
        subject='network')
def _step_widths(labels, disparity, planes, reach, least):
    """Return the number of pixels within each step from plane to plane, a row or column each."""
    height, width = labels.shape
    widths, found = np.empty(2 * labels.size, np.int64), 0
    for v in range(height):
        for u in range(width):
            for down, right in ((0, 1), (1, 0)):
                if v + down >= height or u + right >= width:
                    continue
                a, b = labels[v, u], labels[v + down, u + right]
                first, last = (v - reach * down, u - reach * right), (
                    v + (reach + 1) * down, u + (reach + 1) * right)
                if (a == b or a < 0 or b < 0 or min(first) < 0 or last[0] >= height
                        or last[1] >= width or labels[first] != a or labels[last] != b):
                    continue
                before = _off(planes[a], disparity, *first)
                after = _off(planes[b], disparity, *last)
                inside = 0
                for k in range(-reach, reach + 2):
                    row, column = v + k * down, u + k * right
                    done = _off(planes[a], disparity, row, column) - before
                    step = done - _off(planes[b], disparity, row, column) + after
                    if not (abs(step) > least and disparity[row, column] > 0):
                        break
                    inside += 0.2 * step * step < done * step < 0.8 * step * step
                else:
                    widths[found] = inside
                    found += 1
    return widths[:found]


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], float32[:, ::1], float64[:, ::1], int64, '
        'boolean, UniTuple(float64, 3))', subject='network')
def _moved(labels, proposed, disparity, planes, reach, is_blurred, floors):
    """
    Return the labels with those proposed (h, w) where the depth does not contradict them.

    Depth that is not on a plane contradicts it; depth on the old plane contradicts no plane.
    Blurred depth between a plane and another one within reach, and on neither, contradicts none;
    sharp depth on the old plane contradicts all planes that differ from it there.
    """
    moved, (height, width) = labels.copy(), labels.shape
    sums, pixels = np.zeros(len(planes)), np.ones(len(planes))
    for v in range(0, height, 2):
        for u in range(0, width, 2):
            k = labels[v, u]
            if k >= 0 and _proposed(labels, proposed, v, u) == k:
                # Mean deviations: a few wrong pixels hardly count.
                sums[k] += abs(_off(planes[k], disparity, v, u))
                pixels[k] += 1
    most = MOST_DEVIATIONS * sums / pixels
    for v in range(height):
        for u in range(width):
            old, new = labels[v, u], _proposed(labels, proposed, v, u)
            if new == old:
                continue
            floor = floors[0] * disparity[v, u] ** 2 + floors[1]
            off_old = _off(planes[old], disparity, v, u) if old >= 0 else np.inf
            is_off_old = abs(off_old) > most[old] + floor
            if new < 0:
                is_possible = is_off_old
            else:
                off = _off(planes[new], disparity, v, u)
                is_possible = abs(off) <= most[new] + floor
                if is_blurred:
                    is_possible |= is_off_old and _is_between(labels, disparity, planes, new, off,
                                                              reach, v, u)
                else:
                    is_possible &= is_off_old or abs(off - off_old) <= floors[2]
            if is_possible:
                moved[v, u] = new
    return moved


@kernel('int32(int32[:, ::1], int32[:, ::1], int64, int64)')
def _proposed(labels, proposed, v, u):
    new = proposed[v // SCALE, u // SCALE]
    return labels[v, u] if new == NOT_MOVED else new


@kernel('boolean(int32[:, ::1], float32[:, ::1], float64[:, ::1], int64, float64, int64, int64, '
        'int64)')
def _is_between(labels, disparity, planes, new, off, reach, v, u):
    """Return whether depth off a new plane is between it and another one within the reach."""
    height, width = labels.shape
    for down, right in ((0, 0), (0, reach), (0, -reach), (reach, 0), (-reach, 0)):
        row = min(max(v + down, 0), height - 1)
        other = labels[row, min(max(u + right, 0), width - 1)]
        if other >= 0 and other != new and _off(planes[other], disparity, v, u) * off < 0:
            return True
    return False


@kernel('float64(float64[::1], float32[:, ::1], int64, int64)')
def _off(plane, disparity, v, u):
    """Return the disparity of a pixel less that of a plane there."""
    return disparity[v, u] - (plane[0] * u + plane[1] * v + plane[2])
