# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Patches of uniform colour: regions of many patches are seldom one surface; filling of unlabelled
pixels.

In places, the depth of a network is off its planes by more than its noise. The planes are measured
and reoriented without these pixels, which only take the most frequent label of their patch.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.model import PATCH_SCALE
from plane_detector.types import NO_SHAPE_LABELS, CameraIntrinsics, Planes

# A pixel off the plane of its patch by more than this share of its depth is on another surface.
# tuned: eleven frames labelled by hand and 21 others, through FastDepth: flat from .15 to .5.
MAX_DEPTH_SHARE = 0.25
# Number of colours of a region if it is unknown, without blurred borders. measured: the median of
# 6000 regions of images through FastDepth; a quarter has less than 1.4, another more than 5.1.
USUAL_COLOURS = 2.6
# chosen: what is left of a region is at least a tenth of it.
MOST_OF_REGION = 0.9


def colours_in_regions(labels: np.ndarray, patches: np.ndarray, count: int) -> np.ndarray:
    """
    Return the effective number of colours of each region, (K,) float64.

    It is the number of equally large patches that would be as mixed: one over the sum of the
    squares of the shares of the patches [Simpson 1949].

    Examples
    --------
    >>> labels = np.repeat([[0, 0, 1, 1]], 4, axis=0).repeat(4, axis=1).astype(np.int32)
    >>> colours_in_regions(labels, np.array([[1, 1, 2, 3]], np.int32), 2).tolist()
    [1.0, 2.0]

    """
    if not patches.size:
        return np.full(count, USUAL_COLOURS)
    pixels = _common_pixels(labels[::PATCH_SCALE, ::PATCH_SCALE], patches, count).astype(float)
    return pixels.sum(1) ** 2 / np.maximum((pixels**2).sum(1), 1.0)


def _common_pixels(small: np.ndarray, patches: np.ndarray, count: int) -> np.ndarray:
    """Return the number (K, P) of pixels that regions, labels (h, w), share with patches."""
    kinds = int(patches.max(initial=0)) + 1
    pixels = np.bincount(((small + 1) * kinds + patches).ravel(), minlength=(count + 1) * kinds)
    return pixels.reshape(count + 1, kinds)[1:]


def patches_in_regions(labels: np.ndarray, patches: np.ndarray, asked: np.ndarray,
                       min_pixels: float) -> tuple[np.ndarray, int]:
    """
    Return the patches that lie in some regions, as regions of their own, and their number.

    Parameters
    ----------
    labels : (H, W) int32
        Index of the region, -1 none.
    patches : (h, w) int32
        As in :class:`~plane_detector.segmentation.cells.model.PixelRegions`.
    asked : (K,) bool
        The regions.
    min_pixels : float
        What of a patch lies in a region has at least about this many pixels.

    Returns
    -------
    labels : (H, W) int32
        Index of the patch in its region, -1 none. A region of nearly one patch has no parts.
    count : int

    Examples
    --------
    >>> labels, two = np.zeros((4, 8), np.int32), np.array([[1, 2]], np.int32)
    >>> found, count = patches_in_regions(labels, two, np.array([True]), 16)
    >>> found[0].tolist(), count
    ([0, 0, 0, 0, 1, 1, 1, 1], 2)

    """
    pixels = _common_pixels(labels[::PATCH_SCALE, ::PATCH_SCALE], patches, len(asked))
    is_part = ((pixels >= max(min_pixels / PATCH_SCALE**2, 1)) & asked[:, None]
               & (pixels < MOST_OF_REGION * pixels.sum(axis=1, keepdims=True)))
    is_part[:, 0] = False
    parts = np.where(is_part, np.cumsum(is_part).reshape(is_part.shape) - 1, -1)
    count = int(is_part.sum())
    if not count:
        return np.full_like(labels, -1), 0
    return _parted(np.ascontiguousarray(labels), np.ascontiguousarray(patches), parts), count


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], int64[:, ::1])', subject='network')
def _parted(labels, patches, parts):
    """Return the parts (K, P) of regions and patches as labels (H, W), -1 where there is none."""
    found = np.full_like(labels, -1)
    for y in range(patches.shape[0]):
        for x in range(patches.shape[1]):
            top, left = y * PATCH_SCALE, x * PATCH_SCALE
            k = labels[top, left]
            if k < 0 or parts[k, patches[y, x]] < 0:
                continue
            for v in range(top, min(top + PATCH_SCALE, labels.shape[0])):
                for u in range(left, min(left + PATCH_SCALE, labels.shape[1])):
                    if labels[v, u] == k:
                        found[v, u] = parts[k, patches[y, x]]
    return found


def fill_patches(labels: np.ndarray, patches: np.ndarray, planes: Planes, depth_m: np.ndarray,
                 intrinsics: CameraIntrinsics,
                 shape_labels: np.ndarray = NO_SHAPE_LABELS) -> np.ndarray:
    """
    Give unlabelled pixels the plane of the patch around them.

    Parameters
    ----------
    labels : (H, W) int32
        Index into the planes, -1 none.
    patches : (h, w) int32
        As in :class:`~plane_detector.segmentation.cells.model.PixelRegions`.
    planes : Planes
    depth_m : (H, W) floating
        NaN where invalid; such pixels keep -1.
    intrinsics : CameraIntrinsics
    shape_labels : (H, W) int32, optional
        Pixels of shapes, which are not filled, are at least 0. Default: no shapes.

    Returns
    -------
    (H, W) int32
        The same array if there are no planes.

    Examples
    --------
    >>> from plane_detector.types import Plane
    >>> wall = Plane(np.array([0, 0, -1.0]), 2.0, np.array([0, 0, 2.0]), 9, 0.0, 1.0, np.eye(4), 1)
    >>> camera = CameraIntrinsics.from_field_of_view(8, 8, 60.0)
    >>> labels, depth_m = np.zeros((8, 8), np.int32), np.full((8, 8), 2.0)
    >>> labels[4:, 5:], depth_m[4:, 5:], depth_m[7, 7] = -1, 2.2, 1.0
    >>> fill_patches(labels, np.ones((2, 2), np.int32), Planes.of([wall]), depth_m, camera)[-1]
    array([ 0,  0,  0,  0,  0,  0,  0, -1], dtype=int32)

    """
    if not len(planes):
        return labels
    # Of all shapes together, one kind more than planes.
    known = np.where(shape_labels >= 0, len(planes), labels) if shape_labels.size else labels
    small, kinds = known[::PATCH_SCALE, ::PATCH_SCALE], len(planes) + 2
    votes = np.bincount((patches * kinds + small + 1).ravel(),
                        minlength=kinds * (int(patches.max()) + 1)).reshape(-1, kinds)
    winner = votes.argmax(axis=1).astype(np.int32) - 1
    winner[0] = -1
    winner[winner >= len(planes)] = -1
    slopes = -planes.normals / planes.offsets_m[:, None]
    filled = _fill(np.ascontiguousarray(known, np.int32), winner[patches], slopes,
                   np.ascontiguousarray(depth_m, np.float32),
                   (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy))
    return np.where(filled < len(planes), filled, -1) if shape_labels.size else filled


@kernel('int32[:, ::1](int32[:, ::1], int32[:, ::1], float64[:, ::1], float32[:, ::1], '
        'UniTuple(float64, 4))', subject='network')
def _fill(labels, of_patches, slopes, depth_m, camera):
    """Return the labels, filled from the patches where there are none and the depth is near."""
    filled, (fx, fy, cx, cy) = labels.copy(), camera
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] >= 0:
                continue
            k = of_patches[v // PATCH_SCALE, u // PATCH_SCALE]
            if k < 0:
                continue
            disparity = (slopes[k, 0] * (u - cx) / fx + slopes[k, 1] * (v - cy) / fy
                         + slopes[k, 2])
            if abs(disparity * depth_m[v, u] - 1) < MAX_DEPTH_SHARE:
                filled[v, u] = k
    return filled
